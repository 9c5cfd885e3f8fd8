//! The preconditioner's systems along the axis: the wall's equations with the weights of each ring spread evenly over it.

use super::bending::LocalSmoothness;
use crate::numerics::banded::Pentadiagonal;
use crate::numerics::robust::median;
use crate::sweep::prepare::grid::WallGrid;
use std::f64::consts::TAU;

impl WallGrid {
    /// The weights of rings spread evenly over their nodes, for [`WallGrid::system`].
    pub(in crate::sweep) fn even_weights(&self, ring_weights: Vec<f64>) -> Vec<f64> {
        let mut weights: Vec<f64> = ring_weights.into_iter().map(|w| w / self.nodes as f64).collect();
        // Rings without points must not make a system singular.
        let floor = 1e-6 * median(&mut weights.clone()).max(f64::MIN_POSITIVE) + 1e-12;
        weights.iter_mut().for_each(|w| *w += floor);
        weights
    }

    /// The equations along the axis for a frequency about it, where each ring has even weights.
    pub(in crate::sweep) fn system(
        &self,
        frequency: usize,
        weights: &[f64],
        smoothness: f64,
        local: &LocalSmoothness,
    ) -> Pentadiagonal {
        let Self { rings, nodes, step_mm, arc_mm } = *self;
        let area = smoothness * self.cell_mm2();
        let around = (2.0 - 2.0 * (TAU * frequency as f64 / nodes as f64).cos()) / (arc_mm * arc_mm);
        let mut system = Pentadiagonal::zeros(rings);
        for ring in 0..rings - 2 {
            system.add_bend(ring, area / step_mm.powi(4) * local.factor(ring + 1));
        }
        for (ring, weight) in weights.iter().enumerate() {
            system.add_diagonal(ring, weight + area * around * around * local.factor(ring));
        }
        for ring in 0..rings - 1 {
            let twist = 2.0 * area * around / (step_mm * step_mm);
            system.add_pair(ring, twist * local.factor(ring), [-1.0, 1.0]);
        }
        system
    }
}
