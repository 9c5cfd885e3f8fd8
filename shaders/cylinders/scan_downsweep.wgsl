// Third step: where each face's points begin, and behind the last face their number.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read> block_sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> offsets: array<u32>;

var<workgroup> scan: array<u32, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = workgroup_index(group, groups);
    let total = job.cylinders * job.faces;
    let first = block * 1024u + local * 4u;
    var own = vec4u(0u);
    for (var i = 0u; i < 4u; i++) {
        if (first + i < total) {
            own[i] = counts[first + i];
        }
    }
    let sum = own.x + own.y + own.z + own.w;
    scan[local] = sum;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var left = 0u;
        if (local >= step) {
            left = scan[local - step];
        }
        workgroupBarrier();
        scan[local] += left;
        workgroupBarrier();
    }
    if (block * 1024u >= total) {
        return;
    }
    var before = block_sums[block] + scan[local] - sum;
    for (var i = 0u; i < 4u; i++) {
        if (first + i < total) {
            offsets[first + i] = before;
            before += own[i];
            if (first + i + 1u == total) {
                offsets[total] = before;
            }
        }
    }
}
