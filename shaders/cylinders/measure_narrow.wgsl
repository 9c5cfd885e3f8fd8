// Distances and statistics of the faces with many points on a software device, where a barrier costs as much as hundreds
// of operations: a subgroup takes one face at a time, and no invocation waits for another. Order statistics by intervals of keys
// that become narrower, up to four at once.

// Counts the faces that were measured to the end, as `measure_long` does.
@group(0) @binding(7) var<storage, read_write> listed_faces: array<atomic<u32>>;
// The keys of a face after the first eight of each invocation, which has those in registers. An invocation writes four at a
// time, and reads only what it has written.
@group(0) @binding(8) var<storage, read_write> keys: array<vec4u>;

const THREADS: u32 = 32u;
// Rounds that divide an interval of distances evenly: most distances are of like size, whereas keys grow with their
// logarithms. Then come rounds that divide its keys evenly; each leaves a fourth, so that sixteen leave one of 2^32.
const EVEN_ROUNDS: u32 = 3u;
const ROUNDS: u32 = EVEN_ROUNDS + 16u;

// An invocation's keys: the first eight, and from `begin` to `end` the places of the others, four at a time, `width` apart.
// A face uses only the words of its own points: alignment and filling up with EMPTY take fewer than the first eight leave.
struct Run {
    first: Keys,
    width: u32,
    begin: u32,
    end: u32,
}

// Of bottom and top: the number of keys, the least and the greatest.
struct Extent {
    number: vec2u,
    least: vec2u,
    greatest: vec2u,
}

// For each of four ranks the keys among which it is: from the least to the greatest, and how many keys of the face are
// less than all of them, or not greater.
struct Intervals {
    least: vec4u,
    greatest: vec4u,
    below: vec4u,
    upto: vec4u,
}

// The keys of four of an invocation's points, the i-th of the face the first, EMPTY beyond the face's end.
fn four_keys(i: u32, begin: u32, count: u32, width: u32, corners: Corners, scale: f32) -> vec4u {
    let at = vec4u(i, i + width, i + 2u * width, i + 3u * width);
    let places = vec4u(begin) + min(at, vec4u(count - 1u));
    let four = vec4u(
        key_of_point(grouped[places.x], corners, scale),
        key_of_point(grouped[places.y], corners, scale),
        key_of_point(grouped[places.z], corners, scale),
        key_of_point(grouped[places.w], corners, scale),
    );
    return select(four, vec4u(EMPTY), at >= vec4u(count));
}

// Writes the keys of a face but for the first.
fn keys_of_face(begin: u32, count: u32, lane: u32, width: u32, corners: Corners, scale: f32) -> Run {
    let first = Keys(
        four_keys(lane, begin, count, width, corners, scale),
        four_keys(lane + 4u * width, begin, count, width, corners, scale),
    );
    let place = (begin + 3u) / 4u + lane;
    var end = place;
    for (var i = 8u * width + lane; i < count; i += 4u * width) {
        keys[end] = four_keys(i, begin, count, width, corners, scale);
        end += width;
    }
    return Run(first, width, place, end);
}

fn with_key(extent: Extent, key: u32) -> Extent {
    let is_top = (key >> 31u) == 1u;
    let is_key = key != EMPTY;
    // Every top key is greater than every bottom one.
    return Extent(
        extent.number + select(vec2u(0u), select(vec2u(1u, 0u), vec2u(0u, 1u), is_top), is_key),
        min(extent.least, vec2u(key, select(EMPTY, key, is_top))),
        max(extent.greatest, select(vec2u(0u), select(vec2u(key, key), vec2u(0u, key), is_top), is_key)),
    );
}

fn with_four(extent: Extent, four: vec4u) -> Extent {
    return with_key(with_key(with_key(with_key(extent, four.x), four.y), four.z), four.w);
}

fn extent_of(run: Run) -> Extent {
    var own = with_four(with_four(Extent(vec2u(0u), vec2u(EMPTY), vec2u(0u)), run.first.a), run.first.b);
    for (var place = run.begin; place < run.end; place += run.width) {
        own = with_four(own, keys[place]);
    }
    return Extent(subgroupAdd(own.number), subgroupMin(own.least), subgroupMax(own.greatest));
}

// The keys of the distances at that part of the way through four intervals.
fn between(distance_low: vec4f, distance_high: vec4f, part: f32, is_top: vec4<bool>, scale: f32) -> vec4u {
    let d = distance_low + (distance_high - distance_low) * part;
    return vec4u(
        packed_key(d.x, is_top.x, scale),
        packed_key(d.y, is_top.y, scale),
        packed_key(d.z, is_top.z, scale),
        packed_key(d.w, is_top.w, scale),
    );
}

fn distances_of(four: vec4u, unit: f32) -> vec4f {
    return vec4f(
        unpacked(four.x, unit),
        unpacked(four.y, unit),
        unpacked(four.z, unit),
        unpacked(four.w, unit),
    );
}

