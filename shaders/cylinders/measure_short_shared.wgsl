// The faces with few points, where the device has no subgroups or smaller ones than LANES invocations: they
// exchange values through workgroup memory.

var<workgroup> exchanged: array<vec4u, 128>;

// The value of the invocation whose number differs by the bits of the mask.
fn exchange(own: vec4u, mask: u32, local: u32) -> vec4u {
    workgroupBarrier();
    exchanged[local] = own;
    workgroupBarrier();
    return exchanged[local ^ mask];
}

// The value of another invocation of the face.
fn value_at(own: u32, other: u32, local: u32) -> u32 {
    workgroupBarrier();
    exchanged[local].x = own;
    workgroupBarrier();
    return exchanged[other].x;
}

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    measure_blocks(workgroup_index(group, groups), groups.x * groups.y, group.z, local);
}
