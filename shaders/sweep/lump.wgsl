// The echoes' weights with their couplings added to them, and the inverse diagonal of the finest grid's matrix.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> rows: array<vec4f>;
// Per node of every grid: the weight, and the inverse of the matrix's diagonal.
@group(0) @binding(2) var<storage, read_write> own: array<vec2f>;

fn value(node: u32) -> f32 {
    return 1.0;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let node = workgroup_index(group, groups) * 256u + local;
    if (node >= parameters.node_count) {
        return;
    }
    let level = finest();
    let k = node / level.nodes;
    let at = places_of(level, k, node % level.nodes);
    let couplings = couplings_at(k, at, level.nodes);
    let weight = coupled(level, k, couplings, stencil_at(level, k, at, level.nodes));
    own[node] = vec2f(weight, 1.0 / (rows[node].x + diagonal(level, k)));
}
