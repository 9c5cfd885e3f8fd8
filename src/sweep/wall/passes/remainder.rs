//! Multigrid: what the values of a grid leave of its right-hand side (`shaders/sweep/remainder.wgsl`).

use super::Matrix;

/// What `values` leave of a right-hand side.
pub fn remainder(matrix: &Matrix, right: &[f32], values: &[f32]) -> Vec<f32> {
    matrix.remainder(right, values)
}
