// Second step: block sums to the number of points before each block. One workgroup.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read_write> block_sums: array<u32>;

var<workgroup> scan: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let blocks = (job.cylinders * job.faces + 1023u) / 1024u;
    var before = 0u;
    for (var first = 0u; first < blocks; first += 256u) {
        let index = first + local;
        var own = 0u;
        if (index < blocks) {
            own = block_sums[index];
        }
        scan[local] = own;
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
        if (index < blocks) {
            block_sums[index] = before + scan[local] - own;
        }
        before += scan[255];
        workgroupBarrier();
    }
}
