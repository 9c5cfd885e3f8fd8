// Points in the order of their faces, measured from the face's corner a. Workgroups that run at the same time
// write the points of the same window of faces, which a device's cache holds: written at random to all places,
// each point would cost a line of memory.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
// r of all slots, then θ, then z.
@group(0) @binding(1) var<storage, read> section: array<f32>;
@group(0) @binding(2) var<storage, read> owners: array<u32>;
// The faces of all slots, then their places.
@group(0) @binding(3) var<storage, read> places: array<u32>;
@group(0) @binding(4) var<storage, read> offsets: array<u32>;
// Each point's numbers together, since they are written at once.
@group(0) @binding(5) var<storage, read_write> grouped: array<vec4u>;

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
    let face_of_all = places[slot];
    // Window after window, in each of them all slots.
    if (face_of_all == NONE || face_of_all - group.z * parameters.window >= parameters.window) {
        return;
    }
    grouped[offsets[face_of_all] + places[parameters.slots + slot]] = grouped_point(slot, face_of_all);
}
