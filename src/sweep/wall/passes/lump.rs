//! The weights of the finest grid (`shaders/sweep/lump.wgsl`).

use super::WallParameters;
use super::coupled::coupled;
use super::diagonal::diagonal;

/// Per node: the echoes' weight with its couplings added to it, and the inverse of the matrix's diagonal.
pub fn lump(parameters: &WallParameters, rows: &[[f32; 4]]) -> Vec<[f32; 2]> {
    let level = parameters.finest();
    let ones = vec![1.0; rows.len()];
    let nodes = level.nodes as usize;
    (0..rows.len())
        .map(|node| {
            let k = node / nodes;
            let weight = coupled(&level, rows, &ones, k, node % nodes);
            [weight, 1.0 / (rows[node][0] + diagonal(&level, k as u32))]
        })
        .collect()
}
