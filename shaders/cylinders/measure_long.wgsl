// Distances and statistics of the faces with many points; a workgroup takes one face at a time. Order
// statistics by selection on the keys, up to four at once: the first 11 bits, then three times seven.

// 1: the pass `distance` has written the keys.
override KEYED: u32 = 0u;

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<vec4u>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// Face after face, its bottom triangle's and its top one's.
@group(0) @binding(5) var<storage, read_write> triangle_values: array<u32>;
@group(0) @binding(6) var<storage, read_write> triangle_support: array<TriangleSupport>;
// Counts those that were measured to the end: some drivers end loops early without an error, and the host must
// not take such a face for a result.
@group(0) @binding(7) var<storage, read_write> listed_faces: array<atomic<u32>>;
// One key per point.
@group(0) @binding(8) var<storage, read_write> keys: array<u32>;

// Invocations per workgroup, 256 or more.
override THREADS: u32 = 256u;

// 2048 bins of the first round, then 128 for each of four ranks.
var<workgroup> histogram: array<atomic<u32>, 2048>;
var<workgroup> chosen: vec4u;
var<workgroup> rest: vec4u;
// Of bottom and top: points, those below the bounds, those kept; and the fixed-point sums of the kept
// distances and of their sizes, or first of all distances.
var<workgroup> number: array<atomic<u32>, 2>;
var<workgroup> below: array<atomic<u32>, 2>;
var<workgroup> kept: array<atomic<u32>, 2>;
var<workgroup> sum_low: array<atomic<u32>, 4>;
var<workgroup> sum_high: array<atomic<u32>, 4>;
var<workgroup> shared_count: u32;
// Keys that the last loop has visited.
var<workgroup> seen: atomic<u32>;

fn add_to_sum(which: u32, x: Wide) {
    let old = atomicAdd(&sum_low[which], x.low);
    let carry = select(0u, 1u, old + x.low < old);
    atomicAdd(&sum_high[which], x.high + carry);
}

fn sum_of(which: u32) -> Wide {
    return Wide(atomicLoad(&sum_low[which]), atomicLoad(&sum_high[which]));
}

// Keys of a face from place i on, THREADS apart: read together, since a device waits longer for memory than it
// counts. EMPTY beyond the face's end.
fn four_keys(i: u32, end: u32) -> vec4u {
    let places = vec4u(i, i + THREADS, i + 2u * THREADS, i + 3u * THREADS);
    let within = min(places, vec4u(end - 1u));
    let four = vec4u(keys[within.x], keys[within.y], keys[within.z], keys[within.w]);
    return select(four, vec4u(EMPTY), places >= vec4u(end));
}

// Counts a key by its first 11 bits.
fn count_first(key: u32) {
    if (key != EMPTY) {
        atomicAdd(&histogram[key >> 21u], 1u);
    }
}

// Counts a key for each of the ranks whose higher bits it has.
fn count(key: u32, prefix: vec4u, shift: u32) {
    let digit = (key >> shift) & 0x7fu;
    let same = vec4u((key >> shift) >> 7u) == ((prefix >> vec4u(shift)) >> vec4u(7u));
    if (!any(same) || key == EMPTY) {
        return;
    }
    if (same.x) {
        atomicAdd(&histogram[digit], 1u);
    }
    if (same.y) {
        atomicAdd(&histogram[128u + digit], 1u);
    }
    if (same.z) {
        atomicAdd(&histogram[256u + digit], 1u);
    }
    if (same.w) {
        atomicAdd(&histogram[384u + digit], 1u);
    }
}

