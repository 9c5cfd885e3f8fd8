// Multigrid: the last relaxation of a grid; on the finest one also the scalar product of the values with the right-hand
// side.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> rows: array<vec4f>;
@group(0) @binding(4) var<storage, read> own: array<vec2f>;
@group(0) @binding(5) var<storage, read> rights: array<f32>;
@group(0) @binding(6) var<storage, read> others: array<f32>;
@group(0) @binding(7) var<storage, read_write> values: array<f32>;
@group(0) @binding(8) var<storage, read_write> partials: array<f32>;

fn value(node: u32) -> f32 {
    return others[node];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let level = levels[0];
    let index = workgroup_index(group, groups);
    let place = index * 256u + local;
    if (state.done != 0u || index * 256u >= level.count) {
        return;
    }
    var square = 0.0;
    if (place < level.count) {
        let node = level.first + place;
        let left = rights[node] - times(level, place / level.nodes, place % level.nodes);
        let x = value(node) + (parameters.first_relaxation * own[node].y) * left;
        values[node] = x;
        square = rights[node] * x;
    }
    if (level.first == 0u) {
        let sum = sum_of_workgroup(square, 256u, local);
        if (local == 0u) {
            partials[index] = sum;
        }
    }
}
