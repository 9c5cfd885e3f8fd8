// Hartley transforms: sums over a ring's nodes of cos + sin times their values. The transform is its own inverse but for
// a factor. N is parted into a short and a long factor: first transforms of every `long`-th node, then these joined.
// Twin: sweep/passes/transform.rs.

// Of the nodes `long` apart: at place r * short + p what belongs to first node r and frequency p, as cos and sin parts.
// Whoever calls it says what `value` is.
fn part(ring: u32, place: u32) -> vec2f {
    let first = place / job.short;
    let turn = job.long * (place % job.short);
    var sum = vec2f(0.0);
    var phase = 0u;
    for (var i = 0u; i < job.short; i++) {
        let x = value(ring * job.nodes + job.long * i + first);
        let wave = waves[phase];
        sum = vec2f(sum.x + x * wave.x, sum.y + x * wave.y);
        phase += turn;
        if (phase >= job.nodes) {
            phase -= job.nodes;
        }
    }
    return sum;
}
