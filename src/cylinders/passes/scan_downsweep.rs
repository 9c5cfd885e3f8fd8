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

/// Words in front of a [list of faces](listed_faces).
pub const LIST_HEAD: usize = 3;

/// The list, that many words long, of the faces with more than `max_short` points: the number of long faces, which
/// have more than `max_middle`; a word in which `measure_long` counts; and the number of the others. Then come the
/// long faces in ascending order, and from the end backwards the others; the device lists each in any order.
pub fn listed_faces(counts: &[u32], max_short: u32, max_middle: u32, words: usize) -> Vec<u32> {
    let (mut list, mut long, mut others) = (vec![0; words], 0, 0);
    for (face, &count) in (0..).zip(counts) {
        if count > max_middle {
            list[LIST_HEAD + long] = face;
            long += 1;
        } else if count > max_short {
            others += 1;
            list[words - others] = face;
        }
    }
    list[0] = long as u32;
    list[2] = others as u32;
    list
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cylinders::passes::{scan_reduce, scan_spine};

    #[test]
    fn a_face_is_listed_only_above_a_bound() {
        assert_eq!(listed_faces(&[4, 5, 0, 4, 7, 8], 4, 7, 7), [1, 0, 2, 5, 0, 4, 1]);
        assert_eq!(listed_faces(&[5, 4], 4, 4, 4), [1, 0, 0, 0]);
        assert_eq!(listed_faces(&[], 4, 7, 3), [0; 3]);
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