// Puts the keys at four ranks among the keys of a face into `chosen`; what a rank beyond them gives is not
// used.
fn select_four(begin: u32, end: u32, ranks: vec4u, local: u32) {
    for (var bin = local; bin < 2048u; bin += THREADS) {
        atomicStore(&histogram[bin], 0u);
    }
    if (local == 0u) {
        chosen = vec4u(0u);
        rest = ranks;
    }
    workgroupBarrier();
    for (var i = begin + local; i < end; i += 4u * THREADS) {
        let four = four_keys(i, end);
        count_first(four.x);
        count_first(four.y);
        count_first(four.z);
        count_first(four.w);
    }
    workgroupBarrier();
    var own = 0u;
    if (local < 256u) {
        for (var bin = 8u * local; bin < 8u * local + 8u; bin++) {
            own += atomicLoad(&histogram[bin]);
        }
    }
    let before = inclusive_scan(own, local) - own;
    for (var which = 0u; which < 4u; which++) {
        let wanted = ranks[which];
        if (before <= wanted && wanted < before + own) {
            var bin = 8u * local;
            var left = wanted - before;
            for (; atomicLoad(&histogram[bin]) <= left; bin++) {
                left -= atomicLoad(&histogram[bin]);
            }
            chosen[which] = bin << 21u;
            rest[which] = left;
        }
    }
    workgroupBarrier();
    for (var round = 0u; round < 3u; round++) {
        let shift = 14u - 7u * round;
        for (var bin = local; bin < 512u; bin += THREADS) {
            atomicStore(&histogram[bin], 0u);
        }
        let prefix = chosen;
        let wanted = rest;
        workgroupBarrier();
        for (var i = begin + local; i < end; i += 4u * THREADS) {
            let four = four_keys(i, end);
            count(four.x, prefix, shift);
            count(four.y, prefix, shift);
            count(four.z, prefix, shift);
            count(four.w, prefix, shift);
        }
        workgroupBarrier();
        var counts = vec4u(0u);
        if (local < 128u) {
            for (var which = 0u; which < 4u; which++) {
                counts[which] = atomicLoad(&histogram[128u * which + local]);
            }
        }
        let upto = inclusive_scan_of_four(counts, local);
        for (var which = 0u; which < 4u; which++) {
            let smaller = upto[which] - counts[which];
            if (smaller <= wanted[which] && wanted[which] < upto[which]) {
                chosen[which] = prefix[which] | (local << shift);
                rest[which] = wanted[which] - smaller;
            }
        }
        workgroupBarrier();
    }
}

// An invocation's share of the sums of the keys within bounds.
struct Share {
    kept: u32,
    below: u32,
    sum: Wide,
    size: Wide,
}

const NO_SHARE: Share = Share(0u, 0u, Wide(0u, 0u), Wide(0u, 0u));

fn plus(share: Share, d: f32, bounds: Bounds, scale: f32) -> Share {
    if (d < bounds.low) {
        return Share(share.kept, share.below + 1u, share.sum, share.size);
    }
    if (d <= bounds.high) {
        let step = fixed(d, scale);
        let sum = add_wide(share.sum, widen(step));
        return Share(share.kept + 1u, share.below, sum, add_wide(share.size, widen(abs(step))));
    }
    return share;
}

// Shares of both triangles, and the number of keys among which they were found.
struct Shares {
    seen: u32,
    bottom: Share,
    top: Share,
}

fn with_key(shares: Shares, key: u32, bottom: Bounds, top: Bounds, rule: Cylinder) -> Shares {
    if (key == EMPTY) {
        return shares;
    }
    let d = unpacked(key, rule.unit);
    if ((key >> 31u) == 0u) {
        return Shares(shares.seen + 1u, plus(shares.bottom, d, bottom, rule.scale), shares.top);
    }
    return Shares(shares.seen + 1u, shares.bottom, plus(shares.top, d, top, rule.scale));
}

fn add_share(half: u32, share: Share) {
    atomicAdd(&kept[half], share.kept);
    atomicAdd(&below[half], share.below);
    add_to_sum(half, share.sum);
    add_to_sum(2u + half, share.size);
}

// Sums the distances within bounds. All invocations must call it.
fn sum_within(begin: u32, end: u32, bottom: Bounds, top: Bounds, rule: Cylinder, local: u32) {
    if (local < 4u) {
        atomicStore(&sum_low[local], 0u);
        atomicStore(&sum_high[local], 0u);
    }
    if (local < 2u) {
        atomicStore(&kept[local], 0u);
        atomicStore(&below[local], 0u);
    }
    if (local == 0u) {
        atomicStore(&seen, 0u);
    }
    workgroupBarrier();
    var shares = Shares(0u, NO_SHARE, NO_SHARE);
    for (var i = begin + local; i < end; i += 4u * THREADS) {
        let four = four_keys(i, end);
        shares = with_key(shares, four.x, bottom, top, rule);
        shares = with_key(shares, four.y, bottom, top, rule);
        shares = with_key(shares, four.z, bottom, top, rule);
        shares = with_key(shares, four.w, bottom, top, rule);
    }
    atomicAdd(&seen, shares.seen);
    add_share(0u, shares.bottom);
    add_share(1u, shares.top);
    workgroupBarrier();
}

