// Back through the inside of each block, for each wave, its joints being known.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> factors: array<f32>;
@group(0) @binding(3) var<storage, read_write> spectrum: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups) * 64u + local;
    if (state.done != 0u || index >= job.blocks * job.nodes) {
        return;
    }
    let block = index / job.nodes;
    let wave = index % job.nodes;
    let frequency = frequency_of(wave);
    var first = 0.0;
    var second = 0.0;
    if (block > 0u) {
        let joint = block * job.block_rings * job.nodes + wave;
        first = spectrum[joint];
        second = spectrum[joint + job.nodes];
    }
    let end = end_of(block);
    var next = 0.0;
    var next_but_one = 0.0;
    if (block + 1u < job.blocks) {
        next = spectrum[end * job.nodes + wave];
        next_but_one = spectrum[(end + 1u) * job.nodes + wave];
    }
    for (var ring = end; ring > first_inside(block); ring--) {
        let at = (ring - 1u) * job.nodes + wave;
        let x = spectrum[at] * factors[factor_index(INVERSE, ring - 1u, frequency)]
            - factors[factor_index(NEXT, ring - 1u, frequency)] * next
            - factors[factor_index(NEXT_BUT_ONE, ring - 1u, frequency)] * next_but_one
            - factors[factor_index(FIRST_JOINT, ring - 1u, frequency)] * first
            - factors[factor_index(SECOND_JOINT, ring - 1u, frequency)] * second;
        spectrum[at] = x;
        next_but_one = next;
        next = x;
    }
}
