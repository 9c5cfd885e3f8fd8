//! Conjugate gradients: a step (`shaders/sweep/cg_step.wgsl`).

use super::State;

/// A step along the direction.
pub fn cg_step(state: &State, direction: &[f32], product: &[f32], change: &mut [f32], residual: &mut [f32]) {
    if state.done == 0 {
        change.iter_mut().zip(direction).for_each(|(x, d)| *x += state.alpha * d);
        residual.iter_mut().zip(product).for_each(|(r, p)| *r -= state.alpha * p);
    }
}
