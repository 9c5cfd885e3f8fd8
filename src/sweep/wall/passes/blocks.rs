//! The rings in blocks, and the factors of the preconditioner's systems (`shaders/sweep/common/blocks.wgsl`).
//!
//! There is one system per coefficient of the Hartley transform about the axis. Each couples a ring to the
//! two before and the two after it. The first two rings of every block but the first are its separators
//! (nested dissection): without them the blocks' interiors are independent, so that all of them are
//! eliminated and substituted at the same time, and only the separators, two per block, are solved one after
//! the other. The factors are those of `LDLᵀ` in that order.

use super::WallParameters;

/// The factors of all systems, frequency by frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct Factors {
    /// Five planes with a number for each ring and frequency: 1/D, and the factors of the next two rings and
    /// of the two separators of the block.
    pub rings: Vec<f32>,
    /// Per separator and frequency: 1/D, and the factors of the next three separators.
    pub separators: Vec<[f32; 4]>,
}

impl Factors {
    /// Zeros of the right number.
    pub fn zeroed(parameters: &WallParameters) -> Self {
        let (rings, blocks, frequencies) =
            (parameters.rings as usize, parameters.blocks as usize, frequency_count(parameters));
        Self {
            rings: vec![0.0; 5 * rings * frequencies],
            separators: vec![[0.0; 4]; 2 * (blocks - 1) * frequencies],
        }
    }

    pub(super) fn at(&self, parameters: &WallParameters, part: usize, ring: usize, frequency: usize) -> f32 {
        self.rings[(part * parameters.rings as usize + ring) * frequency_count(parameters) + frequency]
    }
}

/// The number of frequencies about the axis.
pub(super) fn frequency_count(parameters: &WallParameters) -> usize {
    parameters.nodes as usize / 2 + 1
}

/// Coefficients c and N - c of a Hartley transform are of one frequency.
pub(super) fn frequency_of(parameters: &WallParameters, coefficient: usize) -> usize {
    coefficient.min(parameters.nodes as usize - coefficient)
}

/// The rings of a block's interior.
pub(super) fn interior(parameters: &WallParameters, block: usize) -> std::ops::Range<usize> {
    let (blocks, rings) = (parameters.blocks as usize, parameters.block_rings as usize);
    let first = block * rings + if block == 0 { 0 } else { 2 };
    let end = if block + 1 == blocks { parameters.rings as usize } else { (block + 1) * rings };
    first..end
}
