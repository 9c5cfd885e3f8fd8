//! Second step of the prefix sum over the faces' counts.

use crate::numerics::inclusive_scan;

/// Replaces the sum of each block by the sum of all blocks before it.
pub fn scan_spine(block_sums: &mut [u32]) {
    inclusive_scan(block_sums);
    if let Some(last) = block_sums.len().checked_sub(1) {
        block_sums.copy_within(..last, 1);
        block_sums[0] = 0;
    }
}
