// The next digit of the median of |residual|, from the histogram of that digit. One workgroup.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> state: State;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let own = counts[local];
    counts[local] = 0u;
    let sum = inclusive_scan(own, local);
    let before = sum - own;
    let rank = state.rank;
    let digits = state.digits;
    storageBarrier();
    workgroupBarrier();
    if (before <= rank && rank < sum) {
        state.prefix |= local << (24u - 8u * digits);
        state.rank = rank - before;
        state.digits = digits + 1u;
    }
}
