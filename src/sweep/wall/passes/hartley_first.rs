//! The first stage of a Hartley transform about the axis (`shaders/sweep/hartley_first.wgsl`).
//!
//! Couplings that are the same all around a ring have the functions cos + sin (Hartley, 1942) for
//! eigenvectors: their transform is real, and its own inverse but for a factor. N is the product of two
//! factors as close to each other as there are, one per stage. Any N will do; a prime one takes longer.

use super::WallParameters;
use std::f64::consts::TAU;

/// cos and sin at the angle of each node.
pub fn twiddles(nodes: u32) -> Vec<[f32; 2]> {
    let angle = |j| TAU * f64::from(j) / f64::from(nodes);
    (0..nodes).map(|j| [angle(j).cos() as f32, angle(j).sin() as f32]).collect()
}

/// The first stage. At place r·short + p of a ring: cos and sin part of frequency p, over the nodes r, r +
/// long, …
pub fn hartley_first(parameters: &WallParameters, twiddles: &[[f32; 2]], values: &[f32]) -> Vec<[f32; 2]> {
    let [nodes, short, long] =
        [parameters.nodes, parameters.short_factor, parameters.long_factor].map(|count| count as usize);
    (0..values.len())
        .map(|index| {
            let (ring, place) = (index / nodes, index % nodes);
            let (first, turn) = (place / short, long * (place % short));
            let (mut sum, mut phase) = ([0.0, 0.0], 0);
            for i in 0..short {
                let x = values[ring * nodes + long * i + first];
                let twiddle = twiddles[phase];
                sum = [sum[0] + x * twiddle[0], sum[1] + x * twiddle[1]];
                phase += turn;
                if phase >= nodes {
                    phase -= nodes;
                }
            }
            sum
        })
        .collect()
}
