// Distances and statistics of the faces with few points: LANES invocations per face, or MIDDLE_LANES for one of middle
// size, each with eight of its points, whose keys it has in registers. Order statistics by sorting, a network whose
// steps do not depend on the data. Invocations read each other's values through `exchange` and `value_at`: the two
// files that include this one differ in how.

override LANES: u32 = 8u;
override MIDDLE_LANES: u32 = 32u;
// 1: the faces of middle size, which are listed, instead of the short ones among all.
override MIDDLE: u32 = 0u;

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<vec4u>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// Face after face, its bottom triangle's and its top one's.
@group(0) @binding(5) var<storage, read_write> triangle_values: array<u32>;
@group(0) @binding(6) var<storage, read_write> triangle_support: array<TriangleSupport>;
@group(0) @binding(7) var<storage, read> listed_faces: array<u32>;

const THREADS: u32 = 128u;

// Most lanes a face with which the workgroup shares out the distances of all its faces point by point. With more, few
// places of a face's own invocations are without a point.
const MOST_SHARING_LANES: u32 = 2u;
// Points that it shares out at a time.
const CHUNK: u32 = 4u * THREADS;

// Their keys.
var<workgroup> shared_keys: array<u32, 512>;
// Of each of its faces: r of the corners a, b, b' and a', less that of a but for a; then the rest of `Face`.
var<workgroup> corners: array<vec4f, 128>;
var<workgroup> per_edges: array<vec4f, 128>;
var<workgroup> per_others: array<vec4f, 128>;

struct Keys {
    a: vec4u,
    b: vec4u,
}

// Sorts the keys of each invocation (Batcher's odd-even merge of eight).
fn sort_own(k: Keys) -> Keys {
    let p = vec4u(k.a.x, k.a.z, k.b.x, k.b.z);
    let q = vec4u(k.a.y, k.a.w, k.b.y, k.b.w);
    let l = min(p, q);
    let h = max(p, q);
    let r = vec4u(l.x, h.x, l.z, h.z);
    let s = vec4u(l.y, h.y, l.w, h.w);
    let m = min(r, s);
    let n = max(r, s);
    let inner_low = min(m.yw, n.xz);
    let inner_high = max(m.yw, n.xz);
    let first = vec4u(m.x, inner_low.x, inner_high.x, n.y);
    let second = vec4u(m.z, inner_low.y, inner_high.y, n.w);
    let low = min(first, second);
    let high = max(first, second);
    let t = min(low.zw, high.xy);
    let u = max(low.zw, high.xy);
    let v = vec3u(low.y, t.y, u.y);
    let w = vec3u(t.x, u.x, high.z);
    let e = min(v, w);
    let f = max(v, w);
    return Keys(vec4u(low.x, e.x, f.x, e.y), vec4u(f.y, e.z, f.z, high.w));
}

// Sorts the keys of each invocation where they rise and then fall.
fn merge_own(k: Keys) -> Keys {
    let low = min(k.a, k.b);
    let high = max(k.a, k.b);
    let p = vec4u(low.xy, high.xy);
    let q = vec4u(low.zw, high.zw);
    let m = min(p, q);
    let n = max(p, q);
    let r = vec4u(m.x, n.x, m.z, n.z);
    let s = vec4u(m.y, n.y, m.w, n.w);
    let l = min(r, s);
    let h = max(r, s);
    return Keys(vec4u(l.x, h.x, l.y, h.y), vec4u(l.z, h.z, l.w, h.w));
}

// The first step that merges the sorted halves of `span` invocations: the first key meets the last.
fn meet(k: Keys, span: u32, local: u32) -> Keys {
    let a = exchange(k.b.wzyx, span - 1u, local);
    let b = exchange(k.a.wzyx, span - 1u, local);
    let lower = (local & (span / 2u)) == 0u;
    return Keys(select(max(k.a, a), min(k.a, a), lower), select(max(k.b, b), min(k.b, b), lower));
}

// A later step: the keys of invocations that are `distance` apart meet.
fn halve(k: Keys, distance: u32, local: u32) -> Keys {
    let a = exchange(k.a, distance, local);
    let b = exchange(k.b, distance, local);
    let lower = (local & distance) == 0u;
    return Keys(select(max(k.a, a), min(k.a, a), lower), select(max(k.b, b), min(k.b, b), lower));
}

