//! Conjugate gradients: when they stop (`shaders/sweep/cg_limit.wgsl`).

use super::{State, WallParameters, sum_of_partials};

/// The residual at which conjugate gradients stop, from the size of the right-hand side.
pub fn cg_limit(parameters: &WallParameters, partials: &[f32], state: &mut State) {
    state.max_residual_square = parameters.tolerance_square * sum_of_partials(partials);
}
