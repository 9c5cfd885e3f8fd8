//! Conjugate gradients but for the equations and the preconditioner (`shaders/sweep/turn.wgsl`, `redirect.wgsl`,
//! `stride.wgsl`, `advance.wgsl`), and the move of the wall (`move_wall.wgsl`).

use super::sum::{partial_sums, sum_of_partials};
use super::{Job, State};

/// Whether the residual is small enough; if not, how much of the last direction is in the next.
pub fn turn(job: &Job, partials: &[f32], state: &mut State) {
    let size = sum_of_partials(partials);
    if state.done != 0 {
        return;
    }
    if size > job.enough {
        state.turn = if state.size > 0.0 { size / state.size } else { 0.0 };
        state.size = size;
    } else {
        state.done = 1;
    }
}

/// The next direction.
pub fn redirect(state: &State, preconditioned: &[f32], direction: &mut [f32]) {
    if state.done == 0 {
        direction.iter_mut().zip(preconditioned).for_each(|(d, z)| *d = z + state.turn * *d);
    }
}

/// How far to go.
pub fn stride(partials: &[f32], state: &mut State) {
    let bent = sum_of_partials(partials);
    if state.done != 0 {
        return;
    }
    if bent > 0.0 {
        state.length = state.size / bent;
        state.steps += 1;
    } else {
        state.done = 1;
    }
}

/// A step along the direction.
pub fn advance(state: &State, direction: &[f32], product: &[f32], change: &mut [f32], residual: &mut [f32]) {
    if state.done == 0 {
        change.iter_mut().zip(direction).for_each(|(x, d)| *x += state.length * d);
        residual.iter_mut().zip(product).for_each(|(r, p)| *r -= state.length * p);
    }
}

/// The wall moves by what was found; returns the partial sums of how far, mm.
pub fn move_wall(job: &Job, change: &[f32], wall: &mut [f32]) -> Vec<f32> {
    let ways: Vec<f32> = change.iter().map(|x| job.noise * x).collect();
    wall.iter_mut().zip(&ways).for_each(|(r, way)| *r += way);
    partial_sums(ways.iter().map(|way| way.abs()))
}
