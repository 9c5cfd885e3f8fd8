//! The elimination of the interiors (`shaders/sweep/eliminate.wgsl`).

use super::blocks::{frequency_of, interior};
use super::{Factors, WallParameters};

/// Eliminates the interior of each block. Returns, per block and coefficient, its Schur-complement updates of
/// the two separators before the interior and of the two after it.
pub fn eliminate(parameters: &WallParameters, factors: &Factors, spectrum: &mut [f32]) -> Vec<[f32; 4]> {
    let nodes = parameters.nodes as usize;
    (0..parameters.blocks as usize * nodes)
        .map(|index| {
            let (block, coefficient) = (index / nodes, index % nodes);
            let frequency = frequency_of(parameters, coefficient);
            let (mut next, mut next_but_one, mut first, mut second) = (0.0, 0.0, 0.0, 0.0);
            for ring in interior(parameters, block) {
                let factor = |part: usize| factors.at(parameters, part, ring, frequency);
                let x = spectrum[ring * nodes + coefficient] - next;
                spectrum[ring * nodes + coefficient] = x;
                next = next_but_one + factor(1) * x;
                next_but_one = factor(2) * x;
                first += factor(3) * x;
                second += factor(4) * x;
            }
            [first, second, next, next_but_one]
        })
        .collect()
}
