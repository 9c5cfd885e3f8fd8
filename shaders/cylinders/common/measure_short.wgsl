// Distances and statistics of the faces with few points: LANES invocations per face, each with eight of its
// points, whose keys it has in registers. Order statistics by sorting, a network whose steps do not depend on the
// data. Invocations read each other's values through `exchange` and `value_at`: the two files that include this one
// differ in how.

override LANES: u32 = 8u;
// 1: the faces of middle size, which are listed, instead of the short ones among all.
override MIDDLE: u32 = 0u;

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<vec4f>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// Per cylinder those of its bottom triangles, then those of its top ones.
@group(0) @binding(5) var<storage, read_write> triangle_values: array<u32>;
@group(0) @binding(6) var<storage, read_write> triangle_support: array<TriangleSupport>;
@group(0) @binding(7) var<storage, read> listed_faces: array<u32>;

const THREADS: u32 = 128u;

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

fn sorted(keys_of_lane: Keys, local: u32) -> Keys {
    var k = sort_own(keys_of_lane);
    if (LANES >= 2u) {
        k = merge_own(meet(k, 2u, local));
    }
    if (LANES >= 4u) {
        k = merge_own(halve(meet(k, 4u, local), 1u, local));
    }
    if (LANES >= 8u) {
        k = merge_own(halve(halve(meet(k, 8u, local), 2u, local), 1u, local));
    }
    if (LANES >= 16u) {
        k = halve(halve(meet(k, 16u, local), 4u, local), 2u, local);
        k = merge_own(halve(k, 1u, local));
    }
    if (LANES >= 32u) {
        k = halve(halve(meet(k, 32u, local), 8u, local), 4u, local);
        k = merge_own(halve(halve(k, 2u, local), 1u, local));
    }
    return k;
}

// The sum over the invocations of a face.
fn sum_of_face(own: vec4u, local: u32) -> vec4u {
    var sum = own;
    if (LANES >= 2u) {
        sum += exchange(sum, 1u, local);
    }
    if (LANES >= 4u) {
        sum += exchange(sum, 2u, local);
    }
    if (LANES >= 8u) {
        sum += exchange(sum, 4u, local);
    }
    if (LANES >= 16u) {
        sum += exchange(sum, 8u, local);
    }
    if (LANES >= 32u) {
        sum += exchange(sum, 16u, local);
    }
    return sum;
}

// The same of two numbers.
fn sum_of_pairs(own: vec2u, local: u32) -> vec2u {
    return sum_of_face(vec4u(own, vec2u(0u)), local).xy;
}

