// Multigrid: the first relaxation of the finest grid, from values of zero.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> own: array<vec2f>;
@group(0) @binding(3) var<storage, read> rights: array<f32>;
@group(0) @binding(4) var<storage, read_write> others: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let node = workgroup_index(group, groups) * 256u + local;
    if (state.done != 0u || node >= parameters.node_count) {
        return;
    }
    others[node] = (parameters.first_relaxation * own[node].y) * rights[node];
}
