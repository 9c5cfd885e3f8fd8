//! The move of the wall (`shaders/sweep/move_wall.wgsl`).

use super::WallParameters;
use super::sum::partial_sums;

/// Moves the wall by the solution; returns the partial sums of the distances that its nodes travel, mm, weighted by the
/// diagonal of the echoes' equations, and of these weights.
pub fn move_wall(
    parameters: &WallParameters,
    change: &[f32],
    rows: &[[f32; 4]],
    wall: &mut [f32],
) -> Vec<[f32; 2]> {
    let travels: Vec<f32> = change.iter().map(|x| parameters.noise * x).collect();
    wall.iter_mut().zip(&travels).for_each(|(r, travel)| *r += travel);
    let weighted = partial_sums(travels.iter().zip(rows).map(|(travel, row)| row[0] * travel.abs()));
    let weights = partial_sums(rows.iter().map(|row| row[0]));
    weighted.into_iter().zip(weights).map(|(travel, weight)| [travel, weight]).collect()
}
