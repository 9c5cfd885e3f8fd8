//! Multigrid: the correction by the next coarser grid (`shaders/sweep/prolong.wgsl`).

use super::Level;
use super::interpolated::interpolated;

/// Adds the values of the next coarser grid to those of a grid.
pub fn prolong(fine: &Level, coarse: &Level, coarse_values: &[f32], values: &mut [f32]) {
    for (node, value) in (0..).zip(values) {
        *value += interpolated(fine, coarse, coarse_values, node / fine.nodes, node % fine.nodes);
    }
}
