// Every echo's way to the wall, and its new foot.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> echoes: array<Echo>;
@group(0) @binding(2) var<storage, read> wall: array<f32>;
// From each echo to its foot, in rings and nodes.
@group(0) @binding(3) var<storage, read_write> shifts: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> misses: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups) * 256u + local;
    if (index >= job.echoes) {
        return;
    }
    let echo = echoes[index];
    let way = way_to_wall(echo, shifts[index]);
    misses[index] = way.miss;
    if (job.feet != 0u) {
        let size = abs(way.miss);
        let reach = select(1.0, job.farthest_foot / size, size > job.farthest_foot);
        let distance = -(way.across / way.variance) * reach;
        shifts[index] = vec2f(way.likeliest.z * distance / echo.step, way.likeliest.y * distance / way.arc);
    }
}
