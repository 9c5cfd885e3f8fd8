//! Conjugate gradients: the length of the next step (`shaders/sweep/cg_alpha.wgsl`).

use super::{BROKEN, State, sum_of_partials};

/// The length α of the next step. A curvature that is not a finite number above 0 breaks the solver: the equations
/// are not positive definite.
pub fn cg_alpha(partials: &[f32], state: &mut State) {
    let curvature = sum_of_partials(partials);
    if state.done != 0 {
        return;
    }
    if curvature > 0.0 && curvature <= f32::MAX {
        state.alpha = state.residual_square / curvature;
        state.steps += 1;
    } else {
        state.done = BROKEN;
    }
}
