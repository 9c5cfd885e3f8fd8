//! Conjugate gradients: the matrix of the equations times the next direction (`shaders/sweep/apply.wgsl`).

use super::cg_step::next_direction;
use super::coupled::coupled;
use super::tile::{APPLY_COLUMNS, tile_sums};
use super::{State, WallParameters, bending};

/// The matrix times the next direction, and the sums, tile by tile, of the products of both.
pub fn apply(
    parameters: &WallParameters,
    state: &State,
    rows: &[[f32; 4]],
    preconditioned: &[f32],
    direction: &[f32],
) -> (Vec<f32>, Vec<f32>) {
    let level = parameters.finest();
    let nodes = parameters.nodes as usize;
    let along: Vec<f32> =
        preconditioned.iter().zip(direction).map(|(z, d)| next_direction(state, *z, *d)).collect();
    let product: Vec<f32> = (0..along.len())
        .map(|node| {
            let (k, j) = (node / nodes, node % nodes);
            coupled(&level, rows, &along, k, j) + bending(&level, &along, k, j)
        })
        .collect();
    let partials = tile_sums(parameters, &level, APPLY_COLUMNS, |node| along[node] * product[node]);
    (product, partials)
}
