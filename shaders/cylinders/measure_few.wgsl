// Distances and statistics of faces with very few points: one invocation per face, which has up to eight keys in
// registers. A workgroup shares out the points of all its faces, whatever face they belong to, so that no invocation
// computes distances for places without a point. Afterwards, teams of sixteen measure its faces with more points, up to
// 64. Longer faces are left to another pass.

const THREADS: u32 = 128u;
const CHUNK: u32 = 512u;
const TEAM: u32 = 16u;
const TEAM_KEYS: u32 = 64u;

// The keys of a chunk of points, or of the faces of eight teams.
var<workgroup> shared_keys: array<u32, 512>;
// Of each face: r of the corners a, b, b' and a', less that of a but for a; then the rest of `Face`, and 0 where the
// face has more than eight points.
var<workgroup> corners: array<vec4f, 128>;
var<workgroup> per_edges: array<vec4f, 128>;
var<workgroup> per_others: array<vec4f, 128>;
// The faces for teams, and their number.
var<workgroup> listed: array<u32, 128>;
var<workgroup> listed_count: atomic<u32>;
var<workgroup> shared_count: u32;
// Per team: four keys at ranks, and the sums of its invocations.
var<workgroup> ranked: array<u32, 32>;
var<workgroup> team_sums: array<atomic<u32>, 80>;

// The key of a point on one of the workgroup's faces.
fn shared_key(p: vec4u, face: u32, scale: f32) -> u32 {
    let r = corners[face];
    let e = per_edges[face];
    let o = per_others[face];
    return key_of_point(p, r.x, Face(r.y, r.z, r.w, e.x, e.y, e.z, e.w, o.x, o.y, o.z), scale);
}

// Puts the key of a point at a place of the chunk, unless it is beyond the end or its face is a team's or a longer one.
fn share_out(i: u32, count: u32, p: vec4u, first_face: u32, scale: f32) {
    if (i >= count) {
        return;
    }
    let face = p.w - first_face;
    if (per_others[face].w > 0.0) {
        shared_keys[i] = shared_key(p, face, scale);
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

// The statistics of a face from its keys.
fn measure_own(keys: Keys, count: u32, face_of_all: u32, is_own: bool, rule: Cylinder) {
    var k = keys;
    // Top and empty keys have the highest bit.
    let others = (k.a >> vec4u(31u)) + (k.b >> vec4u(31u));
    let bottoms = 8u - (others.x + others.y + others.z + others.w);
    let number = vec2u(bottoms, count - bottoms);
    var quartiles = vec4f(0.0);
    if (parameters.outliers == OUTLIERS_IQR || parameters.statistic == STATISTIC_MEDIAN) {
        k = sort_own(k);
    }
    if (parameters.outliers == OUTLIERS_IQR) {
        quartiles = vec4f(
            unpacked(own_key_at(k, first_quartile(number.x)), rule.unit),
            unpacked(own_key_at(k, third_quartile(number.x)), rule.unit),
            unpacked(own_key_at(k, bottoms + first_quartile(number.y)), rule.unit),
            unpacked(own_key_at(k, bottoms + third_quartile(number.y)), rule.unit),
        );
    }
    var sums = Sums();
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        sums = face_sums(own_sums_of(k, EVERYTHING, EVERYTHING, rule));
    }
    let bottom = bounds_of(0u, number.x, quartiles.xy, sums, rule.unit);
    let top = bounds_of(1u, number.y, quartiles.zw, sums, rule.unit);
    sums = face_sums(own_sums_of(k, bottom, top, rule));
    var medians = vec2u(0u);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        medians = vec2u(
            own_key_at(k, sums.below.x + median(sums.kept.x)),
            own_key_at(k, bottoms + sums.below.y + median(sums.kept.y)),
        );
    }
    if (is_own) {
        write_triangle(2u * face_of_all, 0u, sums, medians.x, rule.unit);
        write_triangle(2u * face_of_all + 1u, 1u, sums, medians.y, rule.unit);
    }
}

// The key of the i-th point of a team's face, which the whole team can read afterwards; EMPTY where there is none.
fn team_key(begin: u32, count: u32, i: u32, face: u32, team: u32, scale: f32) -> u32 {
    if (i >= count) {
        return EMPTY;
    }
    let key = shared_key(grouped[begin + i], face, scale);
    shared_keys[TEAM_KEYS * team + i] = key;
    return key;
}

// The sums over the keys of a team. All invocations must call it.
fn sums_of_team(k: vec4u, bottom: Bounds, top: Bounds, rule: Cylinder, team: u32, lane: u32) -> Sums {
    let first = 10u * team;
    if (lane < 10u) {
        atomicStore(&team_sums[first + lane], 0u);
    }
    workgroupBarrier();
    let none = vec2u(0u);
    var own = OwnSums(none, none, none, none, none);
    own = add(own, k.x, bottom, top, rule);
    own = add(own, k.y, bottom, top, rule);
    own = add(own, k.z, bottom, top, rule);
    own = add(own, k.w, bottom, top, rule);
    add_to_team(first, own.below);
    add_to_team(first + 2u, own.low);
    add_to_team(first + 4u, own.high);
    add_to_team(first + 6u, own.low_size);
    add_to_team(first + 8u, own.size);
    workgroupBarrier();
    return face_sums(OwnSums(
        sum_of_team(first),
        sum_of_team(first + 2u),
        sum_of_team(first + 4u),
        sum_of_team(first + 6u),
        sum_of_team(first + 8u),
    ));
}

