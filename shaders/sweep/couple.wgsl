// Solves for the separators, one system per coefficient: forward through all of them, and back.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
// Per separator and frequency: 1/D, and the factors of the next three separators.
@group(0) @binding(2) var<storage, read> separators: array<vec4f>;
@group(0) @binding(3) var<storage, read> updates: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> spectrum: array<f32>;

fn place(separator: u32, coefficient: u32) -> u32 {
    return ((separator / 2u + 1u) * parameters.block_rings + separator % 2u) * parameters.nodes + coefficient;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let coefficient = workgroup_index(group, groups) * 64u + local;
    if (state.done != 0u || coefficient >= parameters.nodes) {
        return;
    }
    let frequency = frequency_of(coefficient);
    let count = 2u * (parameters.blocks - 1u);
    // Schur-complement updates of the next three separators.
    var update = vec3f(0.0);
    for (var separator = 0u; separator < count; separator++) {
        let block = separator / 2u;
        let below = updates[block * parameters.nodes + coefficient];
        let above = updates[(block + 1u) * parameters.nodes + coefficient];
        let of_interiors = select(below.z + above.x, below.w + above.y, separator % 2u == 1u);
        let at = place(separator, coefficient);
        let x = (spectrum[at] - of_interiors) - update.x;
        spectrum[at] = x;
        let row = separators[separator * frequency_count() + frequency];
        update = vec3f(update.y + row.y * x, update.z + row.z * x, row.w * x);
    }
    var known = vec3f(0.0);
    for (var left = count; left > 0u; left--) {
        let at = place(left - 1u, coefficient);
        let row = separators[(left - 1u) * frequency_count() + frequency];
        let x = spectrum[at] * row.x - row.y * known.x - row.z * known.y - row.w * known.z;
        spectrum[at] = x;
        known = vec3f(x, known.x, known.y);
    }
}
