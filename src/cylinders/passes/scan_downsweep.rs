//! Third step of the prefix sum over the faces' counts.

use super::scan_reduce::BLOCK;
use crate::numerics::inclusive_scan;

/// The number of points before each face, and behind the last face the number of all: where each face's points
/// begin. `block_sums` holds the number of points before each block of faces.
pub fn scan_downsweep(counts: &[u32], block_sums: &[u32]) -> Vec<u32> {
    let mut offsets = vec![0; counts.len() + 1];
    let blocks = offsets[1..].chunks_mut(BLOCK).zip(counts.chunks(BLOCK)).zip(block_sums);
    for ((offsets, counts), before) in blocks {
        offsets.copy_from_slice(counts);
        offsets[0] += before;
        inclusive_scan(offsets);
    }
    offsets
}

/// The faces with more than `max_short` points, in ascending order; the device lists them in any order.
pub fn long_faces(counts: &[u32], max_short: u32) -> Vec<u32> {
    (0..).zip(counts).filter(|&(_, &count)| count > max_short).map(|(face, _)| face).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cylinders::passes::{scan_reduce, scan_spine};

    #[test]
    fn a_face_is_long_only_above_the_bound() {
        assert_eq!(long_faces(&[4, 5, 0, 4, 7], 4), [1, 4]);
        assert!(long_faces(&[], 4).is_empty());
    }

    #[test]
    fn the_three_steps_give_the_number_of_points_before_each_face() {
        for faces in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 5 * BLOCK + 7] {
            let counts: Vec<u32> = (0..faces as u32).map(|face| face * face % 11).collect();
            let mut block_sums = scan_reduce(&counts);
            scan_spine(&mut block_sums);
            let offsets = scan_downsweep(&counts, &block_sums);
            assert_eq!(offsets.len(), faces + 1);
            for face in 0..=faces {
                assert_eq!(offsets[face], counts[..face].iter().sum::<u32>());
            }
        }
    }
}