fn sorted(keys_of_lane: Keys, lanes: u32, local: u32) -> Keys {
    var k = sort_own(keys_of_lane);
    if (lanes >= 2u) {
        k = merge_own(meet(k, 2u, local));
    }
    if (lanes >= 4u) {
        k = merge_own(halve(meet(k, 4u, local), 1u, local));
    }
    if (lanes >= 8u) {
        k = merge_own(halve(halve(meet(k, 8u, local), 2u, local), 1u, local));
    }
    if (lanes >= 16u) {
        k = halve(halve(meet(k, 16u, local), 4u, local), 2u, local);
        k = merge_own(halve(k, 1u, local));
    }
    if (lanes >= 32u) {
        k = halve(halve(meet(k, 32u, local), 8u, local), 4u, local);
        k = merge_own(halve(halve(k, 2u, local), 1u, local));
    }
    return k;
}

// The sum over the invocations of a face.
fn sum_of_face(own: vec4u, lanes: u32, local: u32) -> vec4u {
    var sum = own;
    if (lanes >= 2u) {
        sum += exchange(sum, 1u, local);
    }
    if (lanes >= 4u) {
        sum += exchange(sum, 2u, local);
    }
    if (lanes >= 8u) {
        sum += exchange(sum, 4u, local);
    }
    if (lanes >= 16u) {
        sum += exchange(sum, 8u, local);
    }
    if (lanes >= 32u) {
        sum += exchange(sum, 16u, local);
    }
    return sum;
}

// The same of two numbers.
fn sum_of_pairs(own: vec2u, lanes: u32, local: u32) -> vec2u {
    return sum_of_face(vec4u(own, vec2u(0u)), lanes, local).xy;
}

// The key of that rank among the sorted keys of a face.
fn key_at(k: Keys, rank: u32, lanes: u32, local: u32) -> u32 {
    let four = select(k.a, k.b, (rank & 4u) != 0u);
    let two = select(four.xy, four.zw, (rank & 2u) != 0u);
    let own = select(two.x, two.y, (rank & 1u) != 0u);
    // Of the invocation that holds the rank; what a rank beyond all keys gives is not used.
    return value_at(own, local / lanes * lanes + min(rank / 8u, lanes - 1u), local);
}

// What is known of a face's keys, of its bottom triangle and its top one.
struct Sums {
    kept: vec2u,
    below: vec2u,
    // Fixed-point sums in two parts: of the lower 16 bits and of the rest.
    low: vec2u,
    high: vec2u,
    low_size: vec2u,
    high_size: vec2u,
}

// The same of an invocation's keys, x of all, y of those of the top triangle. `size` has the numbers kept from bit
// 23 on, since no face has more than 256 keys, and the upper parts of their sizes have 15 bits each.
struct OwnSums {
    below: vec2u,
    low: vec2u,
    high: vec2u,
    low_size: vec2u,
    size: vec2u,
}

const ONE_KEPT: u32 = 0x800000u;

fn add(sums: OwnSums, key: u32, bottom: Bounds, top: Bounds, rule: Cylinder) -> OwnSums {
    let is_top = (key >> 31u) == 1u;
    let d = unpacked(key, rule.unit);
    let low = select(bottom.low, top.low, is_top);
    let high = select(bottom.high, top.high, is_top);
    let is_key = key != EMPTY;
    let kept = is_key && d >= low && d <= high;
    let step = select(0, fixed(d, rule.scale), kept);
    let mask = vec2u(0xffffffffu, select(0u, 0xffffffffu, is_top));
    var own = sums;
    own.low += mask & vec2u(bitcast<u32>(step) & 0xffffu);
    own.high += mask & vec2u(bitcast<u32>(step >> 16u));
    var size = select(0u, ONE_KEPT, kept);
    // Of the sizes only the last iteration's are used.
    if (parameters.last == 1u) {
        own.low_size += mask & vec2u(bitcast<u32>(abs(step)) & 0xffffu);
        size += bitcast<u32>(abs(step)) >> 16u;
    }
    own.size += mask & vec2u(size);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        own.below += mask & vec2u(select(0u, 1u, is_key && d < low));
    }
    return own;
}

