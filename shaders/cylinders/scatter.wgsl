// Points in the order of their faces, measured from the face's corner a. Workgroups that run at the same time
// write to the same window of places, which a device's cache holds: written at random to all places, each
// point would cost a line of memory.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
// r of all slots, then θ, then z.
@group(0) @binding(1) var<storage, read> section: array<f32>;
@group(0) @binding(2) var<storage, read> places: array<vec2u>;
@group(0) @binding(3) var<storage, read> offsets: array<u32>;
// r, θ - θⱼ, z - zₗ of each point: the three together, since they are written together.
@group(0) @binding(4) var<storage, read_write> grouped: array<f32>;

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
    let place = places[slot];
    if (place.x == NONE) {
        return;
    }
    let to = offsets[place.x] + place.y;
    // Window after window, in each of them all slots.
    if (to - group.z * parameters.window >= parameters.window) {
        return;
    }
    let face = place.x % parameters.faces;
    let level = face / parameters.nodes;
    grouped[3u * to] = section[slot];
    let theta = section[parameters.slots + slot];
    grouped[3u * to + 1u] = theta - f32(face - level * parameters.nodes) * parameters.step_theta;
    let height = section[2u * parameters.slots + slot] + parameters.half_height;
    grouped[3u * to + 2u] = height - f32(level) * parameters.step_z;
}
