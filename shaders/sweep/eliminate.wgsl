// Forward through the inside of each block, for each wave: what its rings pull at the joints on either side.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> factors: array<f32>;
@group(0) @binding(3) var<storage, read_write> spectrum: array<f32>;
// Per block and wave: on the two joints before it and the two behind it.
@group(0) @binding(4) var<storage, read_write> pulls: array<vec4f>;

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
    // Pulls on the next ring and the one behind it, and on the joints before.
    var next = 0.0;
    var next_but_one = 0.0;
    var first = 0.0;
    var second = 0.0;
    let end = end_of(block);
    for (var ring = first_inside(block); ring < end; ring++) {
        let at = ring * job.nodes + wave;
        let x = spectrum[at] - next;
        spectrum[at] = x;
        next = next_but_one + factors[factor_index(NEXT, ring, frequency)] * x;
        next_but_one = factors[factor_index(NEXT_BUT_ONE, ring, frequency)] * x;
        first += factors[factor_index(FIRST_JOINT, ring, frequency)] * x;
        second += factors[factor_index(SECOND_JOINT, ring, frequency)] * x;
    }
    pulls[index] = vec4f(first, second, next, next_but_one);
}
