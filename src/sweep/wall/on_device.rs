//! Echoes in the form that a device holds them.

use super::passes;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::WallGrid;

impl Echo {
    /// The echo in f32, its radius relative to `start_mm`; cells and fractions of cells are kept apart to preserve the
    /// precision of f32.
    pub(in crate::sweep) fn for_device(&self, grid: &WallGrid, start_mm: f64) -> passes::DeviceEcho {
        let ring = self.ring.max(0.0).floor();
        let around = self.node.rem_euclid(grid.nodes as f64);
        let node = around.floor();
        passes::DeviceEcho {
            ring: ring as u32,
            ring_part: (self.ring - ring) as f32,
            node: node as u32,
            node_part: (around - node) as f32,
            rise: (self.radius_mm - start_mm) as f32,
            step: (grid.step_mm * f64::from(self.stretch)) as f32,
            normal: self.image_normal.to_array(),
        }
    }

    /// Takes the results of a device: the projection, in rings and nodes from the echo, and the residual, mm.
    pub(in crate::sweep) fn set_residual(&mut self, shift: [f32; 2], residual_mm: f64) {
        (self.shift, self.residual_mm) = (shift, residual_mm);
    }
}
