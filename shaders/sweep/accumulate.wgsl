// The echoes' least-squares equations. Sums are fixed-point integers in two words: exact, so the same in any order.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> echoes: array<Echo>;
@group(0) @binding(2) var<storage, read> wall: array<f32>;
@group(0) @binding(3) var<storage, read> shifts: array<vec2f>;
// Per node: coupling to itself, to the next along the ring, to the one above, to the one above that next, and the
// right-hand side.
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
    if (index >= job.echoes) {
        return;
    }
    let way = way_to_wall(echoes[index], shifts[index]);
    let miss = abs(way.miss);
    if (job.gated != 0u && miss > max(job.gate, job.gate_radii * (job.start + way.wall))) {
        return;
    }
    let robust = select(1.0, job.huber / miss, miss > job.huber);
    let weight = robust * (way.normal_x * way.normal_x / way.variance);
    // In units of the noise.
    let value = weight * (way.across / way.normal_x) * job.per_noise;
    let p = way.weights.x;
    let q = way.weights.y;
    let r = way.weights.z;
    // a couples to b along the ring or to a' across; b to b' across, a' to b' along; a to b' always.
    let from_a = select(2u, 1u, way.bottom);
    let to_c = select(1u, 2u, way.bottom);
    add(way.corners.x, 0u, weight * p * p, job.weight_scale);
    add(way.corners.y, 0u, weight * q * q, job.weight_scale);
    add(way.corners.z, 0u, weight * r * r, job.weight_scale);
    add(way.corners.x, from_a, weight * p * q, job.weight_scale);
    add(way.corners.y, to_c, weight * q * r, job.weight_scale);
    add(way.corners.x, 3u, weight * p * r, job.weight_scale);
    add(way.corners.x, 4u, p * value, job.way_scale);
    add(way.corners.y, 4u, q * value, job.way_scale);
    add(way.corners.z, 4u, r * value, job.way_scale);
}
