// Distances and statistics of the faces with few points: several faces per workgroup, LANES invocations per
// face. Order statistics by counting ranks.

override LANES: u32 = 8u;

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<f32>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// Per cylinder its bottom triangles, then its top ones.
@group(0) @binding(5) var<storage, read_write> statistics: array<TriangleStatistic>;

// Room for 8 * LANES points per face. Each point has a key in the rows of both triangles of its face: EMPTY
// in the row of the farther one. Bottom rows have even numbers, top rows odd ones; with 2 lanes per face
// there are 128 rows, with more lanes fewer.
var<workgroup> keys: array<u32, 2048>;
// One of each per triangle.
var<workgroup> number: array<atomic<u32>, 128>;
var<workgroup> first: array<atomic<u32>, 128>;
var<workgroup> third: array<atomic<u32>, 128>;
var<workgroup> below: array<atomic<u32>, 128>;
var<workgroup> kept: array<atomic<u32>, 128>;
// Sums in two parts: of the lower 16 bits and of the rest.
var<workgroup> all_low: array<atomic<u32>, 128>;
var<workgroup> all_high: array<atomic<i32>, 128>;
var<workgroup> sum_low: array<atomic<u32>, 128>;
var<workgroup> sum_high: array<atomic<i32>, 128>;
var<workgroup> abs_low: array<atomic<u32>, 128>;
var<workgroup> abs_high: array<atomic<i32>, 128>;

// Larger than the key of any number.
const EMPTY: u32 = 0xffffffffu;

// The ranks of a key in its row: from the first number up to, but without, the second.
fn ranks(row: u32, key: u32, count: u32) -> vec2u {
    var less = vec4u(0u);
    var equal = vec4u(0u);
    let begin = row * 8u * LANES;
    for (var i = begin; i < begin + count; i += 4u) {
        let others = vec4u(keys[i], keys[i + 1u], keys[i + 2u], keys[i + 3u]);
        less += select(vec4u(0u), vec4u(1u), others < vec4u(key));
        equal += select(vec4u(0u), vec4u(1u), others == vec4u(key));
    }
    let before = less.x + less.y + less.z + less.w;
    return vec2u(before, before + equal.x + equal.y + equal.z + equal.w);
}

fn holds(ranks: vec2u, rank: u32) -> bool {
    return ranks.x <= rank && rank < ranks.y;
}

fn join(low: u32, high: i32) -> Wide {
    let shifted = Wide(bitcast<u32>(high) << 16u, bitcast<u32>(high >> 16u));
    return add_wide(shifted, Wide(low, 0u));
}

