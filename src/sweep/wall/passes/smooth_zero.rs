//! Multigrid: the first relaxation of a grid (`shaders/sweep/smooth_zero.wgsl`).

use super::WallParameters;

/// The values of a grid after its first relaxation, from zero.
pub fn smooth_zero(parameters: &WallParameters, own: &[[f32; 2]], right: &[f32]) -> Vec<f32> {
    right.iter().zip(own).map(|(right, own)| (parameters.first_relaxation * own[1]) * right).collect()
}
