// The faces with more than `max_short` points, which measure_long takes, in no particular order.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
// Their number, then the faces.
@group(0) @binding(2) var<storage, read_write> long_faces: array<atomic<u32>>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let face = workgroup_index(group, groups) * 256u + local;
    if (face >= parameters.cylinders * parameters.faces) {
        return;
    }
    if (offsets[face + 1u] - offsets[face] > parameters.max_short) {
        let index = atomicAdd(&long_faces[0], 1u);
        atomicStore(&long_faces[index + 1u], face);
    }
}
