//! The weights of the rings (`shaders/sweep/weigh_rings.wgsl`).

use super::{WallParameters, sum_of_workgroup};

/// The total weight of the echoes on each ring.
pub fn weigh_rings(parameters: &WallParameters, rows: &[[f32; 4]]) -> Vec<f32> {
    let nodes = parameters.nodes as usize;
    (0..parameters.rings as usize)
        .map(|ring| {
            let mut own = [0.0; 256];
            for j in 0..nodes {
                let row = rows[ring * nodes + j];
                let mut weight = row[0] + 2.0 * row[1] + (row[2] + row[3]);
                if ring > 0 {
                    let below = rows[(ring - 1) * nodes + j];
                    weight += below[2] + below[3];
                }
                own[j % 256] += weight;
            }
            sum_of_workgroup(&mut own)
        })
        .collect()
}
