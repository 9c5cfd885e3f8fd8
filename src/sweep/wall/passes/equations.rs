//! The least-squares equations (`shaders/sweep/assemble.wgsl`, `aim.wgsl`, `weigh_rings.wgsl`,
//! `apply.wgsl`). In f64 these are
//! `Equations` of the CPU.

use super::sum::{partial_sums, sum_of_workgroup};
use super::{Job, Sums, bending};
use crate::numerics::Scalar;

/// The equations of every node from the sums over echoes (couplings to itself, to the next along the ring, to the one
/// above, to the one above that next), and what is left of them with the wall as it is, in units of the noise.
pub fn assemble(job: &Job, sums: &[Sums], wall: &[f32]) -> (Vec<[f32; 4]>, Vec<f32>) {
    let nodes = job.nodes as usize;
    sums.iter()
        .enumerate()
        .map(|(node, sums)| {
            let weight = |part: usize| f32::mean_of(sums[part], job.weight_unit, 1);
            let bent = bending(job, wall, node / nodes, node % nodes);
            let residual = f32::mean_of(sums[4], job.way_unit, 1) - bent * job.per_noise;
            ([weight(0), weight(1), weight(2), weight(3)], residual)
        })
        .unzip()
}

/// The weight of the echoes on each ring.
pub fn weigh_rings(job: &Job, rows: &[[f32; 4]]) -> Vec<f32> {
    let nodes = job.nodes as usize;
    (0..job.rings as usize)
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

/// The right-hand side of the equations for whole radii, in units of the noise: what the residual is compared with.
pub fn aim(job: &Job, sums: &[Sums], rows: &[[f32; 4]], wall: &[f32]) -> Vec<f32> {
    let nodes = job.nodes as usize;
    let radii: Vec<f32> = wall.iter().map(|r| (r + job.start) * job.per_noise).collect();
    (0..wall.len())
        .map(|node| {
            let way = f32::mean_of(sums[node][4], job.way_unit, 1);
            coupled(job, rows, &radii, node / nodes, node % nodes) + way
        })
        .collect()
}

/// The echoes' couplings times `x`, at node j of ring k.
fn coupled(job: &Job, rows: &[[f32; 4]], x: &[f32], k: usize, j: usize) -> f32 {
    let nodes = job.nodes as usize;
    let row = k * nodes;
    let next = if j + 1 == nodes { 0 } else { j + 1 };
    let before = if j == 0 { nodes - 1 } else { j - 1 };
    let here = rows[row + j];
    let mut sum = here[0] * x[row + j] + here[1] * x[row + next] + rows[row + before][1] * x[row + before];
    if k + 1 < job.rings as usize {
        let above = row + nodes;
        sum += here[2] * x[above + j];
        sum += here[3] * x[above + next];
    }
    if k > 0 {
        let below = row - nodes;
        sum += rows[below + j][2] * x[below + j];
        sum += rows[below + before][3] * x[below + before];
    }
    sum
}

/// The equations' left-hand side for `direction`, and the partial sums of the product of both.
pub fn apply(job: &Job, rows: &[[f32; 4]], direction: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let nodes = job.nodes as usize;
    let product: Vec<f32> = (0..direction.len())
        .map(|node| {
            let (k, j) = (node / nodes, node % nodes);
            coupled(job, rows, direction, k, j) + bending(job, direction, k, j)
        })
        .collect();
    let partials = partial_sums(direction.iter().zip(&product).map(|(a, b)| a * b));
    (product, partials)
}
