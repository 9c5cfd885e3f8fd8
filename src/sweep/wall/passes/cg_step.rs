//! Conjugate gradients: a step (`shaders/sweep/cg_step.wgsl`).

use super::State;

/// The next direction at a node.
pub(super) fn next_direction(state: &State, preconditioned: f32, direction: f32) -> f32 {
    preconditioned + state.beta * direction
}

/// The next direction, and a step along it.
pub fn cg_step(
    state: &State,
    preconditioned: &[f32],
    product: &[f32],
    direction: &mut [f32],
    change: &mut [f32],
    residual: &mut [f32],
) {
    if state.done == 0 {
        direction.iter_mut().zip(preconditioned).for_each(|(d, z)| *d = next_direction(state, *z, *d));
        change.iter_mut().zip(direction).for_each(|(x, d)| *x += state.alpha * *d);
        residual.iter_mut().zip(product).for_each(|(r, p)| *r -= state.alpha * p);
    }
}
