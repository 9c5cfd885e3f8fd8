// First step of the prefix sum over the faces' counts: the sum of each block of 1024.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> block_sums: array<u32>;

var<workgroup> sum: atomic<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = workgroup_index(group, groups);
    let total = parameters.cylinders * parameters.faces;
    if (local == 0u) {
        atomicStore(&sum, 0u);
    }
    workgroupBarrier();
    var own = 0u;
    for (var i = 0u; i < 4u; i++) {
        let index = block * 1024u + i * 256u + local;
        if (index < total) {
            own += counts[index];
        }
    }
    atomicAdd(&sum, own);
    workgroupBarrier();
    if (local == 0u && block * 1024u < total) {
        block_sums[block] = atomicLoad(&sum);
    }
}
