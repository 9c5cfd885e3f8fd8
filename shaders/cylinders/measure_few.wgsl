// Distances and statistics of faces with very few points: one invocation per face, which has up to eight keys in
// registers, or sixteen where it must. A workgroup shares out the points of all its faces, whatever face they belong
// to, so that no invocation computes distances for places without a point. Faces with more points are left to other
// passes.

const THREADS: u32 = 128u;
const CHUNK: u32 = 4u * THREADS;
const MOST: u32 = 16u;

// The keys of a chunk of points.
var<workgroup> shared_keys: array<u32, CHUNK>;
// Of each face: r of the corners a, b, b' and a', less that of a but for a; and whether it has few points. What else
// `Face` has is computed anew for each point: the more memory a workgroup has, the fewer of them fit a processor.
var<workgroup> corners: array<vec4f, THREADS>;
var<workgroup> has_few: array<u32, THREADS>;

// Puts the key of a point at a place of the chunk, unless it is beyond the end or its face has more points.
fn share_out(i: u32, count: u32, p: vec4u, first_face: u32, scale: f32) {
    if (i >= count) {
        return;
    }
    let face = p.w - first_face;
    if (has_few[face] == 1u) {
        let r = corners[face];
        shared_keys[i] = key_of_point(p, Corners(r.x, face_of_corners(r.y, r.z, r.w)), scale);
    }
}

// Computes the keys of a chunk of `count` points from `begin` on. All points of an invocation are read before its first
// distance is computed.
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

// Four keys of an invocation with those of them that are in the chunk. `begin` is the place in it where the face's
// points begin; where that is before the chunk, it wraps around.
fn four_shared_keys(old: vec4u, begin: u32, count: u32, first: u32) -> vec4u {
    let of_face = vec4u(first, first + 1u, first + 2u, first + 3u);
    let at = vec4u(begin) + of_face;
    let here = min(at, vec4u(CHUNK - 1u));
    let four = vec4u(shared_keys[here.x], shared_keys[here.y], shared_keys[here.z], shared_keys[here.w]);
    return select(old, four, at < vec4u(CHUNK) & of_face < vec4u(count));
}

// Eight keys of an invocation with those of them that are in the chunk.
fn eight_shared_keys(old: Keys, begin: u32, count: u32, first: u32) -> Keys {
    return Keys(
        four_shared_keys(old.a, begin, count, first),
        four_shared_keys(old.b, begin, count, first + 4u),
    );
}

// The number of keys with the highest bit, which those of top triangles and empty ones have.
fn others_among(k: Keys) -> u32 {
    let others = (k.a >> vec4u(31u)) + (k.b >> vec4u(31u));
    return others.x + others.y + others.z + others.w;
}

// The key of that rank among eight or sixteen sorted keys.
fn key_at(k: Keys, more: Keys, has_more: bool, rank: u32) -> u32 {
    var key = own_key_at(k, rank);
    if (has_more && rank >= 8u) {
        key = own_key_at(more, rank);
    }
    return key;
}

fn sums_of(k: Keys, more: Keys, has_more: bool, bottom: Bounds, top: Bounds, rule: Cylinder) -> Sums {
    let none = vec2u(0u);
    var own = add_eight(OwnSums(none, none, none, none, none), k, bottom, top, rule);
    if (has_more) {
        own = add_eight(own, more, bottom, top, rule);
    }
    return face_sums(own);
}

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let cylinder = group.z;
    let rule = cylinders[cylinder];
    // A few workgroups may be beyond the last face.
    let first = min(workgroup_index(group, groups) * THREADS, parameters.faces);
    let faces_here = min(THREADS, parameters.faces - first);
    let first_face = cylinder * parameters.faces + first;
    let face_of_all = first_face + local;
    var own = Corners();
    var own_begin = 0u;
    var points = 0u;
    if (local < faces_here) {
        own = corners_of(face_of_all, cylinder);
        own_begin = offsets[face_of_all];
        points = offsets[face_of_all + 1u] - own_begin;
    }
    let is_own = local < faces_here && points <= MOST;
    corners[local] = vec4f(own.a, own.shape.b, own.shape.b_above, own.shape.a_above);
    has_few[local] = select(0u, 1u, is_own);

    let begin = offsets[first_face];
    let end = offsets[first_face + faces_here];
    let count = select(0u, points, is_own);
    let has_more = count > 8u;
    var k = Keys(vec4u(EMPTY), vec4u(EMPTY));
    var more = k;
    for (var chunk = begin; chunk < end; chunk += CHUNK) {
        workgroupBarrier();
        share_out_chunk(chunk, min(end - chunk, CHUNK), first_face, rule.scale, local);
        workgroupBarrier();
        k = eight_shared_keys(k, own_begin - chunk, count, 0u);
        if (has_more) {
            more = eight_shared_keys(more, own_begin - chunk, count, 8u);
        }
    }
    if (!is_own) {
        return;
    }
    let bottoms = 16u - others_among(k) - others_among(more);
    let number = vec2u(bottoms, count - bottoms);
    var quartiles = vec4f(0.0);
    if (parameters.outliers == OUTLIERS_IQR || parameters.statistic == STATISTIC_MEDIAN) {
        k = sort_own(k);
        if (has_more) {
            // The first key meets the last.
            let last = sort_own(more);
            more = merge_own(Keys(max(k.a, last.b.wzyx), max(k.b, last.a.wzyx)));
            k = merge_own(Keys(min(k.a, last.b.wzyx), min(k.b, last.a.wzyx)));
        }
    }
    if (parameters.outliers == OUTLIERS_IQR) {
        let top_ranks = vec2u(bottoms) + vec2u(first_quartile(number.y), third_quartile(number.y));
        quartiles = vec4f(
            unpacked(key_at(k, more, has_more, first_quartile(number.x)), rule.unit),
            unpacked(key_at(k, more, has_more, third_quartile(number.x)), rule.unit),
            unpacked(key_at(k, more, has_more, top_ranks.x), rule.unit),
            unpacked(key_at(k, more, has_more, top_ranks.y), rule.unit),
        );
    }
    var sums = Sums();
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        sums = sums_of(k, more, has_more, EVERYTHING, EVERYTHING, rule);
    }
    let bottom = bounds_of(0u, number.x, quartiles.xy, sums, rule.unit);
    let top = bounds_of(1u, number.y, quartiles.zw, sums, rule.unit);
    sums = sums_of(k, more, has_more, bottom, top, rule);
    var medians = vec2u(0u);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        let top_rank = bottoms + sums.below.y + median(sums.kept.y);
        medians = vec2u(
            key_at(k, more, has_more, sums.below.x + median(sums.kept.x)),
            key_at(k, more, has_more, top_rank),
        );
    }
    write_triangle(2u * face_of_all, 0u, sums, medians.x, rule.unit);
    write_triangle(2u * face_of_all + 1u, 1u, sums, medians.y, rule.unit);
}