fn add_to_team(at: u32, own: vec2u) {
    atomicAdd(&team_sums[at], own.x);
    atomicAdd(&team_sums[at + 1u], own.y);
}

fn sum_of_team(at: u32) -> vec2u {
    return vec2u(atomicLoad(&team_sums[at]), atomicLoad(&team_sums[at + 1u]));
}

// Puts the key at a rank among the keys of a team where all of it can read it.
fn put_ranked(k: vec4u, ranks: vec4u, rank: u32, to: u32) {
    let found = ranks == vec4u(rank);
    if (found.x) {
        ranked[to] = k.x;
    }
    if (found.y) {
        ranked[to] = k.y;
    }
    if (found.z) {
        ranked[to] = k.z;
    }
    if (found.w) {
        ranked[to] = k.w;
    }
}

// A team measures a face of the list, if there is one for it. All invocations must call it.
fn measure_in_team(index: u32, first_face: u32, rule: Cylinder, local: u32) {
    let team = local / TEAM;
    let lane = local % TEAM;
    let is_team = index + team < shared_count;
    var face = 0u;
    var begin = 0u;
    var count = 0u;
    if (is_team) {
        face = listed[index + team];
        begin = offsets[first_face + face];
        count = offsets[first_face + face + 1u] - begin;
    }
    let of_face = vec4u(lane, lane + TEAM, lane + 2u * TEAM, lane + 3u * TEAM);
    let k = vec4u(
        team_key(begin, count, of_face.x, face, team, rule.scale),
        team_key(begin, count, of_face.y, face, team, rule.scale),
        team_key(begin, count, of_face.z, face, team, rule.scale),
        team_key(begin, count, of_face.w, face, team, rule.scale),
    );
    workgroupBarrier();
    // Of equal keys the first has the lower rank.
    var ranks = vec4u(0u);
    var bottoms = 0u;
    for (var i = 0u; i < count; i++) {
        let other = shared_keys[TEAM_KEYS * team + i];
        let is_before = vec4u(other) < k | (vec4u(other) == k & vec4u(i) < of_face);
        ranks += select(vec4u(0u), vec4u(1u), is_before);
        bottoms += 1u - (other >> 31u);
    }
    ranks = select(vec4u(NONE), ranks, of_face < vec4u(count));
    let number = vec2u(bottoms, count - bottoms);
    let to = 4u * team;
    put_ranked(k, ranks, first_quartile(number.x), to);
    put_ranked(k, ranks, third_quartile(number.x), to + 1u);
    put_ranked(k, ranks, bottoms + first_quartile(number.y), to + 2u);
    put_ranked(k, ranks, bottoms + third_quartile(number.y), to + 3u);
    workgroupBarrier();
    let quartiles = vec4f(
        unpacked(ranked[to], rule.unit),
        unpacked(ranked[to + 1u], rule.unit),
        unpacked(ranked[to + 2u], rule.unit),
        unpacked(ranked[to + 3u], rule.unit),
    );
    var sums = Sums();
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        sums = sums_of_team(k, EVERYTHING, EVERYTHING, rule, team, lane);
        workgroupBarrier();
    }
    let bottom = bounds_of(0u, number.x, quartiles.xy, sums, rule.unit);
    let top = bounds_of(1u, number.y, quartiles.zw, sums, rule.unit);
    sums = sums_of_team(k, bottom, top, rule, team, lane);
    var medians = vec2u(0u);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        put_ranked(k, ranks, sums.below.x + median(sums.kept.x), to);
        put_ranked(k, ranks, bottoms + sums.below.y + median(sums.kept.y), to + 1u);
        workgroupBarrier();
        medians = vec2u(ranked[to], ranked[to + 1u]);
    }
    if (is_team && lane < 2u) {
        write_triangle(2u * (first_face + face) + lane, lane, sums, medians[lane], rule.unit);
    }
    workgroupBarrier();
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
    let is_face = local < faces_here;
    var face = FaceAt();
    if (is_face) {
        face = face_at(face_of_all, cylinder);
    }
    let is_own = is_face && face.points <= 8u;
    let shape = face.shape;
    corners[local] = vec4f(face.a, shape.b, shape.b_above, shape.a_above);
    per_edges[local] = vec4f(shape.per_ab, shape.per_aa, shape.per_diagonal, shape.per_bb);
    per_others[local] = vec4f(shape.per_across, shape.per_bottom, shape.per_top, select(0.0, 1.0, is_own));
    if (local == 0u) {
        atomicStore(&listed_count, 0u);
    }
    workgroupBarrier();
    if (is_face && !is_own && face.points <= TEAM_KEYS) {
        listed[atomicAdd(&listed_count, 1u)] = local;
    }

    let begin = offsets[first_face];
    let end = offsets[first_face + faces_here];
    let count = select(0u, face.points, is_own);
    var k = Keys(vec4u(EMPTY), vec4u(EMPTY));
    for (var chunk = begin; chunk < end; chunk += CHUNK) {
        share_out_chunk(chunk, min(end - chunk, CHUNK), first_face, rule.scale, local);
        workgroupBarrier();
        k.a = four_shared_keys(k.a, face.begin - chunk, count, 0u);
        k.b = four_shared_keys(k.b, face.begin - chunk, count, 4u);
        workgroupBarrier();
    }
    measure_own(k, count, face_of_all, is_own, rule);

    if (local == 0u) {
        shared_count = atomicLoad(&listed_count);
    }
    let teams = workgroupUniformLoad(&shared_count);
    for (var index = 0u; index < teams; index += THREADS / TEAM) {
        measure_in_team(index, first_face, rule, local);
    }
}
