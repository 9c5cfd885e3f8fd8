//! The matrix of the equations times a direction (`shaders/sweep/apply.wgsl`).

use super::coupled::coupled;
use super::sum::partial_sums;
use super::{WallParameters, bending};

/// The matrix times `direction`, and the partial sums of the scalar product of both.
pub fn apply(parameters: &WallParameters, rows: &[[f32; 4]], direction: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let level = parameters.finest();
    let nodes = parameters.nodes as usize;
    let product: Vec<f32> = (0..direction.len())
        .map(|node| {
            let (k, j) = (node / nodes, node % nodes);
            coupled(&level, rows, direction, k, j) + bending(&level, direction, k, j)
        })
        .collect();
    let partials = partial_sums(direction.iter().zip(&product).map(|(a, b)| a * b));
    (product, partials)
}
