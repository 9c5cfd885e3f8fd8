//! The second stage of a Hartley transform (`shaders/sweep/common/hartley_second.wgsl`).

use super::WallParameters;

/// The two coefficients of a frequency, with indices `frequency` and `nodes - frequency`.
pub(super) fn second_stage(
    parameters: &WallParameters,
    twiddles: &[[f32; 2]],
    intermediate: &[[f32; 2]],
    ring: usize,
    frequency: usize,
) -> [f32; 2] {
    let (nodes, short) = (parameters.nodes as usize, parameters.short_factor as usize);
    let (mut sum, mut phase) = ([0.0, 0.0], 0);
    let mut place = ring * nodes + frequency % short;
    for _ in 0..parameters.long_factor {
        let (x, twiddle) = (intermediate[place], twiddles[phase]);
        sum = [sum[0] + x[0] * twiddle[0], sum[1] + x[0] * twiddle[1]];
        sum = [sum[0] - x[1] * twiddle[1], sum[1] + x[1] * twiddle[0]];
        place += short;
        phase += frequency;
        if phase >= nodes {
            phase -= nodes;
        }
    }
    [sum[0] + sum[1], sum[0] - sum[1]]
}
