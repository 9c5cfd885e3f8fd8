// Multigrid: the right-hand side of the next coarser grid, from what is left on this one, and its first relaxation from
// values of zero.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> own: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> rights: array<f32>;
@group(0) @binding(5) var<storage, read_write> others: array<f32>;

fn fine_value(node: u32) -> f32 {
    return others[node];
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let coarse = levels[1];
    let place = workgroup_index(group, groups) * 64u + local;
    if (state.done != 0u || place >= coarse.count) {
        return;
    }
    let node = coarse.first + place;
    let right = restricted(levels[0], coarse, place / coarse.nodes, place % coarse.nodes);
    rights[node] = right;
    others[node] = (parameters.first_relaxation * own[node].y) * right;
}
