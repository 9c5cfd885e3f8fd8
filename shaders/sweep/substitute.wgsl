// Back substitution through the interior of each block, whose separators are solved, one system per
// coefficient.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
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
    if (state.done != 0u || index >= parameters.blocks * parameters.nodes) {
        return;
    }
    let block = index / parameters.nodes;
    let coefficient = index % parameters.nodes;
    let frequency = frequency_of(coefficient);
    var first = 0.0;
    var second = 0.0;
    if (block > 0u) {
        let separator = block * parameters.block_rings * parameters.nodes + coefficient;
        first = spectrum[separator];
        second = spectrum[separator + parameters.nodes];
    }
    let end = end_of_interior(block);
    var next = 0.0;
    var next_but_one = 0.0;
    if (block + 1u < parameters.blocks) {
        next = spectrum[end * parameters.nodes + coefficient];
        next_but_one = spectrum[(end + 1u) * parameters.nodes + coefficient];
    }
    for (var ring = end; ring > first_interior(block); ring--) {
        let at = (ring - 1u) * parameters.nodes + coefficient;
        let x = spectrum[at] * factors[factor_index(INVERSE, ring - 1u, frequency)]
            - factors[factor_index(NEXT, ring - 1u, frequency)] * next
            - factors[factor_index(NEXT_BUT_ONE, ring - 1u, frequency)] * next_but_one
            - factors[factor_index(FIRST_SEPARATOR, ring - 1u, frequency)] * first
            - factors[factor_index(SECOND_SEPARATOR, ring - 1u, frequency)] * second;
        spectrum[at] = x;
        next_but_one = next;
        next = x;
    }
}
