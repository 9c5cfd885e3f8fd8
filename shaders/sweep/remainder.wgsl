// Multigrid: what the values of a grid leave of its right-hand side.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> rows: array<vec4f>;
@group(0) @binding(4) var<storage, read> own: array<vec2f>;
@group(0) @binding(5) var<storage, read> rights: array<f32>;
@group(0) @binding(6) var<storage, read> values: array<f32>;
@group(0) @binding(7) var<storage, read_write> others: array<f32>;

fn value(node: u32) -> f32 {
    return values[node];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let level = levels[0];
    let place = workgroup_index(group, groups) * 256u + local;
    if (state.done != 0u || place >= level.count) {
        return;
    }
    let node = level.first + place;
    others[node] = rights[node] - times(level, place / level.nodes, place % level.nodes);
}
