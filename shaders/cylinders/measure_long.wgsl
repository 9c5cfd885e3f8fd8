// Distances and statistics of the faces with many points; a workgroup takes one face at a time. Order
// statistics by selection on the keys, eight bits per round (radix select).

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<f32>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
@group(0) @binding(5) var<storage, read_write> statistics: array<TriangleStatistic>;
// Their number, then the faces; the last word counts the faces that were measured to the end. Some drivers
// end loops early without an error, and the host must not take such a face for a result.
@group(0) @binding(6) var<storage, read_write> long_faces: array<atomic<u32>>;
// One key per point: within a face, keys of the bottom triangle from the front, of the top one from the back.
@group(0) @binding(7) var<storage, read_write> keys: array<u32>;

const THREADS: u32 = 256u;

var<workgroup> number: array<atomic<u32>, 2>;
var<workgroup> histogram: array<array<atomic<u32>, 256>, 2>;
var<workgroup> chosen: array<u32, 2>;
var<workgroup> rest: array<u32, 2>;
var<workgroup> below: atomic<u32>;
var<workgroup> kept: atomic<u32>;
var<workgroup> sum_low: array<atomic<u32>, 2>;
var<workgroup> sum_high: array<atomic<u32>, 2>;
var<workgroup> shared_count: u32;
// Keys of both triangles that the last loop has visited.
var<workgroup> seen: atomic<u32>;

fn key_at(begin: u32, end: u32, half: u32, entry: u32) -> u32 {
    return keys[select(begin + entry, end - 1u - entry, half == 1u)];
}

fn add_to_sum(which: u32, x: Wide) {
    let old = atomicAdd(&sum_low[which], x.low);
    let carry = select(0u, 1u, old + x.low < old);
    atomicAdd(&sum_high[which], x.high + carry);
}

