// The waves: first half of their transform back.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
// cos and sin at each node's angle.
@group(0) @binding(2) var<storage, read> waves: array<vec2f>;
@group(0) @binding(3) var<storage, read> spectrum: array<f32>;
@group(0) @binding(4) var<storage, read_write> parts: array<vec2f>;

fn value(node: u32) -> f32 {
    return spectrum[node];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let node = workgroup_index(group, groups) * 256u + local;
    if (state.done != 0u || node >= job.node_count) {
        return;
    }
    parts[node] = part(node / job.nodes, node % job.nodes);
}
