//! Conjugate gradients: the next direction (`shaders/sweep/cg_direction.wgsl`).

use super::State;

/// The next direction.
pub fn cg_direction(state: &State, preconditioned: &[f32], direction: &mut [f32]) {
    if state.done == 0 {
        direction.iter_mut().zip(preconditioned).for_each(|(d, z)| *d = z + state.beta * *d);
    }
}
