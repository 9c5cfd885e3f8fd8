//! Hartley transforms about the axis (`shaders/sweep/common/transform.wgsl`, `transform`, `transform_back`).
//!
//! Couplings that are the same all around a ring have waves for eigenvectors, and cos + sin is a wave as good as any: it
//! keeps numbers real, and the transform is its own inverse but for a factor. It is done as a product of matrices, which
//! takes N sums for each number, but any N, and needs no more than a table.

use super::{Job, sum_of_workgroup};
use std::f64::consts::TAU;

/// cos + sin at the angle of each node.
pub fn waves(nodes: u32) -> Vec<f32> {
    (0..nodes)
        .map(|j| {
            let (sin, cos) = (TAU * f64::from(j) / f64::from(nodes)).sin_cos();
            (cos + sin) as f32
        })
        .collect()
}

fn coefficient(waves: &[f32], ring: &[f32], frequency: usize) -> f32 {
    let (mut sum, mut phase) = (0.0, 0);
    for value in ring {
        sum += waves[phase] * value;
        phase += frequency;
        if phase >= waves.len() {
            phase -= waves.len();
        }
    }
    sum
}

/// Values ring by ring as waves.
pub fn transform(job: &Job, waves: &[f32], values: &[f32]) -> Vec<f32> {
    let nodes = job.nodes as usize;
    values
        .chunks(nodes)
        .flat_map(|ring| (0..nodes).map(move |frequency| coefficient(waves, ring, frequency)))
        .collect()
}

/// The waves as values again, and the partial sums of their product with the residual, of eight rings and 64 nodes each.
pub fn transform_back(job: &Job, waves: &[f32], spectrum: &[f32], residual: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let (rings, nodes) = (job.rings as usize, job.nodes as usize);
    let mut values = transform(job, waves, spectrum);
    values.iter_mut().for_each(|value| *value *= job.per_node);
    let partials = (0..rings.div_ceil(8) * nodes.div_ceil(64))
        .map(|index| {
            let first_ring = 8 * (index / nodes.div_ceil(64));
            let first = 64 * (index % nodes.div_ceil(64));
            let mut own = [0.0; 64];
            for (own, j) in own.iter_mut().zip(first..nodes) {
                for ring in first_ring..rings.min(first_ring + 8) {
                    let node = ring * nodes + j;
                    *own += residual[node] * values[node];
                }
            }
            sum_of_workgroup(&mut own)
        })
        .collect();
    (values, partials)
}
