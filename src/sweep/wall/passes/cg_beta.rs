//! Conjugate gradients: convergence, and the share of the last direction in the next
//! (`shaders/sweep/cg_beta.wgsl`).

use super::{BROKEN, CONVERGED, EXHAUSTED, State, WallParameters, sum_of_partials};

/// Whether the residual is small enough, or the steps ran out; if not, the share β of the last direction in the next. A residual that is
/// not a finite number breaks the solver.
pub fn cg_beta(parameters: &WallParameters, partials: &[f32], state: &mut State) {
    let square = sum_of_partials(partials);
    if state.done != 0 {
        return;
    }
    if square <= state.max_residual_square {
        state.done = CONVERGED;
    } else if square <= f32::MAX && state.steps >= parameters.max_steps {
        state.done = EXHAUSTED;
    } else if square <= f32::MAX {
        state.beta = if state.residual_square > 0.0 { square / state.residual_square } else { 0.0 };
        state.residual_square = square;
    } else {
        state.done = BROKEN;
    }
}
