//! The weights of the next coarser grid (`shaders/sweep/coarsen.wgsl`).

use super::Level;
use super::diagonal::diagonal;
use super::restricted::restricted;

/// Per node of the next coarser grid: the echoes' weight, and the inverse of the matrix's diagonal; from those of a grid.
pub fn coarsen(fine: &Level, coarse: &Level, own: &[[f32; 2]]) -> Vec<[f32; 2]> {
    (0..coarse.count)
        .map(|node| {
            let (k, j) = (node / coarse.nodes, node % coarse.nodes);
            let weight = restricted(fine, coarse, |node| own[node][0], k, j);
            [weight, 1.0 / (weight + diagonal(coarse, k))]
        })
        .collect()
}
