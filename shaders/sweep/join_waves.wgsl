// The residual as waves about the axis: second half of its transform.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> waves: array<vec2f>;
@group(0) @binding(3) var<storage, read> parts: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> spectrum: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups) * 256u + local;
    let frequencies = job.nodes / 2u + 1u;
    if (state.done != 0u || index >= job.rings * frequencies) {
        return;
    }
    let ring = index / frequencies;
    let frequency = index % frequencies;
    let both = joined(ring, frequency);
    spectrum[ring * job.nodes + frequency] = both.x;
    if (frequency > 0u && 2u * frequency != job.nodes) {
        spectrum[(ring + 1u) * job.nodes - frequency] = both.y;
    }
}
