// Histogram of the next digit of |residual|, over the residuals that share the digits of the median known so
// far.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> residuals: array<f32>;
@group(0) @binding(2) var<storage, read> state: State;
@group(0) @binding(3) var<storage, read_write> counts: array<atomic<u32>>;

var<workgroup> own_counts: array<atomic<u32>, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    if (!is_solved(state.done)) {
        return;
    }
    atomicStore(&own_counts[local], 0u);
    workgroupBarrier();
    let shift = 24u - 8u * state.digits;
    // 16 residuals per invocation, so that most counting happens in workgroup memory.
    let first = workgroup_index(group, groups) * 4096u + local;
    for (var i = 0u; i < 16u; i++) {
        let index = first + 256u * i;
        if (index < parameters.echoes) {
            let key = bitcast<u32>(residuals[index]) & 0x7fffffffu;
            // The digits above this one; a shift by 32 is not defined.
            if ((key >> shift) >> 8u == (state.prefix >> shift) >> 8u) {
                atomicAdd(&own_counts[(key >> shift) & 0xffu], 1u);
            }
        }
    }
    workgroupBarrier();
    let count = atomicLoad(&own_counts[local]);
    if (count > 0u) {
        atomicAdd(&counts[local], count);
    }
}
