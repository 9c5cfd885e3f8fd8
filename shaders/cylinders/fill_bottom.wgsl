// The values of the bottom triangles; one without points takes the mean over its edge neighbours, of which an
// empty one counts 0.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> statistics: array<TriangleStatistic>;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let face = workgroup_index(group, groups) * 64u + local;
    if (face >= job.faces) {
        return;
    }
    let bottom = 2u * group.z * job.faces;
    let top = bottom + job.faces;
    var value = statistics[bottom + face].value;
    if (statistics[bottom + face].kept == 0u) {
        let j = face % job.nodes;
        let next = face - j + select(j + 1u, 0u, j + 1u == job.nodes);
        value = statistics[top + face].value + statistics[top + next].value;
        if (face >= job.nodes) {
            value = (value + statistics[top + face - job.nodes].value) / 3.0;
        } else {
            value = value / 2.0;
        }
    }
    values[bottom + face] = value;
}
