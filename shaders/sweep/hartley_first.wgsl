// First stage of the Hartley transform of every ring: the sums over its nodes of cos + sin times their
// values. The transform is its own inverse but for a factor. N is the product of a short and a long factor:
// this stage transforms the sets of nodes that lie `long_factor` apart, the second one combines these sets.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
// cos and sin at each node's angle.
@group(0) @binding(2) var<storage, read> twiddles: array<vec2f>;
@group(0) @binding(3) var<storage, read> values: array<f32>;
// At place r * short_factor + p of a ring: cos and sin part of frequency p, over the nodes r, r +
// long_factor, ...
@group(0) @binding(4) var<storage, read_write> intermediate: array<vec2f>;

fn first_stage(ring: u32, place: u32) -> vec2f {
    let first = place / parameters.short_factor;
    let turn = parameters.long_factor * (place % parameters.short_factor);
    var sum = vec2f(0.0);
    var phase = 0u;
    for (var i = 0u; i < parameters.short_factor; i++) {
        let x = values[ring * parameters.nodes + parameters.long_factor * i + first];
        let twiddle = twiddles[phase];
        sum = vec2f(sum.x + x * twiddle.x, sum.y + x * twiddle.y);
        phase += turn;
        if (phase >= parameters.nodes) {
            phase -= parameters.nodes;
        }
    }
    return sum;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let node = workgroup_index(group, groups) * 256u + local;
    if (state.done != 0u || node >= parameters.node_count) {
        return;
    }
    intermediate[node] = first_stage(node / parameters.nodes, node % parameters.nodes);
}
