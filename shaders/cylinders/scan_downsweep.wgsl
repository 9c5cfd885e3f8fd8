// Third step of the prefix sum over the faces' counts: where each face's points begin, and behind the last
// face the number of all points. Lists the faces that are not short, in no particular order.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> block_sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> listed_faces: array<atomic<u32>>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = workgroup_index(group, groups);
    let total = parameters.cylinders * parameters.faces;
    let first = block * 1024u + local * 4u;
    var own = vec4u(0u);
    for (var i = 0u; i < 4u; i++) {
        if (first + i < total) {
            own[i] = counts[first + i];
        }
    }
    let sum = own.x + own.y + own.z + own.w;
    let upto = inclusive_scan(sum, local);
    if (block * 1024u >= total) {
        return;
    }
    var before = block_sums[block] + upto - sum;
    for (var i = 0u; i < 4u; i++) {
        if (first + i < total) {
            offsets[first + i] = before;
            before += own[i];
            list_face(first + i, own[i]);
            if (first + i + 1u == total) {
                offsets[total] = before;
            }
        }
    }
}
