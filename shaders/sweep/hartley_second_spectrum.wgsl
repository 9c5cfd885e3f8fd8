// Second stage of the Hartley transform of the residual: its spectrum about the axis.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> twiddles: array<vec2f>;
@group(0) @binding(3) var<storage, read> intermediate: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> spectrum: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups) * 256u + local;
    let frequencies = parameters.nodes / 2u + 1u;
    if (state.done != 0u || index >= parameters.rings * frequencies) {
        return;
    }
    let ring = index / frequencies;
    let frequency = index % frequencies;
    let both = second_stage(ring, frequency);
    spectrum[ring * parameters.nodes + frequency] = both.x;
    if (frequency > 0u && 2u * frequency != parameters.nodes) {
        spectrum[(ring + 1u) * parameters.nodes - frequency] = both.y;
    }
}
