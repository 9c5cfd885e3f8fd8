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
fn value_of(own: u32, other: u32, local: u32) -> u32 {
    workgroupBarrier();
    exchanged[local].x = own;
    workgroupBarrier();
    return exchanged[other].x;
}

// The sum of the values of all invocations with smaller numbers.
fn sum_before(own: u32, local: u32) -> u32 {
    var before = 0u;
    for (var mask = 1u; mask < THREADS; mask *= 2u) {
        // The sum of the block of `mask` invocations to the left, where this one is in the right half of two.
        workgroupBarrier();
        exchanged[local].x = before + own;
        workgroupBarrier();
        if ((local & mask) != 0u) {
            before += exchanged[(local & ~(2u * mask - 1u)) + mask - 1u].x;
        }
    }
    return before;
}

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    measure_blocks(workgroup_index(group, groups), groups.x * groups.y, group.z, local);
}
