// The waves as values at the nodes again: second half of their transform back; and the product with the residual.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> waves: array<vec2f>;
@group(0) @binding(3) var<storage, read> parts: array<vec2f>;
@group(0) @binding(4) var<storage, read> residual: array<f32>;
@group(0) @binding(5) var<storage, read_write> preconditioned: array<f32>;
@group(0) @binding(6) var<storage, read_write> partials: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = workgroup_index(group, groups);
    let frequencies = job.nodes / 2u + 1u;
    if (state.done != 0u || block * 256u >= job.rings * frequencies) {
        return;
    }
    let index = block * 256u + local;
    var own = 0.0;
    if (index < job.rings * frequencies) {
        let ring = index / frequencies;
        // Two nodes as far from the first on either side.
        let j = index % frequencies;
        let both = joined(ring, j);
        let node = ring * job.nodes + j;
        let x = both.x * job.per_node;
        preconditioned[node] = x;
        own = residual[node] * x;
        if (j > 0u && 2u * j != job.nodes) {
            let other = (ring + 1u) * job.nodes - j;
            let y = both.y * job.per_node;
            preconditioned[other] = y;
            own += residual[other] * y;
        }
    }
    let sum = sum_of_workgroup(own, 256u, local);
    if (local == 0u) {
        partials[block] = sum;
    }
}
