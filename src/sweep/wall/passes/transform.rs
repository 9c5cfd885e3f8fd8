//! Hartley transforms about the axis (`shaders/sweep/common/part.wgsl`, `join.wgsl`, `part_residual`, `join_waves`,
//! `part_waves`, `join_values`).
//!
//! Couplings that are the same all around a ring have waves for eigenvectors, and cos + sin is a wave as good as any: it
//! keeps numbers real, and the transform is its own inverse but for a factor. N is parted into two factors as near to
//! each other as there are: any N will do, a prime one takes longer.

use super::Job;
use super::sum::partial_sums;
use std::f64::consts::TAU;

/// cos and sin at the angle of each node.
pub fn waves(nodes: u32) -> Vec<[f32; 2]> {
    let angle = |j| TAU * f64::from(j) / f64::from(nodes);
    (0..nodes).map(|j| [angle(j).cos() as f32, angle(j).sin() as f32]).collect()
}

/// The first half: per ring, at place r·short + p, the nodes r, r + long, … at frequency p, as cos and sin parts.
pub fn part(job: &Job, waves: &[[f32; 2]], values: &[f32]) -> Vec<[f32; 2]> {
    let (nodes, short, long) = (job.nodes as usize, job.short as usize, job.long as usize);
    (0..values.len())
        .map(|index| {
            let (ring, place) = (index / nodes, index % nodes);
            let (first, turn) = (place / short, long * (place % short));
            let (mut sum, mut phase) = ([0.0, 0.0], 0);
            for i in 0..short {
                let x = values[ring * nodes + long * i + first];
                let wave = waves[phase];
                sum = [sum[0] + x * wave[0], sum[1] + x * wave[1]];
                phase += turn;
                if phase >= nodes {
                    phase -= nodes;
                }
            }
            sum
        })
        .collect()
}

/// The coefficients of one frequency: those with index `frequency` and `nodes - frequency`.
fn joined(job: &Job, waves: &[[f32; 2]], parts: &[[f32; 2]], ring: usize, frequency: usize) -> [f32; 2] {
    let (nodes, short) = (job.nodes as usize, job.short as usize);
    let (mut sum, mut phase) = ([0.0, 0.0], 0);
    let mut place = ring * nodes + frequency % short;
    for _ in 0..job.long {
        let (x, wave) = (parts[place], waves[phase]);
        sum = [sum[0] + x[0] * wave[0], sum[1] + x[0] * wave[1]];
        sum = [sum[0] - x[1] * wave[1], sum[1] + x[1] * wave[0]];
        place += short;
        phase += frequency;
        if phase >= nodes {
            phase -= nodes;
        }
    }
    [sum[0] + sum[1], sum[0] - sum[1]]
}

/// The second half: values ring by ring as waves.
pub fn join_waves(job: &Job, waves: &[[f32; 2]], parts: &[[f32; 2]]) -> Vec<f32> {
    let nodes = job.nodes as usize;
    let mut spectrum = vec![0.0; parts.len()];
    for (ring, spectrum) in spectrum.chunks_mut(nodes).enumerate() {
        for frequency in 0..=nodes / 2 {
            let [a, b] = joined(job, waves, parts, ring, frequency);
            spectrum[frequency] = a;
            if frequency > 0 && 2 * frequency != nodes {
                spectrum[nodes - frequency] = b;
            }
        }
    }
    spectrum
}

/// The second half of the way back: the waves as values again, and the partial sums of their product with the residual.
pub fn join_values(
    job: &Job,
    waves: &[[f32; 2]],
    parts: &[[f32; 2]],
    residual: &[f32],
) -> (Vec<f32>, Vec<f32>) {
    let nodes = job.nodes as usize;
    let mut values = join_waves(job, waves, parts);
    values.iter_mut().for_each(|value| *value *= job.per_node);
    let products = (0..job.rings as usize * (nodes / 2 + 1)).map(|index| {
        let (ring, j) = (index / (nodes / 2 + 1), index % (nodes / 2 + 1));
        let (node, other) = (ring * nodes + j, (ring + 1) * nodes - j);
        let mut own = residual[node] * values[node];
        if j > 0 && 2 * j != nodes {
            own += residual[other] * values[other];
        }
        own
    });
    let partials = partial_sums(products);
    (values, partials)
}
