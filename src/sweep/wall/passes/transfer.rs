//! Linear interpolation between a grid and the next coarser one, in one direction (`shaders/sweep/common/transfer.wgsl`). The
//! coarser one has as many places, or half as many intervals, rounded up. A closed direction goes about the axis.

/// Where a place lies between two coarser ones, and the weight of the one above.
#[derive(Debug, Clone, Copy)]
pub(super) struct Share {
    pub below: u32,
    pub above: u32,
    pub part: f32,
}

/// The share of the i-th of `fine` places.
pub(super) fn share_of(i: u32, fine: u32, coarse: u32, closed: bool) -> Share {
    if fine == coarse {
        return Share { below: i, above: i, part: 0.0 };
    }
    let intervals = if closed { fine } else { fine - 1 };
    let coarse_intervals = if closed { coarse } else { coarse - 1 };
    let below = i / 2;
    // In units of 1/intervals.
    let rest = i % 2 * coarse_intervals + (2 * coarse_intervals - intervals) * below;
    let above = match (below + 1 == coarse, closed) {
        (false, _) => below + 1,
        (true, false) => below,
        (true, true) => 0,
    };
    Share { below, above, part: rest as f32 / intervals as f32 }
}

/// The share of a coarser place in a finer one.
pub(super) fn weight_of(coarser: u32, share: Share) -> f32 {
    let mut weight = 0.0;
    if share.below == coarser {
        weight = 1.0 - share.part;
    }
    if share.above == coarser && share.part > 0.0 {
        weight += share.part;
    }
    weight
}

/// The candidates, at most four, for finer places that a coarser one has a share in; `fine` for none.
pub(super) fn candidate(t: u32, coarser: u32, fine: u32, coarse: u32, closed: bool) -> u32 {
    if fine == coarse {
        return if t == 0 { coarser } else { fine };
    }
    let two_on = 2 * coarser + t;
    if closed {
        let on = if two_on >= 2 { two_on - 2 } else { two_on + fine - 2 };
        return match () {
            () if t >= fine => fine,
            () if on >= fine => on - fine,
            () => on,
        };
    }
    if two_on >= 2 && two_on - 2 < fine { two_on - 2 } else { fine }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every share in every finer place is found once, and they sum to one.
    #[test]
    fn no_share_is_lost_or_counted_twice() {
        for fine in 1..40_u32 {
            for closed in [false, true] {
                let fewer = match closed {
                    true => fine.div_ceil(2),
                    false if fine > 3 => (fine - 1).div_ceil(2) + 1,
                    false => fine,
                };
                for coarse in [fewer, fine] {
                    let mut sums = vec![0.0; fine as usize];
                    for coarser in 0..coarse {
                        let found = (0..4).map(|t| candidate(t, coarser, fine, coarse, closed));
                        for i in found.filter(|i| *i < fine) {
                            sums[i as usize] += weight_of(coarser, share_of(i, fine, coarse, closed));
                        }
                    }
                    assert!(
                        sums.iter().all(|sum| (sum - 1.0_f32).abs() < 1e-6),
                        "{fine} to {coarse}: {sums:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_line_is_interpolated_exactly() {
        for (fine, coarse) in [(9, 5), (10, 6), (4, 3), (117, 59), (3, 3)] {
            for i in 0..fine {
                let Share { below, above, part } = share_of(i, fine, coarse, false);
                let place = below as f32 + part * (above as f32 - below as f32);
                let expected = i as f32 * (coarse - 1) as f32 / (fine - 1) as f32;
                assert!((place - expected).abs() < 1e-5 * coarse as f32, "{i} of {fine}: {place} {expected}");
            }
        }
    }
}
