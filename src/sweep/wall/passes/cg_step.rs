//! Conjugate gradients: a step (`shaders/sweep/cg_step.wgsl`).

use super::{BROKEN, NextStep, State, sum_of_partials};

/// The next direction at a node.
pub(super) fn next_direction(next_step: &NextStep, preconditioned: f32, direction: f32) -> f32 {
    preconditioned + next_step.beta * direction
}

/// The next direction, and a step along it, whose length follows from the partial sums of the curvature. A curvature that
/// is not a finite number above 0 breaks the solver: the equations are not positive definite.
pub fn cg_step(
    state: &mut State,
    next_step: &NextStep,
    curvatures: &[f32],
    preconditioned: &[f32],
    product: &[f32],
    [direction, change, residual]: [&mut [f32]; 3],
) {
    if next_step.ends != 0 {
        state.done = next_step.ends;
        return;
    }
    let curvature = sum_of_partials(curvatures);
    if !(curvature > 0.0 && curvature <= f32::MAX) {
        state.done = BROKEN;
        return;
    }
    let alpha = next_step.square / curvature;
    state.steps += 1;
    state.residual_square = next_step.square;
    for (node, along) in direction.iter_mut().enumerate() {
        *along = next_direction(next_step, preconditioned[node], *along);
        change[node] += alpha * *along;
        residual[node] -= alpha * product[node];
    }
}
