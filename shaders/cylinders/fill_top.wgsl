// The values of the top triangles; one without points takes the mean over its edge neighbours, filled already.

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
    var value = statistics[top + face].value;
    if (statistics[top + face].kept == 0u) {
        let j = face % job.nodes;
        let previous = face - j + select(j, job.nodes, j == 0u) - 1u;
        value = values[bottom + face] + values[bottom + previous];
        if (face + job.nodes < job.faces) {
            value = (value + values[bottom + face + job.nodes]) / 3.0;
        } else {
            value = value / 2.0;
        }
    }
    values[top + face] = value;
}
