//! Multigrid: the second relaxation of a grid, or the last but one (`shaders/sweep/smooth.wgsl`).

use super::Matrix;

/// The values of a grid after its second relaxation, or the last but one.
pub fn smooth(matrix: &Matrix, right: &[f32], values: &[f32]) -> Vec<f32> {
    matrix.relaxed(right, values, matrix.parameters.second_relaxation)
}
