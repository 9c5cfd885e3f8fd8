//! Third step of the prefix sum over the faces' counts.

use super::FitParameters;
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
pub const LIST_HEAD: usize = 4;

/// The list, that many words long, of the faces with more than `max_short` points: the number of long faces, which
/// have more than `max_narrow`; a word in which those that were measured are counted; the number of faces with up to
/// `max_middle` points, and of those with more that are not long. Then come the long faces in ascending order, behind room for
/// `most_long` those that are not, and from the end backwards the others; the device lists each in any order.
pub fn listed_faces(counts: &[u32], parameters: &FitParameters, words: usize) -> Vec<u32> {
    let FitParameters { max_short, max_middle, max_narrow, most_long, .. } = *parameters;
    let (mut list, mut long, mut middle, mut narrow) = (vec![0; words], 0, 0, 0);
    for (face, &count) in (0..).zip(counts) {
        if count > max_narrow {
            list[LIST_HEAD + long] = face;
            long += 1;
        } else if count > max_middle {
            list[LIST_HEAD + most_long as usize + narrow] = face;
            narrow += 1;
        } else if count > max_short {
            middle += 1;
            list[words - middle] = face;
        }
    }
    [list[0], list[2], list[3]] = [long, middle, narrow].map(|count| count as u32);
    list
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cylinders::passes::{scan_reduce, scan_spine};
    use crate::settings::Settings;

    #[test]
    fn a_face_is_listed_only_above_a_bound() {
        let of = |[short, middle, narrow]: [u32; 3], most_long| FitParameters {
            max_short: short,
            max_middle: middle,
            max_narrow: narrow,
            most_long,
            ..FitParameters::new(&Settings::default(), 1, 0, None, [0, 0])
        };
        assert_eq!(listed_faces(&[4, 5, 0, 4, 7, 8], &of([4, 7, 7], 0), 8), [1, 0, 2, 0, 5, 0, 4, 1]);
        let counts = [4, 5, 0, 9, 7, 8, 10];
        assert_eq!(listed_faces(&counts, &of([4, 7, 8], 3), 10), [2, 0, 2, 1, 3, 6, 0, 5, 4, 1]);
        assert_eq!(listed_faces(&[5, 4], &of([4, 4, 4], 0), 5), [1, 0, 0, 0, 0]);
        assert_eq!(listed_faces(&[], &of([4, 7, 9], 0), 4), [0; 4]);
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
