// The residual, ring by ring, as waves about the axis.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
// cos + sin at each node's angle.
@group(0) @binding(2) var<storage, read> waves: array<f32>;
@group(0) @binding(3) var<storage, read> residual: array<f32>;
@group(0) @binding(4) var<storage, read_write> spectrum: array<f32>;

fn value(node: u32) -> f32 {
    return residual[node];
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
    let frequency = 64u * (index % across) + local;
    let sums = transformed(first_ring, frequency, local);
    if (frequency < job.nodes) {
        for (var i = 0u; i < min(8u, job.rings - first_ring); i++) {
            spectrum[(first_ring + i) * job.nodes + frequency] = component(sums, i);
        }
    }
}
