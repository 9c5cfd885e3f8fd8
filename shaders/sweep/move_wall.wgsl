// Moves the wall by the solution, and sums up the distances that its nodes travel, weighted by the diagonal of the
// echoes' equations, and these weights: two sums for every workgroup.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> change: array<f32>;
@group(0) @binding(3) var<storage, read> rows: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> wall: array<f32>;
@group(0) @binding(5) var<storage, read_write> travels: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups);
    let node = index * 256u + local;
    if (!is_solved(state.done) || index * 256u >= parameters.node_count) {
        return;
    }
    var weight = 0.0;
    var weighted = 0.0;
    if (node < parameters.node_count) {
        let travel = parameters.noise * change[node];
        wall[node] += travel;
        weight = rows[node].x;
        weighted = weight * abs(travel);
    }
    let travelled = sum_of_workgroup(weighted, 256u, local);
    if (local == 0u) {
        travels[2u * index] = travelled;
    }
    workgroupBarrier();
    let weights = sum_of_workgroup(weight, 256u, local);
    if (local == 0u) {
        travels[2u * index + 1u] = weights;
    }
}