// For each of four ranks, how many keys of a face are less than each of three bounds; or the bounds.
struct Numbers {
    first: vec4u,
    second: vec4u,
    third: vec4u,
}

fn counted(numbers: Numbers, bounds: Numbers, key: u32) -> Numbers {
    return Numbers(
        numbers.first + select(vec4u(0u), vec4u(1u), vec4u(key) < bounds.first),
        numbers.second + select(vec4u(0u), vec4u(1u), vec4u(key) < bounds.second),
        numbers.third + select(vec4u(0u), vec4u(1u), vec4u(key) < bounds.third),
    );
}

fn counted_four(numbers: Numbers, bounds: Numbers, four: vec4u) -> Numbers {
    return counted(counted(counted(counted(numbers, bounds, four.x), bounds, four.y), bounds, four.z), bounds, four.w);
}

fn number_below(run: Run, bounds: Numbers) -> Numbers {
    var own = counted_four(Numbers(vec4u(0u), vec4u(0u), vec4u(0u)), bounds, run.first.a);
    own = counted_four(own, bounds, run.first.b);
    for (var place = run.begin; place < run.end; place += run.width) {
        own = counted_four(own, bounds, keys[place]);
    }
    return Numbers(subgroupAdd(own.first), subgroupAdd(own.second), subgroupAdd(own.third));
}

// The least key that is not below an interval and the greatest that is not above it, of four of them.
struct Ends {
    least: vec4u,
    greatest: vec4u,
}

fn with_end(ends: Ends, least: vec4u, greatest: vec4u, key: u32) -> Ends {
    let four = vec4u(key);
    return Ends(
        min(ends.least, select(vec4u(EMPTY), four, four >= least)),
        max(ends.greatest, select(vec4u(0u), four, four <= greatest)),
    );
}

fn with_four_ends(ends: Ends, least: vec4u, greatest: vec4u, four: vec4u) -> Ends {
    let two = with_end(with_end(ends, least, greatest, four.x), least, greatest, four.y);
    return with_end(with_end(two, least, greatest, four.z), least, greatest, four.w);
}

fn ends_of(run: Run, least: vec4u, greatest: vec4u) -> Ends {
    var own = with_four_ends(Ends(vec4u(EMPTY), vec4u(0u)), least, greatest, run.first.a);
    own = with_four_ends(own, least, greatest, run.first.b);
    for (var place = run.begin; place < run.end; place += run.width) {
        own = with_four_ends(own, least, greatest, keys[place]);
    }
    return Ends(subgroupMin(own.least), subgroupMax(own.greatest));
}

// The keys at four ranks among the keys of a face; what a rank beyond them gives is not used.
fn select_four(run: Run, extent: Extent, wanted: vec4u, rule: Cylinder) -> vec4u {
    let bottoms = extent.number.x;
    let all = extent.number.x + extent.number.y;
    let ranks = min(wanted, vec4u(all - 1u));
    let is_top = ranks >= vec4u(bottoms);
    var own = Intervals(
        select(vec4u(extent.least.x), vec4u(extent.least.y), is_top),
        select(vec4u(extent.greatest.x), vec4u(extent.greatest.y), is_top),
        select(vec4u(0u), vec4u(bottoms), is_top),
        select(vec4u(bottoms), vec4u(all), is_top),
    );
    for (var round = 0u; round < ROUNDS; round++) {
        // The least and the greatest key of an interval are found without narrowing it.
        let is_inner = (ranks > own.below) & (ranks + vec4u(1u) < own.upto) & (own.least < own.greatest);
        if (!any(is_inner)) {
            break;
        }
        let span = own.greatest - own.least;
        let fourth = span / vec4u(4u) + vec4u(1u);
        var first = own.least + min(fourth, span);
        var second = own.least + min(2u * fourth, span);
        var third = own.least + min(3u * fourth, span);
        if (round < EVEN_ROUNDS) {
            let low = distances_of(own.least, rule.unit);
            let high = distances_of(own.greatest, rule.unit);
            first = clamp(between(low, high, 0.25, is_top, rule.scale), own.least, own.greatest);
            second = clamp(between(low, high, 0.5, is_top, rule.scale), first, own.greatest);
            third = clamp(between(low, high, 0.75, is_top, rule.scale), second, own.greatest);
        }
        let number = number_below(run, Numbers(first, second, third));
        let in_second = ranks >= number.first;
        let in_third = ranks >= number.second;
        let in_fourth = ranks >= number.third;
        own = Intervals(
            select(select(select(own.least, first, in_second), second, in_third), third, in_fourth),
            select(select(select(first - 1u, second - 1u, in_second), third - 1u, in_third), own.greatest, in_fourth),
            select(select(select(own.below, number.first, in_second), number.second, in_third), number.third, in_fourth),
            select(select(select(number.first, number.second, in_second), number.third, in_third), own.upto, in_fourth),
        );
    }
    let ends = ends_of(run, own.least, own.greatest);
    return select(ends.greatest, ends.least, ranks == own.below);
}

