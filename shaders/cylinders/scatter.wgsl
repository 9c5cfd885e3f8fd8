// Points in the order of their faces, measured from the face's corner a.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> section: array<f32>;
@group(0) @binding(2) var<storage, read> places: array<vec2u>;
@group(0) @binding(3) var<storage, read> offsets: array<u32>;
// r, θ - θⱼ, z - zₗ.
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
    let face = place.x % parameters.faces;
    let to = offsets[place.x] + place.y;
    grouped[3u * to] = section[3u * slot];
    grouped[3u * to + 1u] = section[3u * slot + 1u] - f32(face % parameters.nodes) * parameters.step_theta;
    let height = section[3u * slot + 2u] + parameters.half_height;
    grouped[3u * to + 2u] = height - f32(face / parameters.nodes) * parameters.step_z;
}
