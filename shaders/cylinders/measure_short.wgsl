// The faces with few points, where a subgroup has LANES invocations or more: they read each other's registers.
// A workgroup of 128 consists of full subgroups, by which its invocations are numbered.

var<private> subgroup_width: u32;

// The value of the invocation whose number differs by the bits of the mask.
fn exchange(own: vec4u, mask: u32, local: u32) -> vec4u {
    return subgroupShuffleXor(own, mask);
}

// The value of another invocation of the face.
fn value_at(own: u32, other: u32, local: u32) -> u32 {
    // A power of two.
    return subgroupShuffle(own, other & (subgroup_width - 1u));
}

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(subgroup_id) id: u32,
    @builtin(subgroup_size) width: u32,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    subgroup_width = width;
    measure_blocks(workgroup_index(group, groups), groups.x * groups.y, group.z, id * width + lane);
}