// Sums of the distances within bounds, and the number of keys among which they were found.
struct Summed {
    seen: u32,
    sums: Sums,
}

fn summed(all: Summed, key: u32, bottom: Bounds, top: Bounds, rule: Cylinder) -> Summed {
    let is_key = key != EMPTY;
    let is_top = (key >> 31u) == 1u;
    let d = unpacked(key, rule.unit);
    let low = select(bottom.low, top.low, is_top);
    let high = select(bottom.high, top.high, is_top);
    let kept = is_key && d >= low && d <= high;
    let step = select(0, fixed(d, rule.scale), kept);
    let mask = select(vec2u(0xffffffffu, 0u), vec2u(0u, 0xffffffffu), is_top);
    var own = all;
    own.seen += select(0u, 1u, is_key);
    own.sums.kept += mask & vec2u(select(0u, 1u, kept));
    own.sums.below += mask & vec2u(select(0u, 1u, is_key && d < low));
    own.sums.low += mask & vec2u(bitcast<u32>(step) & 0xffffu);
    own.sums.high += mask & vec2u(bitcast<u32>(step >> 16u));
    own.sums.low_size += mask & vec2u(bitcast<u32>(abs(step)) & 0xffffu);
    own.sums.high_size += mask & vec2u(bitcast<u32>(abs(step)) >> 16u);
    return own;
}

fn summed_four(all: Summed, four: vec4u, bottom: Bounds, top: Bounds, rule: Cylinder) -> Summed {
    let two = summed(summed(all, four.x, bottom, top, rule), four.y, bottom, top, rule);
    return summed(summed(two, four.z, bottom, top, rule), four.w, bottom, top, rule);
}

fn sums_within(run: Run, bottom: Bounds, top: Bounds, rule: Cylinder) -> Summed {
    var own = summed_four(summed_four(Summed(0u, Sums()), run.first.a, bottom, top, rule), run.first.b, bottom, top, rule);
    for (var place = run.begin; place < run.end; place += run.width) {
        own = summed_four(own, keys[place], bottom, top, rule);
    }
    let sums = Sums(
        subgroupAdd(own.sums.kept),
        subgroupAdd(own.sums.below),
        subgroupAdd(own.sums.low),
        subgroupAdd(own.sums.high),
        subgroupAdd(own.sums.low_size),
        subgroupAdd(own.sums.high_size),
    );
    return Summed(subgroupAdd(own.seen), sums);
}

fn measure(face_of_all: u32, lane: u32, width: u32) {
    let begin = offsets[face_of_all];
    let count = offsets[face_of_all + 1u] - begin;
    let cylinder = face_of_all / parameters.faces;
    let rule = cylinders[cylinder];
    let run = keys_of_face(begin, count, lane, width, corners_of(face_of_all, cylinder), rule.scale);
    let extent = extent_of(run);
    let number = extent.number;
    var quartiles = vec4f(0.0);
    if (parameters.outliers == OUTLIERS_IQR) {
        let first = vec2u(first_quartile(number.x), number.x + first_quartile(number.y));
        let third = vec2u(third_quartile(number.x), number.x + third_quartile(number.y));
        quartiles = distances_of(select_four(run, extent, vec4u(first.x, third.x, first.y, third.y), rule), rule.unit);
    }
    var all = Sums();
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        all = sums_within(run, EVERYTHING, EVERYTHING, rule).sums;
    }
    let bottom = bounds_of(0u, number.x, quartiles.xy, all, rule.unit);
    let top = bounds_of(1u, number.y, quartiles.zw, all, rule.unit);
    let found = sums_within(run, bottom, top, rule);
    var medians = vec2u(0u);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        let kept = found.sums.kept;
        let ranks = vec2u(0u, number.x) + found.sums.below + vec2u(median(kept.x), median(kept.y));
        medians = select_four(run, extent, ranks.xxyy, rule).xz;
    }
    if (lane == 0u) {
        write_triangle(2u * face_of_all, 0u, found.sums, medians.x, rule.unit);
        write_triangle(2u * face_of_all + 1u, 1u, found.sums, medians.y, rule.unit);
        if (found.seen == count) {
            atomicAdd(&listed_faces[LONG_DONE], 1u);
        }
    }
}

@compute @workgroup_size(32)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(subgroup_id) id: u32,
    @builtin(subgroup_size) width: u32,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let faces_here = THREADS / width;
    let listed = atomicLoad(&listed_faces[NARROW_COUNT]);
    let first = workgroup_index(group, groups) * faces_here + id;
    for (var index = first; index < listed; index += groups.x * groups.y * faces_here) {
        measure(atomicLoad(&listed_faces[FIRST_LISTED + parameters.most_long + index]), lane, width);
    }
}
