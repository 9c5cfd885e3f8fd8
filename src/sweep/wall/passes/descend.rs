//! Multigrid on the way to coarser grids (`shaders/sweep/descend.wgsl`).

use super::restricted::restricted;
use super::{Level, Matrix};

/// The values of a grid after two relaxations from zero, and what these leave of the right-hand side, shared out among the
/// nodes of the next coarser grid.
pub fn descend(matrix: &Matrix, coarse: &Level, right: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let Matrix { parameters, level, own, .. } = *matrix;
    let first = |(own, right): (&[f32; 2], &f32)| (parameters.first_relaxation * own[1]) * right;
    let values: Vec<f32> = own.iter().zip(right).map(first).collect();
    let values = matrix.relaxed(right, &values, parameters.second_relaxation);
    let left = matrix.left(right, &values);
    let of_coarse =
        |node: u32| restricted(level, coarse, |node| left[node], node / coarse.nodes, node % coarse.nodes);
    (values, (0..coarse.count).map(of_coarse).collect())
}
