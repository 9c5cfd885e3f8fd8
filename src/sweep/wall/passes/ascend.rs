//! Multigrid on the way back (`shaders/sweep/ascend.wgsl`).

use super::interpolated::interpolated;
use super::tile::{ASCEND_COLUMNS, tile_sums};
use super::{Level, Matrix};

/// The values of a grid corrected by those of the next coarser one and relaxed twice; and the sums, tile by tile, of their
/// products with the right-hand side, which the device forms on the finest grid only.
pub fn ascend(
    matrix: &Matrix,
    coarse: &Level,
    coarse_values: &[f32],
    right: &[f32],
    values: &[f32],
) -> (Vec<f32>, Vec<f32>) {
    let Matrix { parameters, level, .. } = *matrix;
    let corrected = |(node, value): (u32, &f32)| {
        value + interpolated(level, coarse, coarse_values, node / level.nodes, node % level.nodes)
    };
    let values: Vec<f32> = (0..).zip(values).map(corrected).collect();
    let values = matrix.relaxed(right, &values, parameters.second_relaxation);
    let values = matrix.relaxed(right, &values, parameters.first_relaxation);
    let partials = tile_sums(parameters, level, ASCEND_COLUMNS, |node| right[node] * values[node]);
    (values, partials)
}
