//! Multigrid: the last relaxation of a grid (`shaders/sweep/smooth_last.wgsl`).

use super::Matrix;
use super::sum::partial_sums;

/// The values of a grid after its last relaxation, and the partial sums of their scalar product with the right-hand side,
/// which the device forms on the finest grid only.
pub fn smooth_last(matrix: &Matrix, right: &[f32], values: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let values = matrix.relaxed(right, values, matrix.parameters.first_relaxation);
    let partials = partial_sums(right.iter().zip(&values).map(|(a, b)| a * b));
    (values, partials)
}
