// The second stage of a Hartley transform.

// The two coefficients of a frequency, with indices `frequency` and `nodes - frequency`.
fn second_stage(ring: u32, frequency: u32) -> vec2f {
    var sum = vec2f(0.0);
    var phase = 0u;
    var place = ring * parameters.nodes + frequency % parameters.short_factor;
    for (var i = 0u; i < parameters.long_factor; i++) {
        let x = intermediate[place];
        let twiddle = twiddles[phase];
        sum = vec2f(sum.x + x.x * twiddle.x, sum.y + x.x * twiddle.y);
        sum = vec2f(sum.x - x.y * twiddle.y, sum.y + x.y * twiddle.x);
        place += parameters.short_factor;
        phase += frequency;
        if (phase >= parameters.nodes) {
            phase -= parameters.nodes;
        }
    }
    return vec2f(sum.x + sum.y, sum.x - sum.y);
}
