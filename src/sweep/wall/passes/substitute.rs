//! The back substitution in the interiors (`shaders/sweep/substitute.wgsl`).

use super::blocks::{frequency_of, interior};
use super::{Factors, WallParameters};

/// Back substitution through the interior of each block, whose separators are solved.
pub fn substitute(parameters: &WallParameters, factors: &Factors, spectrum: &mut [f32]) {
    let nodes = parameters.nodes as usize;
    for index in 0..parameters.blocks as usize * nodes {
        let (block, coefficient) = (index / nodes, index % nodes);
        let frequency = frequency_of(parameters, coefficient);
        let separators =
            |ring: usize| (spectrum[ring * nodes + coefficient], spectrum[(ring + 1) * nodes + coefficient]);
        let interior = interior(parameters, block);
        let (first, second) =
            if block > 0 { separators(block * parameters.block_rings as usize) } else { (0.0, 0.0) };
        let (mut next, mut next_but_one) =
            if block + 1 < parameters.blocks as usize { separators(interior.end) } else { (0.0, 0.0) };
        for ring in interior.rev() {
            let factor = |part: usize| factors.at(parameters, part, ring, frequency);
            let x = spectrum[ring * nodes + coefficient] * factor(0)
                - factor(1) * next
                - factor(2) * next_but_one
                - factor(3) * first
                - factor(4) * second;
            spectrum[ring * nodes + coefficient] = x;
            (next, next_but_one) = (x, next);
        }
    }
}
