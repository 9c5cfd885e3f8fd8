// Distances and statistics of the faces with few points: LANES invocations per face, each with eight of its
// points, whose keys it has in registers. Order statistics by sorting, a network whose steps do not depend on the
// data. Invocations read each other's values through `exchange` and `value_at`: the two files that include this one
// differ in how.

override LANES: u32 = 8u;
// 1: the faces of middle size, which are listed, instead of the short ones among all.
override MIDDLE: u32 = 0u;

@group(0) @binding(7) var<storage, read> listed_faces: array<u32>;

const THREADS: u32 = 128u;

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
    let own = own_key_at(k, rank);
    if (LANES == 1u) {
        return own;
    }
    // Of the invocation that holds the rank; what a rank beyond all keys gives is not used.
    return value_at(own, local / LANES * LANES + min(rank / 8u, LANES - 1u), local);
}

fn sums_of(k: Keys, bottom: Bounds, top: Bounds, rule: Cylinder, local: u32) -> Sums {
    let none = vec2u(0u);
    let own = add_eight(OwnSums(none, none, none, none, none), k, bottom, top, rule);
    let sum = sum_of_face(vec4u(own.low, own.high), local);
    let size = sum_of_pairs(own.size, local);
    var low_size = vec2u(0u);
    if (parameters.last == 1u) {
        low_size = sum_of_pairs(own.low_size, local);
    }
    var below = vec2u(0u);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        below = sum_of_pairs(own.below, local);
    }
    return face_sums(OwnSums(below, sum.xy, sum.zw, low_size, size));
}

// A face of the workgroup's, among those of all cylinders; NONE where there are no more.
fn face_of_block(block: u32, cylinder: u32, slot: u32) -> u32 {
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

fn key_of_own(p: vec4u, is_point: bool, corners: Corners, scale: f32) -> u32 {
    if (!is_point) {
        return EMPTY;
    }
    return key_of_point(p, corners, scale);
}

// The keys of four points of an invocation, from the first-th of its face on. All are read before the first
// distance is computed.
fn four_keys(begin: u32, count: u32, first: u32, corners: Corners, scale: f32) -> vec4u {
    let last = max(count, 1u) - 1u;
    let at = vec4u(first, first + LANES, first + 2u * LANES, first + 3u * LANES);
    let places = vec4u(begin) + min(at, vec4u(last));
    let p = grouped[places.x];
    let q = grouped[places.y];
    let r = grouped[places.z];
    let s = grouped[places.w];
    return vec4u(
        key_of_own(p, at.x < count, corners, scale),
        key_of_own(q, at.y < count, corners, scale),
        key_of_own(r, at.z < count, corners, scale),
        key_of_own(s, at.w < count, corners, scale),
    );
}

// The block-th 128 / LANES faces of a cylinder, or of the list.
fn measure(block: u32, cylinder: u32, local: u32) {
    let slot = local / LANES;
    let lane = local % LANES;
    let face_of_all = face_of_block(block, cylinder, slot);
    let is_face = face_of_all != NONE;
    var owner = cylinder;
    if (MIDDLE == 1u) {
        owner = select(0u, face_of_all / parameters.faces, is_face);
    }
    let rule = cylinders[owner];
    var corners = Corners();
    var begin = 0u;
    var points = 0u;
    if (is_face) {
        corners = corners_of(face_of_all, owner);
        begin = offsets[face_of_all];
        points = offsets[face_of_all + 1u] - begin;
    }
    let is_own = is_face && points <= 8u * LANES;
    let count = select(0u, points, is_own);
    var k = Keys(
        four_keys(begin, count, lane, corners, rule.scale),
        four_keys(begin, count, lane + 4u * LANES, corners, rule.scale),
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

    if (LANES == 1u) {
        if (is_own) {
            write_triangle(2u * face_of_all, 0u, sums, medians.x, rule.unit);
            write_triangle(2u * face_of_all + 1u, 1u, sums, medians.y, rule.unit);
        }
    } else if (is_own && lane < 2u) {
        write_triangle(2u * face_of_all + lane, lane, sums, medians[lane], rule.unit);
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
