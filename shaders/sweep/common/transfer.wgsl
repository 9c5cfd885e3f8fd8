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
    let above = select(min(below + 1u, coarse - 1u), (below + 1u) % coarse, closed);
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
    if (closed) {
        return select(fine, (2u * coarser + 2u * fine + t - 2u) % fine, t < fine);
    }
    let two_on = 2u * coarser + t;
    return select(fine, two_on - 2u, two_on >= 2u && two_on - 2u < fine);
}
