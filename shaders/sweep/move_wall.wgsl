// Moves the wall by the solution, and sums up the distances that its nodes travel.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> change: array<f32>;
@group(0) @binding(2) var<storage, read_write> wall: array<f32>;
@group(0) @binding(3) var<storage, read_write> partials: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups);
    let node = index * 256u + local;
    if (index * 256u >= parameters.node_count) {
        return;
    }
    var own = 0.0;
    if (node < parameters.node_count) {
        let travel = parameters.noise * change[node];
        wall[node] += travel;
        own = abs(travel);
    }
    let sum = sum_of_workgroup(own, 256u, local);
    if (local == 0u) {
        partials[index] = sum;
    }
}
