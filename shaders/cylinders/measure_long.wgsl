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
// Sums over the invocations, each in copies, so that those which add at the same time seldom add to the same word.
var<workgroup> sums: array<atomic<u32>, 208>;
var<workgroup> totals: array<u32, 13>;
var<workgroup> shared_count: u32;

const COPIES: u32 = 16u;
// The places of the sums. Of bottom and top: the points, later those kept; and those below the bounds.
const KEPT: u32 = 0u;
const BELOW: u32 = 2u;
// Keys that the last loop has visited.
const SEEN: u32 = 4u;
// Low and high words of the fixed-point sums of the kept distances and of their sizes, or first of all distances.
const LOW: u32 = 5u;
const HIGH: u32 = 9u;

fn clear_sums(local: u32) {
    for (var i = local; i < 13u * COPIES; i += THREADS) {
        atomicStore(&sums[i], 0u);
    }
    workgroupBarrier();
}

fn add_to(which: u32, x: u32, local: u32) {
    atomicAdd(&sums[which * COPIES + local % COPIES], x);
}

fn add_to_sum(which: u32, x: Wide, local: u32) {
    let copy = local % COPIES;
    let old = atomicAdd(&sums[(LOW + which) * COPIES + copy], x.low);
    let carry = select(0u, 1u, old + x.low < old);
    atomicAdd(&sums[(HIGH + which) * COPIES + copy], x.high + carry);
}

// Adds up the copies, once all invocations have added to them. All must call it.
fn add_up(local: u32) {
    workgroupBarrier();
    if (local < LOW) {
        var total = 0u;
        for (var copy = 0u; copy < COPIES; copy++) {
            total += atomicLoad(&sums[local * COPIES + copy]);
        }
        totals[local] = total;
    } else if (local < HIGH) {
        let high = local + HIGH - LOW;
        var total = Wide(0u, 0u);
        for (var copy = 0u; copy < COPIES; copy++) {
            let part = Wide(atomicLoad(&sums[local * COPIES + copy]), atomicLoad(&sums[high * COPIES + copy]));
            total = add_wide(total, part);
        }
        totals[local] = total.low;
        totals[high] = total.high;
    }
    workgroupBarrier();
}

fn sum_of(which: u32) -> Wide {
    return Wide(totals[LOW + which], totals[HIGH + which]);
}

// Four places of an invocation from i on.
fn four_places(i: u32) -> vec4u {
    return vec4u(i, i + THREADS, i + 2u * THREADS, i + 3u * THREADS);
}

// Their keys. EMPTY beyond the face's end.
fn four_keys(i: u32, end: u32) -> vec4u {
    let at = min(four_places(i), vec4u(end - 1u));
    let four = vec4u(keys[at.x], keys[at.y], keys[at.z], keys[at.w]);
    return select(four, vec4u(EMPTY), four_places(i) >= vec4u(end));
}

// Sixteen keys, read together, since a device waits longer for memory than it counts.
struct Keys {
    a: vec4u,
    b: vec4u,
    c: vec4u,
    d: vec4u,
}


fn keys_from(i: u32, end: u32) -> Keys {
    if (i + 4u * THREADS >= end) {
        return Keys(four_keys(i, end), vec4u(EMPTY), vec4u(EMPTY), vec4u(EMPTY));
    }
    return Keys(
        four_keys(i, end),
        four_keys(i + 4u * THREADS, end),
        four_keys(i + 8u * THREADS, end),
        four_keys(i + 12u * THREADS, end),
    );
}

// Counts a key by its first 11 bits.
fn count_first(key: u32) {
    if (key != EMPTY) {
        atomicAdd(&histogram[key >> 21u], 1u);
    }
}

