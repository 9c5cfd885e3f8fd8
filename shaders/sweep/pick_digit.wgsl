// The next digit of the median of |miss|. One workgroup.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> state: State;

var<workgroup> scan: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let own = counts[local];
    counts[local] = 0u;
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
    let before = scan[local] - own;
    let wanted = state.rest;
    let round = state.round;
    storageBarrier();
    workgroupBarrier();
    if (before <= wanted && wanted < scan[local]) {
        state.prefix |= local << (24u - 8u * round);
        state.rest = wanted - before;
        state.round = round + 1u;
    }
}
