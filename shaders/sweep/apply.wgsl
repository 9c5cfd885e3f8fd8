// The matrix of the equations times the direction, and the scalar product of both.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> rows: array<vec4f>;
@group(0) @binding(3) var<storage, read> direction: array<f32>;
@group(0) @binding(4) var<storage, read_write> product: array<f32>;
@group(0) @binding(5) var<storage, read_write> partials: array<f32>;

fn value(node: u32) -> f32 {
    return direction[node];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups);
    let node = index * 256u + local;
    if (state.done != 0u || index * 256u >= parameters.node_count) {
        return;
    }
    var own = 0.0;
    if (node < parameters.node_count) {
        let k = node / parameters.nodes;
        let j = node % parameters.nodes;
        let x = coupled(finest(), k, j) + bending(finest(), k, j);
        product[node] = x;
        own = direction[node] * x;
    }
    let sum = sum_of_workgroup(own, 256u, local);
    if (local == 0u) {
        partials[index] = sum;
    }
}