// Puts the keys at two ranks among the n keys of a triangle into `chosen`.
fn select_two(begin: u32, end: u32, half: u32, n: u32, ranks: vec2u, local: u32) {
    if (local < 2u) {
        chosen[local] = 0u;
        rest[local] = ranks[local];
    }
    for (var round = 0u; round < 4u; round++) {
        let shift = 24u - 8u * round;
        atomicStore(&histogram[0][local], 0u);
        atomicStore(&histogram[1][local], 0u);
        workgroupBarrier();
        let prefix = vec2u(chosen[0], chosen[1]);
        for (var entry = local; entry < n; entry += THREADS) {
            let key = key_at(begin, end, half, entry);
            let digit = (key >> shift) & 0xffu;
            // The bits above the digit, by two shifts: one by 32 is not defined.
            let above = (key >> shift) >> 8u;
            if (above == (prefix.x >> shift) >> 8u) {
                atomicAdd(&histogram[0][digit], 1u);
            }
            if (above == (prefix.y >> shift) >> 8u) {
                atomicAdd(&histogram[1][digit], 1u);
            }
        }
        workgroupBarrier();
        let own = vec2u(atomicLoad(&histogram[0][local]), atomicLoad(&histogram[1][local]));
        let upto = inclusive_scan_of_two(own, local);
        let wanted = vec2u(rest[0], rest[1]);
        workgroupBarrier();
        for (var which = 0u; which < 2u; which++) {
            let before = upto[which] - own[which];
            if (before <= wanted[which] && wanted[which] < upto[which]) {
                chosen[which] = prefix[which] | (local << shift);
                rest[which] = wanted[which] - before;
            }
        }
        workgroupBarrier();
    }
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    if (local == 0u) {
        shared_count = atomicLoad(&long_faces[0]);
    }
    let long_count = workgroupUniformLoad(&shared_count);
    for (var index = workgroup_index(group, groups); index < long_count; index += groups.x * groups.y) {
        let face_of_all = atomicLoad(&long_faces[index + 1u]);
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
        let corners = Face(radii[row + k] - a, radii[above + k] - a, radii[above + j] - a);
        if (local < 2u) {
            atomicStore(&number[local], 0u);
        }
        if (local == 0u) {
            atomicStore(&seen, 0u);
        }
        workgroupBarrier();
        for (var i = begin + local; i < end; i += THREADS) {
            let p = vec3f(grouped[3u * i] - a, grouped[3u * i + 1u], grouped[3u * i + 2u]);
            let nearer = distance_to_face(p, corners, parameters.step_theta, parameters.step_z);
            let half = select(0u, 1u, nearer.top);
            let entry = atomicAdd(&number[half], 1u);
            keys[select(begin + entry, end - 1u - entry, nearer.top)] = key_of(nearer.distance);
        }
        storageBarrier();
        workgroupBarrier();

        for (var half = 0u; half < 2u; half++) {
            if (local == 0u) {
                shared_count = atomicLoad(&number[half]);
            }
            let n = workgroupUniformLoad(&shared_count);
            if (local < 2u) {
                atomicStore(&sum_low[local], 0u);
                atomicStore(&sum_high[local], 0u);
            }
            if (local == 0u) {
                atomicStore(&below, 0u);
                atomicStore(&kept, 0u);
            }
            workgroupBarrier();

            var bounds = EVERYTHING;
            if (n >= 2u && parameters.outliers == OUTLIERS_IQR) {
                select_two(begin, end, half, n, vec2u(first_quartile(n), third_quartile(n)), local);
                bounds = box_plot(number_of(chosen[0]), number_of(chosen[1]));
            }
            if (n >= 2u && parameters.outliers == OUTLIERS_DEVIATION) {
                var all = Wide(0u, 0u);
                for (var entry = local; entry < n; entry += THREADS) {
                    let d = number_of(key_at(begin, end, half, entry));
                    all = add_wide(all, widen(fixed(d, rule.scale)));
                }
                add_to_sum(0u, all);
                workgroupBarrier();
                bounds = deviation(mean_of(Wide(atomicLoad(&sum_low[0]), atomicLoad(&sum_high[0])), rule.unit, n));
                workgroupBarrier();
                if (local == 0u) {
                    atomicStore(&sum_low[0], 0u);
                    atomicStore(&sum_high[0], 0u);
                }
                workgroupBarrier();
            }

            var own_seen = 0u;
            var own_below = 0u;
            var own_kept = 0u;
            var own_sum = Wide(0u, 0u);
            var own_size = Wide(0u, 0u);
            for (var entry = local; entry < n; entry += THREADS) {
                let d = number_of(key_at(begin, end, half, entry));
                own_seen += 1u;
                if (d < bounds.low) {
                    own_below += 1u;
                } else if (d <= bounds.high) {
                    let step = fixed(d, rule.scale);
                    own_kept += 1u;
                    own_sum = add_wide(own_sum, widen(step));
                    own_size = add_wide(own_size, widen(abs(step)));
                }
            }
            atomicAdd(&seen, own_seen);
            atomicAdd(&below, own_below);
            atomicAdd(&kept, own_kept);
            add_to_sum(0u, own_sum);
            add_to_sum(1u, own_size);
            workgroupBarrier();

            var result = TriangleStatistic(0.0, atomicLoad(&kept), 0.0);
            if (local == 0u) {
                shared_count = result.kept;
            }
            let any = workgroupUniformLoad(&shared_count);
            if (any > 0u) {
                result.value = mean_of(Wide(atomicLoad(&sum_low[0]), atomicLoad(&sum_high[0])), rule.unit, any);
                result.residual = mean_of(Wide(atomicLoad(&sum_low[1]), atomicLoad(&sum_high[1])), rule.unit, any);
                if (parameters.statistic == STATISTIC_MEDIAN) {
                    let wanted = atomicLoad(&below) + median(any);
                    select_two(begin, end, half, n, vec2u(wanted, wanted), local);
                    result.value = number_of(chosen[0]);
                }
            }
            if (local == 0u) {
                statistics[(2u * cylinder + half) * parameters.faces + face] = result;
            }
            workgroupBarrier();
        }
        if (local == 0u && atomicLoad(&seen) == end - begin) {
            atomicAdd(&long_faces[arrayLength(&long_faces) - 1u], 1u);
        }
        workgroupBarrier();
    }
}
