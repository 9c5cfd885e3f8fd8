// Distances and statistics of the faces with few points: LANES invocations per face, each with eight of its
// keys in registers. Order statistics by sorting, a network whose steps do not depend on the data.
// Invocations read each other's values through `exchange`, `value_of` and `sum_before`: the two files that
// include this one differ in how.

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

// Per face of the workgroup: r of its corner a, its other corners and inverse squares, and the scale of its
// cylinder; its first point; and the number of points of the faces before it.
var<workgroup> shapes: array<array<vec4f, 3>, 128>;
var<workgroup> begins: array<u32, 128>;
var<workgroup> starts: array<u32, 129>;
// Face after face.
var<workgroup> keys: array<u32, 1024>;

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

// The key of that rank among the sorted keys of a face.
fn key_at(k: Keys, rank: u32, local: u32) -> u32 {
    let four = select(k.a, k.b, (rank & 4u) != 0u);
    let two = select(four.xy, four.zw, (rank & 2u) != 0u);
    let own = select(two.x, two.y, (rank & 1u) != 0u);
    // Of the invocation that holds the rank; what a rank beyond all keys gives is not used.
    return value_of(own, local / LANES * LANES + min(rank / 8u, LANES - 1u), local);
}

// What an invocation knows of its keys: x of all, y of those of the top triangle.
struct Sums {
    kept: vec2u,
    below: vec2u,
    // Fixed-point sums in two parts: of the lower 16 bits and of the rest.
    low: vec2u,
    high: vec2u,
    low_size: vec2u,
    high_size: vec2u,
}

// The sums of an invocation: `size` has the numbers kept from bit 23 on, since no face has more than 256 keys and
// their sizes' upper parts have 15 bits each.
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
    let size = bitcast<u32>(abs(step));
    let mask = vec2u(0xffffffffu, select(0u, 0xffffffffu, is_top));
    var below = sums.below;
    if (parameters.statistic == STATISTIC_MEDIAN) {
        below += mask & vec2u(select(0u, 1u, is_key && d < low));
    }
    return OwnSums(
        below,
        sums.low + (mask & vec2u(bitcast<u32>(step) & 0xffffu)),
        sums.high + (mask & vec2u(bitcast<u32>(step >> 16u))),
        sums.low_size + (mask & vec2u(size & 0xffffu)),
        sums.size + (mask & vec2u((size >> 16u) + select(0u, ONE_KEPT, kept))),
    );
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
    let size = sum_of_face(vec4u(own.low_size, own.size), local);
    var below = none;
    if (parameters.statistic == STATISTIC_MEDIAN) {
        below = sum_of_face(vec4u(own.below, none), local).xy;
    }
    return Sums(
        apart(size.zw / vec2u(ONE_KEPT)),
        apart(below),
        apart(sum.xy),
        apart(sum.zw),
        apart(size.xy),
        apart(size.zw % vec2u(ONE_KEPT)),
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
    if (kept == 0u) {
        triangle_values[triangle] = NO_VALUE;
        triangle_support[triangle] = TriangleSupport(0u, 0.0);
        return;
    }
    var value = mean_of(join(sums.low[half], sums.high[half]), unit, kept);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        value = unpacked(median_key, unit);
    }
    let residual = mean_of(join(sums.low_size[half], sums.high_size[half]), unit, kept);
    triangle_values[triangle] = value_word(value);
    triangle_support[triangle] = TriangleSupport(kept, residual);
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

