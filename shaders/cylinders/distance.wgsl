// The key of each point's distance, where faces have so many points that one workgroup would take too long
// over a face: here all workgroups share the points of all faces, whatever face they belong to.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<vec4u>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// One key per point.
@group(0) @binding(5) var<storage, read_write> keys: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = workgroup_index(group, groups) * 256u + local;
    // Fewer than the slots where points did not pass the gate.
    let all_faces = parameters.cylinders * parameters.faces;
    if (i >= offsets[all_faces]) {
        return;
    }
    let point = grouped[i];
    let cylinder = point.w / parameters.faces;
    keys[i] = key_of_point(point, corners_of(point.w, cylinder), cylinders[cylinder].scale);
}
