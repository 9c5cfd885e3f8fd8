//! Second step of the prefix sum over the faces' counts.

use crate::numerics::inclusive_scan;

/// Replaces the sum of each block by the sum of all blocks before it.
pub fn scan_spine(block_sums: &mut [u32]) {
    inclusive_scan(block_sums);
    block_sums.rotate_right(1);
    if let Some(first) = block_sums.first_mut() {
        *first = 0;
    }
}
