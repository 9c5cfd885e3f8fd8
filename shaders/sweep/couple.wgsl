// The joints, for each wave: forward through all of them, and back.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> state: State;
// Per joint and frequency: 1/D, and the factors of the three joints behind it.
@group(0) @binding(2) var<storage, read> joints: array<vec4f>;
@group(0) @binding(3) var<storage, read> pulls: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> spectrum: array<f32>;

fn place(joint: u32, wave: u32) -> u32 {
    return ((joint / 2u + 1u) * job.block_rings + joint % 2u) * job.nodes + wave;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let wave = workgroup_index(group, groups) * 64u + local;
    if (state.done != 0u || wave >= job.nodes) {
        return;
    }
    let frequency = frequency_of(wave);
    let count = 2u * (job.blocks - 1u);
    // What those before pull at the next three.
    var pull = vec3f(0.0);
    for (var joint = 0u; joint < count; joint++) {
        let block = joint / 2u;
        let behind = pulls[block * job.nodes + wave];
        let ahead = pulls[(block + 1u) * job.nodes + wave];
        let of_blocks = select(behind.z + ahead.x, behind.w + ahead.y, joint % 2u == 1u);
        let at = place(joint, wave);
        let x = (spectrum[at] - of_blocks) - pull.x;
        spectrum[at] = x;
        let row = joints[joint * frequency_count() + frequency];
        pull = vec3f(pull.y + row.y * x, pull.z + row.z * x, row.w * x);
    }
    var known = vec3f(0.0);
    for (var left = count; left > 0u; left--) {
        let at = place(left - 1u, wave);
        let row = joints[(left - 1u) * frequency_count() + frequency];
        let x = spectrum[at] * row.x - row.y * known.x - row.z * known.y - row.w * known.z;
        spectrum[at] = x;
        known = vec3f(x, known.x, known.y);
    }
}
