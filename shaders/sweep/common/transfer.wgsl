// Linear interpolation between a grid and the next coarser one, in one direction. The coarser one has as many places, or
// half as many intervals, rounded up. A closed direction goes about the axis.

// Where a place lies between two coarser ones, and the weight of the one above.
struct Share {
    below: u32,
    above: u32,
    part: f32,
}

fn share_of(i: u32, fine: u32, coarse: u32, closed: bool) -> Share {
    if (fine == coarse) {
        return Share(i, i, 0.0);
    }
    let intervals = select(fine - 1u, fine, closed);
    let coarse_intervals = select(coarse - 1u, coarse, closed);
    let below = i / 2u;
    // In units of 1/intervals.
    let rest = (i % 2u) * coarse_intervals + (2u * coarse_intervals - intervals) * below;
    let is_last = below + 1u == coarse;
    let above = select(below + 1u, select(below, 0u, closed), is_last);
    return Share(below, above, f32(rest) / f32(intervals));
}

// The share of a coarser place in a finer one.
fn weight_of(coarser: u32, share: Share) -> f32 {
    var weight = 0.0;
    if (share.below == coarser) {
        weight = 1.0 - share.part;
    }
    if (share.above == coarser && share.part > 0.0) {
        weight += share.part;
    }
    return weight;
}

// The candidates, at most four, for finer places that a coarser one has a share in; `fine` for none.
fn candidate(t: u32, coarser: u32, fine: u32, coarse: u32, closed: bool) -> u32 {
    if (fine == coarse) {
        return select(fine, coarser, t == 0u);
    }
    let two_on = 2u * coarser + t;
    if (closed) {
        let on = select(two_on + fine, two_on, two_on >= 2u) - 2u;
        return select(fine, select(on, on - fine, on >= fine), t < fine);
    }
    return select(fine, two_on - 2u, two_on >= 2u && two_on - 2u < fine);
}