fn bounds_of(triangle: u32, unit: f32) -> Bounds {
    let count = atomicLoad(&number[triangle]);
    if (count < 2u || parameters.outliers == OUTLIERS_NONE) {
        return EVERYTHING;
    }
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        let sum = join(atomicLoad(&all_low[triangle]), atomicLoad(&all_high[triangle]));
        return deviation(mean_of(sum, unit, count));
    }
    return box_plot(number_of(atomicLoad(&first[triangle])), number_of(atomicLoad(&third[triangle])));
}

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = local / LANES;
    let lane = local % LANES;
    let face = workgroup_index(group, groups) * (128u / LANES) + slot;
    let cylinder = group.z;
    let rule = cylinders[cylinder];
    let bottom = 2u * slot;
    let bottom_row = bottom * 8u * LANES;
    let top_row = bottom_row + 8u * LANES;
    var begin = 0u;
    var count = 0u;
    var mine = face < parameters.faces;
    if (mine) {
        begin = offsets[cylinder * parameters.faces + face];
        count = offsets[cylinder * parameters.faces + face + 1u] - begin;
        mine = count <= parameters.max_short;
        count = select(0u, count, mine);
    }
    if (lane < 2u) {
        let triangle = bottom + lane;
        atomicStore(&number[triangle], 0u);
        atomicStore(&below[triangle], 0u);
        atomicStore(&kept[triangle], 0u);
        atomicStore(&all_low[triangle], 0u);
        atomicStore(&all_high[triangle], 0);
        atomicStore(&sum_low[triangle], 0u);
        atomicStore(&sum_high[triangle], 0);
        atomicStore(&abs_low[triangle], 0u);
        atomicStore(&abs_high[triangle], 0);
    }
    workgroupBarrier();

    // Every invocation keeps its own sums, [bottom, top], and adds them once, because atomics are slow.
    if (lane < count) {
        let level = face / parameters.nodes;
        let j = face % parameters.nodes;
        let k = select(j + 1u, 0u, j + 1u == parameters.nodes);
        let row = cylinder * parameters.node_count + level * parameters.nodes;
        let a = radii[row + j];
        let above = row + parameters.nodes;
        let corners = Face(radii[row + k] - a, radii[above + k] - a, radii[above + j] - a);
        var own = vec2u(0u);
        for (var i = lane; i < count; i += LANES) {
            let at = 3u * (begin + i);
            let p = vec3f(grouped[at] - a, grouped[at + 1u], grouped[at + 2u]);
            let nearer = distance_to_face(p, corners, parameters.step_theta, parameters.step_z);
            let key = key_of(nearer.distance);
            keys[bottom_row + i] = select(key, EMPTY, nearer.top);
            keys[top_row + i] = select(EMPTY, key, nearer.top);
            own += select(vec2u(1u, 0u), vec2u(0u, 1u), nearer.top);
        }
        atomicAdd(&number[bottom], own.x);
        atomicAdd(&number[bottom + 1u], own.y);
    }
    // Rows are read four at a time.
    for (var i = count + lane; i < (count + 3u) / 4u * 4u; i += LANES) {
        keys[bottom_row + i] = EMPTY;
        keys[top_row + i] = EMPTY;
    }
    workgroupBarrier();

    if (parameters.outliers == OUTLIERS_IQR) {
        for (var i = lane; i < count; i += LANES) {
            let is_top = keys[bottom_row + i] == EMPTY;
            let triangle = bottom + select(0u, 1u, is_top);
            let key = keys[select(bottom_row, top_row, is_top) + i];
            let n = atomicLoad(&number[triangle]);
            if (n >= 2u) {
                let held = ranks(triangle, key, count);
                if (holds(held, first_quartile(n))) {
                    atomicStore(&first[triangle], key);
                }
                if (holds(held, third_quartile(n))) {
                    atomicStore(&third[triangle], key);
                }
            }
        }
    }
    if (parameters.outliers == OUTLIERS_DEVIATION && lane < count) {
        var own_low = vec2u(0u);
        var own_high = vec2i(0);
        for (var i = lane; i < count; i += LANES) {
            let is_top = keys[bottom_row + i] == EMPTY;
            let step = fixed(number_of(keys[select(bottom_row, top_row, is_top) + i]), rule.scale);
            let low = bitcast<u32>(step) & 0xffffu;
            own_low += select(vec2u(low, 0u), vec2u(0u, low), is_top);
            own_high += select(vec2i(step >> 16u, 0), vec2i(0, step >> 16u), is_top);
        }
        for (var half = 0u; half < 2u; half++) {
            atomicAdd(&all_low[bottom + half], own_low[half]);
            atomicAdd(&all_high[bottom + half], own_high[half]);
        }
    }
    workgroupBarrier();

    if (lane < count) {
        let bottom_bounds = bounds_of(bottom, rule.unit);
        let top_bounds = bounds_of(bottom + 1u, rule.unit);
        var own_below = vec2u(0u);
        var own_kept = vec2u(0u);
        var own_low = vec2u(0u);
        var own_high = vec2i(0);
        var own_abs_low = vec2u(0u);
        var own_abs_high = vec2i(0);
        for (var i = lane; i < count; i += LANES) {
            let is_top = keys[bottom_row + i] == EMPTY;
            let d = number_of(keys[select(bottom_row, top_row, is_top) + i]);
            let low = select(bottom_bounds.low, top_bounds.low, is_top);
            let high = select(bottom_bounds.high, top_bounds.high, is_top);
            let which = select(vec2u(1u, 0u), vec2u(0u, 1u), is_top);
            if (d < low) {
                own_below += which;
            } else if (d <= high) {
                let step = fixed(d, rule.scale);
                let size = abs(step);
                own_kept += which;
                own_low += which * (bitcast<u32>(step) & 0xffffu);
                own_high += vec2i(which) * (step >> 16u);
                own_abs_low += which * (bitcast<u32>(size) & 0xffffu);
                own_abs_high += vec2i(which) * (size >> 16u);
            }
        }
        for (var half = 0u; half < 2u; half++) {
            if (own_below[half] > 0u) {
                atomicAdd(&below[bottom + half], own_below[half]);
            }
            if (own_kept[half] > 0u) {
                atomicAdd(&kept[bottom + half], own_kept[half]);
                atomicAdd(&sum_low[bottom + half], own_low[half]);
                atomicAdd(&sum_high[bottom + half], own_high[half]);
                atomicAdd(&abs_low[bottom + half], own_abs_low[half]);
                atomicAdd(&abs_high[bottom + half], own_abs_high[half]);
            }
        }
    }
    workgroupBarrier();

    if (parameters.statistic == STATISTIC_MEDIAN) {
        for (var i = lane; i < count; i += LANES) {
            let is_top = keys[bottom_row + i] == EMPTY;
            let triangle = bottom + select(0u, 1u, is_top);
            let key = keys[select(bottom_row, top_row, is_top) + i];
            let kept_here = atomicLoad(&kept[triangle]);
            let wanted = atomicLoad(&below[triangle]) + median(max(1u, kept_here));
            if (kept_here > 0u && holds(ranks(triangle, key, count), wanted)) {
                atomicStore(&first[triangle], key);
            }
        }
        workgroupBarrier();
    }

    if (mine && lane < 2u) {
        let triangle = bottom + lane;
        var result = TriangleStatistic(0.0, atomicLoad(&kept[triangle]), 0.0);
        if (result.kept > 0u) {
            let sum = join(atomicLoad(&sum_low[triangle]), atomicLoad(&sum_high[triangle]));
            let size = join(atomicLoad(&abs_low[triangle]), atomicLoad(&abs_high[triangle]));
            result.value = mean_of(sum, rule.unit, result.kept);
            if (parameters.statistic == STATISTIC_MEDIAN) {
                result.value = number_of(atomicLoad(&first[triangle]));
            }
            result.residual = mean_of(size, rule.unit, result.kept);
        }
        statistics[(2u * cylinder + lane) * parameters.faces + face] = result;
    }
}
