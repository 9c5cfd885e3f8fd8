// The total weight of the echoes on each ring, one workgroup per ring.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> rows: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> ring_weights: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let ring = workgroup_index(group, groups);
    if (ring >= parameters.rings) {
        return;
    }
    var own = 0.0;
    for (var j = local; j < parameters.nodes; j += 256u) {
        let row = rows[ring * parameters.nodes + j];
        var weight = row.x + 2.0 * row.y + (row.z + row.w);
        if (ring > 0u) {
            let below = rows[(ring - 1u) * parameters.nodes + j];
            weight += below.z + below.w;
        }
        own += weight;
    }
    let sum = sum_of_workgroup(own, 256u, local);
    if (local == 0u) {
        ring_weights[ring] = sum;
    }
}