fn sums_of(k: Keys, bottom: Bounds, top: Bounds, rule: Cylinder, lanes: u32, local: u32) -> Sums {
    let none = vec2u(0u);
    var own = OwnSums(none, none, none, none, none);
    own = add(own, k.a.x, bottom, top, rule);
    own = add(own, k.a.y, bottom, top, rule);
    own = add(own, k.a.z, bottom, top, rule);
    own = add(own, k.a.w, bottom, top, rule);
    own = add(own, k.b.x, bottom, top, rule);
    own = add(own, k.b.y, bottom, top, rule);
    own = add(own, k.b.z, bottom, top, rule);
    own = add(own, k.b.w, bottom, top, rule);
    let sum = sum_of_face(vec4u(own.low, own.high), lanes, local);
    let size = sum_of_pairs(own.size, lanes, local);
    var low_size = none;
    if (parameters.last == 1u) {
        low_size = sum_of_pairs(own.low_size, lanes, local);
    }
    var below = none;
    if (parameters.statistic == STATISTIC_MEDIAN) {
        below = sum_of_pairs(own.below, lanes, local);
    }
    return Sums(
        apart(size / vec2u(ONE_KEPT)),
        apart(below),
        apart(sum.xy),
        apart(sum.zw),
        apart(low_size),
        apart(size % vec2u(ONE_KEPT)),
    );
}

// Bottom and top, from both and top.
fn apart(sum: vec2u) -> vec2u {
    return vec2u(sum.x - sum.y, sum.y);
}

fn join(low: u32, high: u32) -> Wide {
    let shifted = Wide(high << 16u, bitcast<u32>(bitcast<i32>(high) >> 16u));
    return add_wide(shifted, Wide(low, 0u));
}

fn bounds_of(half: u32, n: u32, quartiles: vec2f, all: Sums, unit: f32) -> Bounds {
    if (n < 2u || parameters.outliers == OUTLIERS_NONE) {
        return EVERYTHING;
    }
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        return deviation(mean_of(join(all.low[half], all.high[half]), unit, n));
    }
    return box_plot(quartiles.x, quartiles.y);
}

fn write_triangle(triangle: u32, half: u32, sums: Sums, median_key: u32, unit: f32) {
    let kept = sums.kept[half];
    var word = NO_VALUE;
    if (kept > 0u) {
        word = value_word(mean_of(join(sums.low[half], sums.high[half]), unit, kept));
        if (parameters.statistic == STATISTIC_MEDIAN) {
            word = value_word(unpacked(median_key, unit));
        }
    }
    triangle_values[triangle] = word;
    if (parameters.last == 1u) {
        var residual = 0.0;
        if (kept > 0u) {
            residual = mean_of(join(sums.low_size[half], sums.high_size[half]), unit, kept);
        }
        triangle_support[triangle] = TriangleSupport(kept, residual);
    }
}

// The key of a point.
fn key_of_point(p: vec4u, a: f32, face: Face, scale: f32) -> u32 {
    let nearer = distance_to_face(from_corner(p, a), face);
    return packed_key(nearer.distance, nearer.top, scale);
}

fn key_of_own(p: vec4u, is_point: bool, a: f32, face: Face, scale: f32) -> u32 {
    if (!is_point) {
        return EMPTY;
    }
    return key_of_point(p, a, face, scale);
}

// The keys of four points of an invocation, from the first-th of its face on. All are read before the first
// distance is computed.
fn four_keys(begin: u32, count: u32, first: u32, lanes: u32, a: f32, face: Face, scale: f32) -> vec4u {
    let at = vec4u(first, first + lanes, first + 2u * lanes, first + 3u * lanes);
    let places = vec4u(begin) + min(at, vec4u(max(count, 1u) - 1u));
    let p = grouped[places.x];
    let q = grouped[places.y];
    let r = grouped[places.z];
    let s = grouped[places.w];
    return vec4u(
        key_of_own(p, at.x < count, a, face, scale),
        key_of_own(q, at.y < count, a, face, scale),
        key_of_own(r, at.z < count, a, face, scale),
        key_of_own(s, at.w < count, a, face, scale),
    );
}

