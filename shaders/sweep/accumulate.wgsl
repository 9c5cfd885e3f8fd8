// Adds every echo to the normal equations. The sums are fixed-point integers in two words: exact, so
// independent of the order of the echoes.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> echoes: array<Echo>;
@group(0) @binding(2) var<storage, read> wall: array<f32>;
@group(0) @binding(3) var<storage, read> shifts: array<vec2f>;
// Per node: the coefficients of the node itself, of the next node of its ring, of the node above and of the
// next node above; and the right-hand side.
@group(0) @binding(4) var<storage, read_write> sums_low: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> sums_high: array<atomic<u32>>;

fn add(node: u32, part: u32, x: f32, scale: f32) {
    let step = widen(fixed(x, scale));
    let old = atomicAdd(&sums_low[5u * node + part], step.low);
    let high = step.high + select(0u, 1u, old + step.low < old);
    if (high != 0u) {
        atomicAdd(&sums_high[5u * node + part], high);
    }
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups) * 256u + local;
    if (index >= parameters.echoes) {
        return;
    }
    let to_wall = residual_to_wall(echoes[index], shifts[index]);
    let residual = abs(to_wall.residual);
    let gate = max(parameters.gate, parameters.gate_radii * (parameters.start + to_wall.wall));
    if (parameters.gated != 0u && residual > gate) {
        return;
    }
    let robust = select(1.0, parameters.huber / residual, residual > parameters.huber);
    let weight = robust * (to_wall.normal_x * to_wall.normal_x / to_wall.variance);
    // In units of the noise.
    let value = weight * (to_wall.normal_distance / to_wall.normal_x) * parameters.per_noise;
    let p = to_wall.weights.x;
    let q = to_wall.weights.y;
    let r = to_wall.weights.z;
    // The edge a-b lies along the ring, a-a' and b-b' across, a'-b' along the next ring, and the diagonal
    // a-b' in both triangles.
    let from_a = select(2u, 1u, to_wall.bottom);
    let to_c = select(1u, 2u, to_wall.bottom);
    add(to_wall.corners.x, 0u, weight * p * p, parameters.weight_scale);
    add(to_wall.corners.y, 0u, weight * q * q, parameters.weight_scale);
    add(to_wall.corners.z, 0u, weight * r * r, parameters.weight_scale);
    add(to_wall.corners.x, from_a, weight * p * q, parameters.weight_scale);
    add(to_wall.corners.y, to_c, weight * q * r, parameters.weight_scale);
    add(to_wall.corners.x, 3u, weight * p * r, parameters.weight_scale);
    add(to_wall.corners.x, 4u, p * value, parameters.rhs_scale);
    add(to_wall.corners.y, 4u, q * value, parameters.rhs_scale);
    add(to_wall.corners.z, 4u, r * value, parameters.rhs_scale);
}
