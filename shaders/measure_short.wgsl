// Distances and statistics of the faces with few points, several faces a workgroup, LANES invocations a face.
// Order statistics by counting ranks.

override LANES: u32 = 8u;

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<f32>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// Per cylinder its bottom triangles, then its top ones.
@group(0) @binding(5) var<storage, read_write> statistics: array<TriangleStatistic>;

// Room for 8 * LANES points a face: keys of the bottom triangle from the front, of the top one from the back.
var<workgroup> keys: array<u32, 1024>;
// Two of each a face, bottom and top. At least 2 lanes a face, so at most 64 faces.
var<workgroup> number: array<atomic<u32>, 128>;
var<workgroup> first: array<u32, 128>;
var<workgroup> third: array<u32, 128>;
var<workgroup> below: array<atomic<u32>, 128>;
var<workgroup> kept: array<atomic<u32>, 128>;
// Sums in two parts, of the lower 16 bits and of the rest.
var<workgroup> all_low: array<atomic<u32>, 128>;
var<workgroup> all_high: array<atomic<i32>, 128>;
var<workgroup> sum_low: array<atomic<u32>, 128>;
var<workgroup> sum_high: array<atomic<i32>, 128>;
var<workgroup> abs_low: array<atomic<u32>, 128>;
var<workgroup> abs_high: array<atomic<i32>, 128>;

fn key_index(triangle: u32, entry: u32) -> u32 {
    let capacity = 8u * LANES;
    let base = (triangle / 2u) * capacity;
    return select(base + entry, base + capacity - 1u - entry, (triangle & 1u) == 1u);
}

// How many keys of the triangle come before this one.
fn rank(triangle: u32, entry: u32, count: u32) -> u32 {
    let key = keys[key_index(triangle, entry)];
    var before = 0u;
    for (var i = 0u; i < count; i++) {
        let other = keys[key_index(triangle, i)];
        before += select(0u, 1u, other < key || (other == key && i < entry));
    }
    return before;
}

fn join(low: u32, high: i32) -> Wide {
    let shifted = Wide(bitcast<u32>(high) << 16u, bitcast<u32>(high >> 16u));
    return add_wide(shifted, Wide(low, 0u));
}

fn bounds_of(triangle: u32, count: u32, unit: f32) -> Bounds {
    if (count < 2u || job.outliers == OUTLIERS_NONE) {
        return EVERYTHING;
    }
    if (job.outliers == OUTLIERS_DEVIATION) {
        let sum = join(atomicLoad(&all_low[triangle]), atomicLoad(&all_high[triangle]));
        return deviation(mean_of(sum, unit, count));
    }
    return box_plot(number_of(first[triangle]), number_of(third[triangle]));
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
    var begin = 0u;
    var count = 0u;
    var mine = face < job.faces;
    if (mine) {
        begin = offsets[cylinder * job.faces + face];
        count = offsets[cylinder * job.faces + face + 1u] - begin;
        mine = count <= job.short_most;
        count = select(0u, count, mine);
    }
    if (lane < 2u) {
        let triangle = 2u * slot + lane;
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

    if (count > 0u) {
        let level = face / job.nodes;
        let j = face % job.nodes;
        let k = select(j + 1u, 0u, j + 1u == job.nodes);
        let row = cylinder * job.node_count + level * job.nodes;
        let a = radii[row + j];
        let corners = Face(radii[row + k] - a, radii[row + job.nodes + k] - a, radii[row + job.nodes + j] - a);
        for (var i = lane; i < count; i += LANES) {
            let at = 3u * (begin + i);
            let p = vec3f(grouped[at] - a, grouped[at + 1u], grouped[at + 2u]);
            let nearer = distance_to_face(p, corners, job.step_theta, job.step_z);
            let triangle = 2u * slot + select(0u, 1u, nearer.top);
            let entry = atomicAdd(&number[triangle], 1u);
            keys[key_index(triangle, entry)] = key_of(nearer.distance);
        }
    }
    workgroupBarrier();

    for (var half = 0u; half < 2u; half++) {
        let triangle = 2u * slot + half;
        let n = atomicLoad(&number[triangle]);
        if (n >= 2u && job.outliers == OUTLIERS_IQR) {
            for (var entry = lane; entry < n; entry += LANES) {
                let place = rank(triangle, entry, n);
                if (place == first_quartile(n)) {
                    first[triangle] = keys[key_index(triangle, entry)];
                }
                if (place == third_quartile(n)) {
                    third[triangle] = keys[key_index(triangle, entry)];
                }
            }
        }
        if (n >= 2u && job.outliers == OUTLIERS_DEVIATION) {
            for (var entry = lane; entry < n; entry += LANES) {
                let step = fixed(number_of(keys[key_index(triangle, entry)]), rule.scale);
                atomicAdd(&all_low[triangle], bitcast<u32>(step) & 0xffffu);
                atomicAdd(&all_high[triangle], step >> 16u);
            }
        }
    }
    workgroupBarrier();

    for (var half = 0u; half < 2u; half++) {
        let triangle = 2u * slot + half;
        let n = atomicLoad(&number[triangle]);
        let bounds = bounds_of(triangle, n, rule.unit);
        for (var entry = lane; entry < n; entry += LANES) {
            let d = number_of(keys[key_index(triangle, entry)]);
            if (d < bounds.low) {
                atomicAdd(&below[triangle], 1u);
            } else if (d <= bounds.high) {
                let step = fixed(d, rule.scale);
                atomicAdd(&kept[triangle], 1u);
                atomicAdd(&sum_low[triangle], bitcast<u32>(step) & 0xffffu);
                atomicAdd(&sum_high[triangle], step >> 16u);
                let size = abs(step);
                atomicAdd(&abs_low[triangle], bitcast<u32>(size) & 0xffffu);
                atomicAdd(&abs_high[triangle], size >> 16u);
            }
        }
    }
    workgroupBarrier();

    if (job.statistic == STATISTIC_MEDIAN) {
        for (var half = 0u; half < 2u; half++) {
            let triangle = 2u * slot + half;
            let n = atomicLoad(&number[triangle]);
            let wanted = atomicLoad(&below[triangle]) + median(max(1u, atomicLoad(&kept[triangle])));
            for (var entry = lane; entry < n; entry += LANES) {
                if (rank(triangle, entry, n) == wanted) {
                    first[triangle] = keys[key_index(triangle, entry)];
                }
            }
        }
        workgroupBarrier();
    }

    if (mine && lane < 2u) {
        let triangle = 2u * slot + lane;
        var result = TriangleStatistic(0.0, atomicLoad(&kept[triangle]), 0.0);
        if (result.kept > 0u) {
            let sum = join(atomicLoad(&sum_low[triangle]), atomicLoad(&sum_high[triangle]));
            let size = join(atomicLoad(&abs_low[triangle]), atomicLoad(&abs_high[triangle]));
            result.value = mean_of(sum, rule.unit, result.kept);
            if (job.statistic == STATISTIC_MEDIAN) {
                result.value = number_of(first[triangle]);
            }
            result.residual = mean_of(size, rule.unit, result.kept);
        }
        statistics[(2u * cylinder + lane) * job.faces + face] = result;
    }
}
