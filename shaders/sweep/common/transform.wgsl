// Hartley transforms of eight rings at 64 frequencies: sums over the nodes of cos + sin times their values. The
// transform is its own inverse but for a factor. Twin: sweep/passes/transform.rs. Whoever includes it says what `value`
// is.

var<workgroup> tile: array<vec4f, 128>;

struct Eight {
    low: vec4f,
    high: vec4f,
}

fn value_or_zero(ring: u32, node: u32) -> f32 {
    if (ring < job.rings && node < job.nodes) {
        return value(ring * job.nodes + node);
    }
    return 0.0;
}

fn transformed(first_ring: u32, frequency: u32, local: u32) -> Eight {
    var sums = Eight(vec4f(0.0), vec4f(0.0));
    var phase = 0u;
    // Beyond the last frequency nothing is wanted.
    let turn = select(0u, frequency, frequency < job.nodes);
    for (var first = 0u; first < job.nodes; first += 64u) {
        let node = first + local;
        tile[2u * local] = vec4f(
            value_or_zero(first_ring, node),
            value_or_zero(first_ring + 1u, node),
            value_or_zero(first_ring + 2u, node),
            value_or_zero(first_ring + 3u, node),
        );
        tile[2u * local + 1u] = vec4f(
            value_or_zero(first_ring + 4u, node),
            value_or_zero(first_ring + 5u, node),
            value_or_zero(first_ring + 6u, node),
            value_or_zero(first_ring + 7u, node),
        );
        workgroupBarrier();
        let count = min(64u, job.nodes - first);
        for (var i = 0u; i < count; i++) {
            let wave = waves[phase];
            sums.low += wave * tile[2u * i];
            sums.high += wave * tile[2u * i + 1u];
            phase += turn;
            if (phase >= job.nodes) {
                phase -= job.nodes;
            }
        }
        workgroupBarrier();
    }
    return sums;
}

fn component(eight: Eight, index: u32) -> f32 {
    if (index < 4u) {
        return eight.low[index];
    }
    return eight.high[index - 4u];
}
