// Moves the nodes, and sums |travel|.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> values: array<f32>;
@group(0) @binding(3) var<storage, read_write> radii: array<f32>;
// Per cylinder: the sum of |travel| in fixed point, low and high word.
@group(0) @binding(4) var<storage, read_write> travels: array<atomic<u32>>;

var<workgroup> sum_low: atomic<u32>;
var<workgroup> sum_high: atomic<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    if (local == 0u) {
        atomicStore(&sum_low, 0u);
        atomicStore(&sum_high, 0u);
    }
    workgroupBarrier();
    let node = workgroup_index(group, groups) * 64u + local;
    let cylinder = group.z;
    if (node < parameters.node_count) {
        let ring = node / parameters.nodes;
        let j = node % parameters.nodes;
        let before = select(j, parameters.nodes, j == 0u) - 1u;
        let bottom = 2u * cylinder * parameters.faces;
        let top = bottom + parameters.faces;
        var travel = 0.0;
        if (ring > 0u) {
            let row = (ring - 1u) * parameters.nodes;
            travel = values[top + row + before] + values[bottom + row + before] + values[top + row + j];
        }
        if (ring < parameters.levels) {
            let row = ring * parameters.nodes;
            if (ring > 0u) {
                travel = travel + values[bottom + row + before] + values[top + row + j] + values[bottom + row + j];
            } else {
                travel = values[bottom + row + before] + values[top + row + j] + values[bottom + row + j];
            }
        }
        travel = travel / select(3.0, 6.0, ring > 0u && ring < parameters.levels);
        radii[cylinder * parameters.node_count + node] += travel;
        let step = bitcast<u32>(fixed(abs(travel), cylinders[cylinder].scale));
        atomicAdd(&sum_low, step & 0xffffu);
        atomicAdd(&sum_high, step >> 16u);
    }
    workgroupBarrier();
    if (local == 0u) {
        let high = atomicLoad(&sum_high);
        let sum = add_wide(Wide(high << 16u, high >> 16u), Wide(atomicLoad(&sum_low), 0u));
        let old = atomicAdd(&travels[2u * cylinder], sum.low);
        atomicAdd(&travels[2u * cylinder + 1u], sum.high + select(0u, 1u, old + sum.low < old));
    }
}
