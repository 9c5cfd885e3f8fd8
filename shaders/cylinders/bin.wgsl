// The face of each point, and its place among the points of that face. The place depends on the order in
// which invocations run; no later result depends on the place.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> section: array<f32>;
@group(0) @binding(2) var<storage, read> owners: array<u32>;
// Points per face.
@group(0) @binding(3) var<storage, read_write> counts: array<atomic<u32>>;
// Face (NONE where the point did not pass the gate) and place.
@group(0) @binding(4) var<storage, read_write> places: array<vec2u>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = workgroup_index(group, groups) * 256u + local;
    if (slot >= parameters.slots) {
        return;
    }
    var owner = 0u;
    if (parameters.single == 0u) {
        owner = owners[slot];
    }
    if (owner == NONE) {
        places[slot] = vec2u(NONE, 0u);
        return;
    }
    let theta = section[3u * slot + 1u];
    let z = section[3u * slot + 2u];
    let level = min(u32((z + parameters.half_height) * parameters.faces_per_mm), parameters.levels - 1u);
    let node = min(u32(theta * parameters.faces_per_rad), parameters.nodes - 1u);
    let face = owner * parameters.faces + level * parameters.nodes + node;
    places[slot] = vec2u(face, atomicAdd(&counts[face], 1u));
}
