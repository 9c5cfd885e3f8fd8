// Second step of the prefix sum over the faces' counts: from the sum of each block to the sum of all blocks
// before it. One workgroup.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read_write> block_sums: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let blocks = (parameters.cylinders * parameters.faces + 1023u) / 1024u;
    var before = 0u;
    for (var first = 0u; first < blocks; first += 256u) {
        let index = first + local;
        var own = 0u;
        if (index < blocks) {
            own = block_sums[index];
        }
        let upto = inclusive_scan(own, local);
        if (index < blocks) {
            block_sums[index] = before + upto - own;
        }
        before += running[255].x;
        workgroupBarrier();
    }
}