// Puts the key of a point at a place of the chunk, unless it is beyond the end or on a face that is not short.
fn share_out(i: u32, count: u32, p: vec4u, first_face: u32, scale: f32) {
    if (i >= count) {
        return;
    }
    let face = p.w - first_face;
    let o = per_others[face];
    if (o.w == 0.0) {
        return;
    }
    let r = corners[face];
    let e = per_edges[face];
    let shape = Face(r.y, r.z, r.w, e.x, e.y, e.z, e.w, o.x, o.y, o.z);
    shared_keys[i] = key_of_point(p, r.x, shape, scale);
}

// Computes the keys of a chunk of `count` points from `begin` on, which lie on the workgroup's faces from `first_face`
// on. All points of an invocation are read before its first distance is computed.
fn share_out_chunk(begin: u32, count: u32, first_face: u32, scale: f32, local: u32) {
    let at = vec4u(local, local + THREADS, local + 2u * THREADS, local + 3u * THREADS);
    let places = vec4u(begin) + min(at, vec4u(count - 1u));
    let p = grouped[places.x];
    let q = grouped[places.y];
    let r = grouped[places.z];
    let s = grouped[places.w];
    share_out(at.x, count, p, first_face, scale);
    share_out(at.y, count, q, first_face, scale);
    share_out(at.z, count, r, first_face, scale);
    share_out(at.w, count, s, first_face, scale);
}

// Four keys of an invocation with those of them that are in a chunk. `begin` is the place in it, or before it, where
// the face's points begin.
fn four_shared_keys(old: vec4u, begin: u32, count: u32, first: u32, lanes: u32) -> vec4u {
    let of_face = vec4u(first, first + lanes, first + 2u * lanes, first + 3u * lanes);
    // Beyond the chunk where they are before it.
    let at = vec4u(begin) + of_face;
    let four = vec4u(
        shared_keys[min(at.x, CHUNK - 1u)],
        shared_keys[min(at.y, CHUNK - 1u)],
        shared_keys[min(at.z, CHUNK - 1u)],
        shared_keys[min(at.w, CHUNK - 1u)],
    );
    return select(old, four, at < vec4u(CHUNK) & of_face < vec4u(count));
}

