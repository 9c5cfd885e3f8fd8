// The second half of a transform. Twin: sweep/passes/transform.rs.

// The coefficients of one frequency: those with index `frequency` and `nodes - frequency`.
fn joined(ring: u32, frequency: u32) -> vec2f {
    var sum = vec2f(0.0);
    var phase = 0u;
    var place = ring * job.nodes + frequency % job.short;
    for (var i = 0u; i < job.long; i++) {
        let x = parts[place];
        let wave = waves[phase];
        sum = vec2f(sum.x + x.x * wave.x, sum.y + x.x * wave.y);
        sum = vec2f(sum.x - x.y * wave.y, sum.y + x.y * wave.x);
        place += job.short;
        phase += frequency;
        if (phase >= job.nodes) {
            phase -= job.nodes;
        }
    }
    return vec2f(sum.x + sum.y, sum.x - sum.y);
}
