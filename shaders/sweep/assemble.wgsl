// The equations of a node, from the sums over echoes, and their residual for the wall as it is, in units of
// the noise. `product` holds that residual until the solver starts.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> sums_low: array<u32>;
@group(0) @binding(2) var<storage, read> sums_high: array<u32>;
@group(0) @binding(3) var<storage, read> wall: array<f32>;
// Coefficients of the node itself, of the next node of its ring, of the node above and of the next node
// above.
@group(0) @binding(4) var<storage, read_write> rows: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> product: array<f32>;
@group(0) @binding(6) var<storage, read_write> change: array<f32>;
@group(0) @binding(7) var<storage, read_write> direction: array<f32>;

fn value(node: u32) -> f32 {
    return wall[node];
}

fn sum(node: u32, part: u32, unit: f32) -> f32 {
    return mean_of(Wide(sums_low[5u * node + part], sums_high[5u * node + part]), unit, 1u);
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
    rows[node] = vec4f(
        sum(node, 0u, parameters.weight_unit),
        sum(node, 1u, parameters.weight_unit),
        sum(node, 2u, parameters.weight_unit),
        sum(node, 3u, parameters.weight_unit),
    );
    let k = node / parameters.nodes;
    let at = places_of(finest(), k, node % parameters.nodes);
    let gradient = bending(finest(), k, stencil_at(finest(), k, at, parameters.nodes));
    product[node] = sum(node, 4u, parameters.rhs_unit) - gradient * parameters.per_noise;
    change[node] = 0.0;
    direction[node] = 0.0;
}
