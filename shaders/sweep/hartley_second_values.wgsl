// Second stage of the Hartley transform of the spectrum: values at the nodes again, and their scalar product
// with the residual.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> twiddles: array<vec2f>;
@group(0) @binding(3) var<storage, read> intermediate: array<vec2f>;
@group(0) @binding(4) var<storage, read> cg_residual: array<f32>;
@group(0) @binding(5) var<storage, read_write> preconditioned: array<f32>;
@group(0) @binding(6) var<storage, read_write> partials: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = workgroup_index(group, groups);
    let frequencies = parameters.nodes / 2u + 1u;
    if (state.done != 0u || block * 256u >= parameters.rings * frequencies) {
        return;
    }
    let index = block * 256u + local;
    var own = 0.0;
    if (index < parameters.rings * frequencies) {
        let ring = index / frequencies;
        // A pair of nodes j and N - j.
        let j = index % frequencies;
        let both = second_stage(ring, j);
        let node = ring * parameters.nodes + j;
        let x = both.x * parameters.per_node;
        preconditioned[node] = x;
        own = cg_residual[node] * x;
        if (j > 0u && 2u * j != parameters.nodes) {
            let other = (ring + 1u) * parameters.nodes - j;
            let y = both.y * parameters.per_node;
            preconditioned[other] = y;
            own += cg_residual[other] * y;
        }
    }
    let sum = sum_of_workgroup(own, 256u, local);
    if (local == 0u) {
        partials[block] = sum;
    }
}
