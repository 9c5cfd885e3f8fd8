// Multigrid: adds the values of the next coarser grid to those of this one.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let level = levels[0];
    let place = workgroup_index(group, groups) * 256u + local;
    if (state.done != 0u || place >= level.count) {
        return;
    }
    values[level.first + place] += interpolated(level, levels[1], place / level.nodes, place % level.nodes);
}