fn bounds_of(half: u32, n: u32, quartiles: vec2u, unit: f32) -> Bounds {
    if (n < 2u || parameters.outliers == OUTLIERS_NONE) {
        return EVERYTHING;
    }
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        return deviation(mean_of(sum_of(half), unit, n));
    }
    return box_plot(unpacked(quartiles.x, unit), unpacked(quartiles.y, unit));
}

@compute @workgroup_size(THREADS)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    if (local == 0u) {
        shared_count = atomicLoad(&listed_faces[LONG_COUNT]);
    }
    let long_count = workgroupUniformLoad(&shared_count);
    for (var index = workgroup_index(group, groups); index < long_count; index += groups.x * groups.y) {
        let face_of_all = atomicLoad(&listed_faces[FIRST_LISTED + index]);
        let cylinder = face_of_all / parameters.faces;
        let rule = cylinders[cylinder];
        let begin = offsets[face_of_all];
        let end = offsets[face_of_all + 1u];
        let corners = corners_of(face_of_all, cylinder);
        if (local < 2u) {
            atomicStore(&number[local], 0u);
        }
        workgroupBarrier();
        var own_number = vec2u(0u);
        if (KEYED == 0u) {
            for (var i = begin + local; i < end; i += THREADS) {
                let key = key_of_point(grouped[i], corners, rule.scale);
                keys[i] = key;
                own_number += vec2u(1u - (key >> 31u), key >> 31u);
            }
        } else {
            for (var i = begin + local; i < end; i += 4u * THREADS) {
                let four = four_keys(i, end);
                let valid = select(vec4u(1u), vec4u(0u), four == vec4u(EMPTY));
                let tops = (four >> vec4u(31u)) * valid;
                let top = tops.x + tops.y + tops.z + tops.w;
                own_number += vec2u(valid.x + valid.y + valid.z + valid.w - top, top);
            }
        }
        atomicAdd(&number[0], own_number.x);
        atomicAdd(&number[1], own_number.y);
        storageBarrier();
        workgroupBarrier();

        let n = vec2u(atomicLoad(&number[0]), atomicLoad(&number[1]));
        if (parameters.outliers == OUTLIERS_IQR) {
            let first = vec2u(first_quartile(n.x), n.x + first_quartile(n.y));
            let third = vec2u(third_quartile(n.x), n.x + third_quartile(n.y));
            select_four(begin, end, vec4u(first.x, third.x, first.y, third.y), local);
        }
        if (parameters.outliers == OUTLIERS_DEVIATION) {
            sum_within(begin, end, EVERYTHING, EVERYTHING, rule, local);
        }
        let bottom = bounds_of(0u, n.x, chosen.xy, rule.unit);
        let top = bounds_of(1u, n.y, chosen.zw, rule.unit);
        workgroupBarrier();
        sum_within(begin, end, bottom, top, rule, local);
        let count_kept = vec2u(atomicLoad(&kept[0]), atomicLoad(&kept[1]));
        if (parameters.statistic == STATISTIC_MEDIAN) {
            let x = atomicLoad(&below[0]) + median(count_kept.x);
            let y = n.x + atomicLoad(&below[1]) + median(count_kept.y);
            select_four(begin, end, vec4u(x, x, y, y), local);
        }
        if (local < 2u) {
            var word = NO_VALUE;
            var own = TriangleSupport(count_kept[local], 0.0);
            if (own.kept > 0u) {
                var value = mean_of(sum_of(local), rule.unit, own.kept);
                if (parameters.statistic == STATISTIC_MEDIAN) {
                    value = unpacked(chosen[2u * local], rule.unit);
                }
                word = value_word(value);
                own.residual = mean_of(sum_of(2u + local), rule.unit, own.kept);
            }
            let triangle = 2u * face_of_all + local;
            triangle_values[triangle] = word;
            // Only the last iteration's is used.
            if (parameters.last == 1u) {
                triangle_support[triangle] = own;
            }
        }
        if (local == 0u && atomicLoad(&seen) == end - begin) {
            atomicAdd(&listed_faces[LONG_DONE], 1u);
        }
        workgroupBarrier();
    }
}
