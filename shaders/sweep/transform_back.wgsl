// The waves as values at the nodes again, and their product with the residual.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> waves: array<f32>;
@group(0) @binding(3) var<storage, read> spectrum: array<f32>;
@group(0) @binding(4) var<storage, read> residual: array<f32>;
@group(0) @binding(5) var<storage, read_write> preconditioned: array<f32>;
@group(0) @binding(6) var<storage, read_write> partials: array<f32>;

fn value(node: u32) -> f32 {
    return spectrum[node];
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups);
    let across = (job.nodes + 63u) / 64u;
    let first_ring = 8u * (index / across);
    if (state.done != 0u || first_ring >= job.rings) {
        return;
    }
    let j = 64u * (index % across) + local;
    let sums = transformed(first_ring, j, local);
    var own = 0.0;
    if (j < job.nodes) {
        for (var i = 0u; i < min(8u, job.rings - first_ring); i++) {
            let node = (first_ring + i) * job.nodes + j;
            let x = component(sums, i) * job.per_node;
            preconditioned[node] = x;
            own += residual[node] * x;
        }
    }
    let sum = sum_of_workgroup(own, 64u, local);
    if (local == 0u) {
        partials[index] = sum;
    }
}
