// The right-hand side of the equations for whole radii instead of changes, in units of the noise: the
// reference of the solver's relative residual.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> sums_low: array<u32>;
@group(0) @binding(2) var<storage, read> sums_high: array<u32>;
@group(0) @binding(3) var<storage, read> wall: array<f32>;
@group(0) @binding(4) var<storage, read> rows: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> cg_residual: array<f32>;

fn value(node: u32) -> f32 {
    return (wall[node] + parameters.start) * parameters.per_noise;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let node = workgroup_index(group, groups) * 256u + local;
    if (node >= parameters.node_count) {
        return;
    }
    let of_echoes = mean_of(Wide(sums_low[5u * node + 4u], sums_high[5u * node + 4u]), parameters.rhs_unit, 1u);
    let k = node / parameters.nodes;
    let at = places_of(finest(), k, node % parameters.nodes);
    let couplings = couplings_at(k, at, parameters.nodes);
    cg_residual[node] = coupled(finest(), k, couplings, stencil_at(finest(), k, at, parameters.nodes)) + of_echoes;
}
