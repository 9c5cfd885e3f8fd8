// The weights of the next coarser grid, and the inverse diagonal of its matrix.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read_write> own: array<vec2f>;

fn fine_value(fine: Level, coarse: Level, ring: u32, u: u32, j: u32) -> f32 {
    let node = candidate(u, j, fine.nodes, coarse.nodes, true);
    return own[fine.first + ring * fine.nodes + node].x;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let coarse = levels[1];
    let node = workgroup_index(group, groups) * 64u + local;
    if (node >= coarse.count) {
        return;
    }
    let k = node / coarse.nodes;
    let weight = restricted(levels[0], coarse, k, node % coarse.nodes);
    own[coarse.first + node] = vec2f(weight, 1.0 / (weight + diagonal(coarse, k)));
}