fn count_first_of_four(four: vec4u) {
    count_first(four.x);
    count_first(four.y);
    count_first(four.z);
    count_first(four.w);
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

fn count_four(four: vec4u, prefix: vec4u, shift: u32) {
    count(four.x, prefix, shift);
    count(four.y, prefix, shift);
    count(four.z, prefix, shift);
    count(four.w, prefix, shift);
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
    for (var i = begin + local; i < end; i += 16u * THREADS) {
        let k = keys_from(i, end);
        count_first_of_four(k.a);
        count_first_of_four(k.b);
        count_first_of_four(k.c);
        count_first_of_four(k.d);
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
        for (var i = begin + local; i < end; i += 16u * THREADS) {
            let k = keys_from(i, end);
            count_four(k.a, prefix, shift);
            count_four(k.b, prefix, shift);
            count_four(k.c, prefix, shift);
            count_four(k.d, prefix, shift);
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

fn with_four(shares: Shares, four: vec4u, bottom: Bounds, top: Bounds, rule: Cylinder) -> Shares {
    var sum = with_key(shares, four.x, bottom, top, rule);
    sum = with_key(sum, four.y, bottom, top, rule);
    sum = with_key(sum, four.z, bottom, top, rule);
    return with_key(sum, four.w, bottom, top, rule);
}

fn add_share(half: u32, share: Share, local: u32) {
    add_to(KEPT + half, share.kept, local);
    add_to(BELOW + half, share.below, local);
    add_to_sum(half, share.sum, local);
    add_to_sum(2u + half, share.size, local);
}

// Sums the distances within bounds. All invocations must call it.
fn sum_within(begin: u32, end: u32, bottom: Bounds, top: Bounds, rule: Cylinder, local: u32) {
    clear_sums(local);
    var shares = Shares(0u, NO_SHARE, NO_SHARE);
    for (var i = begin + local; i < end; i += 16u * THREADS) {
        let k = keys_from(i, end);
        shares = with_four(shares, k.a, bottom, top, rule);
        shares = with_four(shares, k.b, bottom, top, rule);
        shares = with_four(shares, k.c, bottom, top, rule);
        shares = with_four(shares, k.d, bottom, top, rule);
    }
    add_to(SEEN, shares.seen, local);
    add_share(0u, shares.bottom, local);
    add_share(1u, shares.top, local);
    add_up(local);
}

// Writes the key of a point at place i, and counts it with those of bottom and top distances.
fn number_of_key(i: u32, end: u32, point: vec4u, a: f32, shape: Face, scale: f32) -> vec2u {
    if (i >= end) {
        return vec2u(0u);
    }
    let nearer = distance_to_face(from_corner(point, a), shape);
    let key = packed_key(nearer.distance, nearer.top, scale);
    keys[i] = key;
    return vec2u(1u - (key >> 31u), key >> 31u);
}

// The numbers of keys of bottom and top distances among four.
fn numbers_of(four: vec4u) -> vec2u {
    let valid = select(vec4u(1u), vec4u(0u), four == vec4u(EMPTY));
    let tops = (four >> vec4u(31u)) * valid;
    let top = tops.x + tops.y + tops.z + tops.w;
    return vec2u(valid.x + valid.y + valid.z + valid.w - top, top);
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
        let face = face_of_all % parameters.faces;
        let rule = cylinders[cylinder];
        let begin = offsets[face_of_all];
        let end = offsets[face_of_all + 1u];
        let level = face / parameters.nodes;
        let j = face % parameters.nodes;
        let k = select(j + 1u, 0u, j + 1u == parameters.nodes);
        let row = cylinder * parameters.node_count + level * parameters.nodes;
        let a = radii[row + j];
        let above = row + parameters.nodes;
        let shape = face_of_corners(radii[row + k] - a, radii[above + k] - a, radii[above + j] - a);
        clear_sums(local);
        var own_number = vec2u(0u);
        if (KEYED == 0u) {
            for (var i = begin + local; i < end; i += 4u * THREADS) {
                let at = min(four_places(i), vec4u(end - 1u));
                let p = grouped[at.x];
                let q = grouped[at.y];
                let r = grouped[at.z];
                let s = grouped[at.w];
                own_number += number_of_key(i, end, p, a, shape, rule.scale);
                own_number += number_of_key(i + THREADS, end, q, a, shape, rule.scale);
                own_number += number_of_key(i + 2u * THREADS, end, r, a, shape, rule.scale);
                own_number += number_of_key(i + 3u * THREADS, end, s, a, shape, rule.scale);
            }
        } else {
            for (var i = begin + local; i < end; i += 16u * THREADS) {
                let k = keys_from(i, end);
                own_number += numbers_of(k.a) + numbers_of(k.b) + numbers_of(k.c) + numbers_of(k.d);
            }
        }
        add_to(KEPT, own_number.x, local);
        add_to(KEPT + 1u, own_number.y, local);
        storageBarrier();
        add_up(local);

        let n = vec2u(totals[KEPT], totals[KEPT + 1u]);
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
        let count_kept = vec2u(totals[KEPT], totals[KEPT + 1u]);
        if (parameters.statistic == STATISTIC_MEDIAN) {
            let x = totals[BELOW] + median(count_kept.x);
            let y = n.x + totals[BELOW + 1u] + median(count_kept.y);
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
        if (local == 0u && totals[SEEN] == end - begin) {
            atomicAdd(&listed_faces[LONG_DONE], 1u);
        }
        workgroupBarrier();
    }
}
