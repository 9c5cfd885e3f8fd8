//! First step of the prefix sum over the faces' counts.

/// Faces per block.
pub const BLOCK: usize = 1024;

/// The sum of each block of 1024 counts.
pub fn scan_reduce(counts: &[u32]) -> Vec<u32> {
    counts.chunks(BLOCK).map(|block| block.iter().sum()).collect()
}
