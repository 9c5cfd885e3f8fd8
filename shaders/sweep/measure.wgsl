// The residual of every echo, and its new projection onto the wall.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> echoes: array<Echo>;
@group(0) @binding(3) var<storage, read> wall: array<f32>;
// From each echo to its projection, in rings and nodes.
@group(0) @binding(4) var<storage, read_write> shifts: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> residuals: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups) * 256u + local;
    if (!is_solved(state.done) || index >= parameters.echoes) {
        return;
    }
    let echo = echoes[index];
    let to_wall = residual_to_wall(echo, shifts[index]);
    residuals[index] = to_wall.residual;
    if (parameters.project != 0u) {
        let size = abs(to_wall.residual);
        let reach = select(1.0, parameters.max_projection / size, size > parameters.max_projection);
        let distance = -(to_wall.normal_distance / to_wall.variance) * reach;
        shifts[index] = vec2f(
            to_wall.likeliest.z * distance / echo.step,
            to_wall.likeliest.y * distance / to_wall.arc,
        );
    }
}