// Measures the face of the invocation, if it has one (NONE otherwise) and no more than 8 · lanes points. The
// workgroup's faces are `faces_here` consecutive ones from `first_face` on, or any where `faces_here` is 0.
fn measure(face_of_all: u32, cylinder: u32, first_face: u32, faces_here: u32, lanes: u32, local: u32) {
    let lane = local % lanes;
    let is_face = face_of_all != NONE;
    let rule = cylinders[cylinder];
    var begin = 0u;
    var points = 0u;
    var a = 0.0;
    var shape = Face();
    if (is_face) {
        begin = offsets[face_of_all];
        points = offsets[face_of_all + 1u] - begin;
        let face = face_of_all - cylinder * parameters.faces;
        let level = face / parameters.nodes;
        let j = face - level * parameters.nodes;
        let k = select(j + 1u, 0u, j + 1u == parameters.nodes);
        let row = cylinder * parameters.node_count + level * parameters.nodes;
        let above = row + parameters.nodes;
        a = radii[row + j];
        shape = face_of_corners(radii[row + k] - a, radii[above + k] - a, radii[above + j] - a);
    }
    let is_own = is_face && points <= 8u * lanes;
    let count = select(0u, points, is_own);
    var k = Keys(vec4u(EMPTY), vec4u(EMPTY));
    if (MIDDLE == 0u && LANES <= MOST_SHARING_LANES) {
        let begin_shared = offsets[first_face];
        let end_shared = offsets[first_face + faces_here];
        if (lane == 0u) {
            let slot = local / lanes;
            corners[slot] = vec4f(a, shape.b, shape.b_above, shape.a_above);
            per_edges[slot] = vec4f(shape.per_ab, shape.per_aa, shape.per_diagonal, shape.per_bb);
            per_others[slot] = vec4f(shape.per_across, shape.per_bottom, shape.per_top, select(0.0, 1.0, is_own));
        }
        for (var chunk = begin_shared; chunk < end_shared; chunk += CHUNK) {
            workgroupBarrier();
            share_out_chunk(chunk, min(end_shared - chunk, CHUNK), first_face, rule.scale, local);
            workgroupBarrier();
            let begin_here = begin - chunk;
            k.a = four_shared_keys(k.a, begin_here, count, lane, lanes);
            k.b = four_shared_keys(k.b, begin_here, count, lane + 4u * lanes, lanes);
        }
    } else {
        k.a = four_keys(begin, count, lane, lanes, a, shape, rule.scale);
        k.b = four_keys(begin, count, lane + 4u * lanes, lanes, a, shape, rule.scale);
    }
    // Top and empty keys have the highest bit.
    let others = (k.a >> vec4u(31u)) + (k.b >> vec4u(31u));
    let own_others = others.x + others.y + others.z + others.w;
    let bottoms = 8u * lanes - sum_of_face(vec4u(own_others, 0u, 0u, 0u), lanes, local).x;
    let number = vec2u(bottoms, count - bottoms);

    var quartiles = vec4f(0.0);
    if (parameters.outliers == OUTLIERS_IQR || parameters.statistic == STATISTIC_MEDIAN) {
        k = sorted(k, lanes, local);
    }
    if (parameters.outliers == OUTLIERS_IQR) {
        let first = vec2u(first_quartile(number.x), bottoms + first_quartile(number.y));
        let third = vec2u(third_quartile(number.x), bottoms + third_quartile(number.y));
        quartiles = vec4f(
            unpacked(key_at(k, first.x, lanes, local), rule.unit),
            unpacked(key_at(k, third.x, lanes, local), rule.unit),
            unpacked(key_at(k, first.y, lanes, local), rule.unit),
            unpacked(key_at(k, third.y, lanes, local), rule.unit),
        );
    }
    var sums = Sums();
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        sums = sums_of(k, EVERYTHING, EVERYTHING, rule, lanes, local);
    }
    let bottom = bounds_of(0u, number.x, quartiles.xy, sums, rule.unit);
    let top = bounds_of(1u, number.y, quartiles.zw, sums, rule.unit);
    sums = sums_of(k, bottom, top, rule, lanes, local);
    var medians = vec2u(0u);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        medians = vec2u(
            key_at(k, sums.below.x + median(sums.kept.x), lanes, local),
            key_at(k, bottoms + sums.below.y + median(sums.kept.y), lanes, local),
        );
    }

    if (lanes == 1u) {
        if (is_own) {
            write_triangle(2u * face_of_all, 0u, sums, medians.x, rule.unit);
            write_triangle(2u * face_of_all + 1u, 1u, sums, medians.y, rule.unit);
        }
    } else if (is_own && lane < 2u) {
        write_triangle(2u * face_of_all + lane, lane, sums, medians[lane], rule.unit);
    }
}

// The block-th 128 / MIDDLE_LANES faces of middle size.
fn measure_middle(block: u32, local: u32) {
    let index = block * (THREADS / MIDDLE_LANES) + local / MIDDLE_LANES;
    var face_of_all = NONE;
    var cylinder = 0u;
    if (index < listed_faces[MIDDLE_COUNT]) {
        face_of_all = listed_faces[arrayLength(&listed_faces) - 1u - index];
        cylinder = face_of_all / parameters.faces;
    }
    measure(face_of_all, cylinder, 0u, 0u, MIDDLE_LANES, local);
}

// The block-th 128 / LANES faces of a cylinder.
fn measure_short(block: u32, cylinder: u32, local: u32) {
    let first = block * (THREADS / LANES);
    let index = first + local / LANES;
    let before = cylinder * parameters.faces;
    let face_of_all = select(NONE, before + index, index < parameters.faces);
    // A few workgroups may be beyond the last face.
    let first_here = min(first, parameters.faces);
    let faces_here = min(THREADS / LANES, parameters.faces - first_here);
    measure(face_of_all, cylinder, before + first_here, faces_here, LANES, local);
}

// What one workgroup does: the first of each cylinder's take the faces of middle size in turn, together with those of
// the other cylinders, and each of the others a block of short ones.
fn measure_blocks(index: u32, groups: u32, cylinder: u32, local: u32) {
    if (MIDDLE == 0u) {
        measure_short(index, cylinder, local);
        return;
    }
    let faces_here = THREADS / MIDDLE_LANES;
    let blocks = (listed_faces[MIDDLE_COUNT] + faces_here - 1u) / faces_here;
    for (var block = index; block < blocks; block += groups) {
        measure_middle(block, local);
        workgroupBarrier();
    }
}
