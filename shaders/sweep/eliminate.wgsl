// Eliminates the interior of each block, one system per coefficient. Its Schur-complement updates go to the
// separators on either side.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> factors: array<f32>;
@group(0) @binding(3) var<storage, read_write> spectrum: array<f32>;
// Per block and coefficient: of the two separators before its interior and of the two after it.
@group(0) @binding(4) var<storage, read_write> updates: array<vec4f>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups) * 64u + local;
    if (state.done != 0u || index >= parameters.blocks * parameters.nodes) {
        return;
    }
    let block = index / parameters.nodes;
    let coefficient = index % parameters.nodes;
    let frequency = frequency_of(coefficient);
    // Updates of the next two rings and of the two separators before.
    var next = 0.0;
    var next_but_one = 0.0;
    var first = 0.0;
    var second = 0.0;
    let end = end_of_interior(block);
    for (var ring = first_interior(block); ring < end; ring++) {
        let at = ring * parameters.nodes + coefficient;
        let x = spectrum[at] - next;
        spectrum[at] = x;
        next = next_but_one + factors[factor_index(NEXT, ring, frequency)] * x;
        next_but_one = factors[factor_index(NEXT_BUT_ONE, ring, frequency)] * x;
        first += factors[factor_index(FIRST_SEPARATOR, ring, frequency)] * x;
        second += factors[factor_index(SECOND_SEPARATOR, ring, frequency)] * x;
    }
    updates[index] = vec4f(first, second, next, next_but_one);
}