// The block-th 128 / LANES faces of a cylinder, or of the list.
fn measure(block: u32, cylinder: u32, local: u32) {
    let faces_here = THREADS / LANES;
    var begin = 0u;
    var points = 0u;
    if (local < faces_here) {
        let face_of_all = face_at(block, cylinder, local);
        if (face_of_all != NONE) {
            begin = offsets[face_of_all];
            points = offsets[face_of_all + 1u] - begin;
            points = select(0u, points, points <= 8u * LANES);
        }
        if (points > 0u) {
            let owner = face_of_all / parameters.faces;
            let face = face_of_all - owner * parameters.faces;
            let level = face / parameters.nodes;
            let j = face - level * parameters.nodes;
            let k = select(j + 1u, 0u, j + 1u == parameters.nodes);
            let row = owner * parameters.node_count + level * parameters.nodes;
            let above = row + parameters.nodes;
            let a = radii[row + j];
            let own = face_of_corners(radii[row + k] - a, radii[above + k] - a, radii[above + j] - a);
            shapes[local] = array<vec4f, 3>(
                vec4f(a, own.b, own.b_above, own.a_above),
                vec4f(own.per_ab, own.per_aa, own.per_diagonal, own.per_bb),
                vec4f(own.per_across, own.per_bottom, own.per_top, cylinders[owner].scale),
            );
        }
    }
    let before = sum_before(points, local);
    if (local < faces_here) {
        begins[local] = begin;
        starts[local] = before;
        if (local == faces_here - 1u) {
            starts[faces_here] = before + points;
        }
    }
    workgroupBarrier();

    // The points of all these faces side by side, so that no invocation waits for a face with more points.
    let total = starts[faces_here];
    for (var i = local; i < total; i += THREADS) {
        // The last face that begins at or before the point. It has points: a later one that begins there too
        // would be the last.
        var f = 0u;
        if (LANES <= 1u) {
            f += select(0u, 64u, starts[f + 64u] <= i);
        }
        if (LANES <= 2u) {
            f += select(0u, 32u, starts[f + 32u] <= i);
        }
        if (LANES <= 4u) {
            f += select(0u, 16u, starts[f + 16u] <= i);
        }
        if (LANES <= 8u) {
            f += select(0u, 8u, starts[f + 8u] <= i);
        }
        if (LANES <= 16u) {
            f += select(0u, 4u, starts[f + 4u] <= i);
        }
        f += select(0u, 2u, starts[f + 2u] <= i);
        f += select(0u, 1u, starts[f + 1u] <= i);
        let p = grouped[begins[f] + i - starts[f]];
        let first = shapes[f][0];
        let second = shapes[f][1];
        let third = shapes[f][2];
        let face = Face(
            first.y,
            first.z,
            first.w,
            second.x,
            second.y,
            second.z,
            second.w,
            third.x,
            third.y,
            third.z,
        );
        let nearer = distance_to_face(vec3f(p.x - first.x, p.yz), face);
        keys[i] = packed_key(nearer.distance, nearer.top, third.w);
    }
    workgroupBarrier();

    let slot = local / LANES;
    let lane = local % LANES;
    let start = starts[slot];
    let count = starts[slot + 1u] - start;
    let face_of_all = face_at(block, cylinder, slot);
    let owner = select(face_of_all / parameters.faces, 0u, face_of_all == NONE);
    let rule = cylinders[owner];
    var k = Keys(
        vec4u(
            key_or_empty(start, count, lane),
            key_or_empty(start, count, lane + LANES),
            key_or_empty(start, count, lane + 2u * LANES),
            key_or_empty(start, count, lane + 3u * LANES),
        ),
        vec4u(
            key_or_empty(start, count, lane + 4u * LANES),
            key_or_empty(start, count, lane + 5u * LANES),
            key_or_empty(start, count, lane + 6u * LANES),
            key_or_empty(start, count, lane + 7u * LANES),
        ),
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

    if (lane == 0u && face_of_all != NONE) {
        if (offsets[face_of_all + 1u] - offsets[face_of_all] <= 8u * LANES) {
            // Twice the faces of the cylinders before, and the face within its own.
            let to = face_of_all + owner * parameters.faces;
            write_triangle(to, 0u, sums, medians.x, rule.unit);
            write_triangle(to + parameters.faces, 1u, sums, medians.y, rule.unit);
        }
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

fn key_or_empty(start: u32, count: u32, index: u32) -> u32 {
    if (index < count) {
        return keys[start + index];
    }
    return EMPTY;
}
