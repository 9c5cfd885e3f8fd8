//! The solution for the separators (`shaders/sweep/couple.wgsl`).

use super::blocks::{frequency_count, frequency_of};
use super::{Factors, WallParameters};

/// Solves for the separators: forward through all of them, and back.
pub fn couple(parameters: &WallParameters, factors: &Factors, updates: &[[f32; 4]], spectrum: &mut [f32]) {
    let nodes = parameters.nodes as usize;
    let count = 2 * (parameters.blocks as usize - 1);
    for coefficient in 0..nodes {
        let frequency = frequency_of(parameters, coefficient);
        let place = |separator: usize| {
            ((separator / 2 + 1) * parameters.block_rings as usize + separator % 2) * nodes + coefficient
        };
        let row = |separator: usize| factors.separators[separator * frequency_count(parameters) + frequency];
        // Schur-complement updates of the next three separators.
        let mut update = [0.0; 3];
        for separator in 0..count {
            let block = separator / 2;
            let below = updates[block * nodes + coefficient];
            let above = updates[(block + 1) * nodes + coefficient];
            let of_interiors = if separator % 2 == 1 { below[3] + above[1] } else { below[2] + above[0] };
            let x = (spectrum[place(separator)] - of_interiors) - update[0];
            spectrum[place(separator)] = x;
            let [_, a, b, c] = row(separator);
            update = [update[1] + a * x, update[2] + b * x, c * x];
        }
        let mut known = [0.0; 3];
        for separator in (0..count).rev() {
            let [inverse, a, b, c] = row(separator);
            let x = spectrum[place(separator)] * inverse - a * known[0] - b * known[1] - c * known[2];
            spectrum[place(separator)] = x;
            known = [x, known[0], known[1]];
        }
    }
}