// The key of that rank among the sorted keys of a face.
fn key_at(k: Keys, rank: u32, local: u32) -> u32 {
    let four = select(k.a, k.b, (rank & 4u) != 0u);
    let two = select(four.xy, four.zw, (rank & 2u) != 0u);
    let own = select(two.x, two.y, (rank & 1u) != 0u);
    // Of the invocation that holds the rank; what a rank beyond all keys gives is not used.
    return value_at(own, local / LANES * LANES + min(rank / 8u, LANES - 1u), local);
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

fn sums_of(k: Keys, bottom: Bounds, top: Bounds, rule: Cylinder, local: u32) -> Sums {
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
    let sum = sum_of_face(vec4u(own.low, own.high), local);
    let size = sum_of_pairs(own.size, local);
    var low_size = none;
    if (parameters.last == 1u) {
        low_size = sum_of_pairs(own.low_size, local);
    }
    var below = none;
    if (parameters.statistic == STATISTIC_MEDIAN) {
        below = sum_of_pairs(own.below, local);
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

// A face of the workgroup's, among those of all cylinders; NONE where there are no more.
fn face_at(block: u32, cylinder: u32, slot: u32) -> u32 {
    let index = block * (THREADS / LANES) + slot;
    if (MIDDLE == 1u) {
        if (index < listed_faces[MIDDLE_COUNT]) {
            return listed_faces[arrayLength(&listed_faces) - 1u - index];
        }
    } else if (index < parameters.faces) {
        return cylinder * parameters.faces + index;
    }
    return NONE;
}

// The key of a point.
fn key_of_point(p: vec4f, is_point: bool, a: f32, face: Face, scale: f32) -> u32 {
    if (!is_point) {
        return EMPTY;
    }
    let nearer = distance_to_face(vec3f(p.x - a, p.yz), face);
    return packed_key(nearer.distance, nearer.top, scale);
}

// The keys of four points of an invocation, from the first-th of its face on. All are read before the first
// distance is computed.
fn four_keys(begin: u32, count: u32, first: u32, a: f32, face: Face, scale: f32) -> vec4u {
    let last = max(count, 1u) - 1u;
    let at = vec4u(first, first + LANES, first + 2u * LANES, first + 3u * LANES);
    let places = vec4u(begin) + min(at, vec4u(last));
    let p = grouped[places.x];
    let q = grouped[places.y];
    let r = grouped[places.z];
    let s = grouped[places.w];
    return vec4u(
        key_of_point(p, at.x < count, a, face, scale),
        key_of_point(q, at.y < count, a, face, scale),
        key_of_point(r, at.z < count, a, face, scale),
        key_of_point(s, at.w < count, a, face, scale),
    );
}

// The block-th 128 / LANES faces of a cylinder, or of the list.
fn measure(block: u32, cylinder: u32, local: u32) {
    let slot = local / LANES;
    let lane = local % LANES;
    let face_of_all = face_at(block, cylinder, slot);
    let is_face = face_of_all != NONE;
    var owner = cylinder;
    if (MIDDLE == 1u) {
        owner = select(0u, face_of_all / parameters.faces, is_face);
    }
    let rule = cylinders[owner];
    var begin = 0u;
    var points = 0u;
    var a = 0.0;
    var shape = Face();
    if (is_face) {
        begin = offsets[face_of_all];
        points = offsets[face_of_all + 1u] - begin;
        let face = face_of_all - owner * parameters.faces;
        let level = face / parameters.nodes;
        let j = face - level * parameters.nodes;
        let k = select(j + 1u, 0u, j + 1u == parameters.nodes);
        let row = owner * parameters.node_count + level * parameters.nodes;
        let above = row + parameters.nodes;
        a = radii[row + j];
        shape = face_of_corners(radii[row + k] - a, radii[above + k] - a, radii[above + j] - a);
    }
    let is_own = is_face && points <= 8u * LANES;
    let count = select(0u, points, is_own);
    var k = Keys(
        four_keys(begin, count, lane, a, shape, rule.scale),
        four_keys(begin, count, lane + 4u * LANES, a, shape, rule.scale),
    );
    // Top and empty keys have the highest bit.
    let others = (k.a >> vec4u(31u)) + (k.b >> vec4u(31u));
    let own_others = others.x + others.y + others.z + others.w;
    let bottoms = 8u * LANES - sum_of_face(vec4u(own_others, 0u, 0u, 0u), local).x;
    let number = vec2u(bottoms, count - bottoms);

    var quartiles = vec4f(0.0);
    if (parameters.outliers == OUTLIERS_IQR || parameters.statistic == STATISTIC_MEDIAN) {
        k = sorted(k, local);
    }
    if (parameters.outliers == OUTLIERS_IQR) {
        let first = vec2u(first_quartile(number.x), bottoms + first_quartile(number.y));
        let third = vec2u(third_quartile(number.x), bottoms + third_quartile(number.y));
        quartiles = vec4f(
            unpacked(key_at(k, first.x, local), rule.unit),
            unpacked(key_at(k, third.x, local), rule.unit),
            unpacked(key_at(k, first.y, local), rule.unit),
            unpacked(key_at(k, third.y, local), rule.unit),
        );
    }
    var sums = Sums();
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        sums = sums_of(k, EVERYTHING, EVERYTHING, rule, local);
    }
    let bottom = bounds_of(0u, number.x, quartiles.xy, sums, rule.unit);
    let top = bounds_of(1u, number.y, quartiles.zw, sums, rule.unit);
    sums = sums_of(k, bottom, top, rule, local);
    var medians = vec2u(0u);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        medians = vec2u(
            key_at(k, sums.below.x + median(sums.kept.x), local),
            key_at(k, bottoms + sums.below.y + median(sums.kept.y), local),
        );
    }

    // Twice the faces of the cylinders before, and the face within its own.
    let to = face_of_all + owner * parameters.faces;
    if (LANES == 1u) {
        if (is_own) {
            write_triangle(to, 0u, sums, medians.x, rule.unit);
            write_triangle(to + parameters.faces, 1u, sums, medians.y, rule.unit);
        }
    } else if (is_own && lane < 2u) {
        write_triangle(to + lane * parameters.faces, lane, sums, medians[lane], rule.unit);
    }
}

// What one workgroup does of the pass: blocks of faces, several of them only where they are listed.
fn measure_blocks(first: u32, groups: u32, cylinder: u32, local: u32) {
    if (MIDDLE == 0u) {
        measure(first, cylinder, local);
        return;
    }
    let faces_here = THREADS / LANES;
    let blocks = (listed_faces[MIDDLE_COUNT] + faces_here - 1u) / faces_here;
    for (var block = first; block < blocks; block += groups) {
        measure(block, 0u, local);
        workgroupBarrier();
    }
}
