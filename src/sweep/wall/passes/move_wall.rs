//! The move of the wall (`shaders/sweep/move_wall.wgsl`).

use super::WallParameters;
use super::sum::partial_sums;

/// Moves the wall by the solution; returns the partial sums of the distances that its nodes travel, mm.
pub fn move_wall(parameters: &WallParameters, change: &[f32], wall: &mut [f32]) -> Vec<f32> {
    let travels: Vec<f32> = change.iter().map(|x| parameters.noise * x).collect();
    wall.iter_mut().zip(&travels).for_each(|(r, travel)| *r += travel);
    partial_sums(travels.iter().map(|travel| travel.abs()))
}
