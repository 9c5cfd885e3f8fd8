// Probe points to tube coordinates, and the gate. One workgroup per pair of cylinder and frame.

struct Pair {
    x_x: f32,
    x_y: f32,
    x_z: f32,
    y_x: f32,
    y_y: f32,
    y_z: f32,
    origin_x: f32,
    origin_y: f32,
    origin_z: f32,
    cylinder: u32,
    first_point: u32,
    count: u32,
    first_slot: u32,
    unused_0: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> points: array<vec2f>;
@group(0) @binding(3) var<storage, read> pairs: array<Pair>;
// r (mm) of all slots, then θ (rad), then z (mm).
@group(0) @binding(4) var<storage, read_write> section: array<f32>;
// The cylinder of each slot, NONE where the point did not pass.
@group(0) @binding(5) var<storage, read_write> owners: array<u32>;
// Per cylinder: points within the height but outside the radial gate.
@group(0) @binding(6) var<storage, read_write> gated: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups);
    if (index >= parameters.pairs) {
        return;
    }
    let pair = pairs[index];
    let cylinder = cylinders[pair.cylinder];
    var outside = 0u;
    for (var i = local; i < pair.count; i += 64u) {
        let p = points[pair.first_point + i];
        let x = (pair.origin_x + pair.x_x * p.x) + pair.y_x * p.y;
        let y = (pair.origin_y + pair.x_y * p.x) + pair.y_y * p.y;
        let z = (pair.origin_z + pair.x_z * p.x) + pair.y_z * p.y;
        let r = sqrt(x * x + y * y);
        let within = -parameters.half_height <= z && z <= parameters.half_height;
        let passes = within && cylinder.gate_low <= r && r <= cylinder.gate_high;
        outside += select(0u, 1u, within && !passes);
        let slot = pair.first_slot + i;
        owners[slot] = select(NONE, pair.cylinder, passes);
        section[slot] = r;
        section[parameters.slots + slot] = angle(y, x);
        section[2u * parameters.slots + slot] = z;
    }
    if (outside > 0u) {
        atomicAdd(&gated[pair.cylinder], outside);
    }
}
