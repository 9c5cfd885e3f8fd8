//! The second stage of the transform back to values (`shaders/sweep/hartley_second_values.wgsl`).

use super::sum::partial_sums;
use super::{WallParameters, hartley_second_spectrum};

/// The second stage of the transform back: the values, and the partial sums of their products with the
/// residual.
pub fn hartley_second_values(
    parameters: &WallParameters,
    twiddles: &[[f32; 2]],
    intermediate: &[[f32; 2]],
    residual: &[f32],
) -> (Vec<f32>, Vec<f32>) {
    let nodes = parameters.nodes as usize;
    let mut values = hartley_second_spectrum(parameters, twiddles, intermediate);
    values.iter_mut().for_each(|value| *value *= parameters.per_node);
    let products = (0..parameters.rings as usize * (nodes / 2 + 1)).map(|index| {
        let (ring, j) = (index / (nodes / 2 + 1), index % (nodes / 2 + 1));
        let (node, other) = (ring * nodes + j, (ring + 1) * nodes - j);
        let mut own = residual[node] * values[node];
        if j > 0 && 2 * j != nodes {
            own += residual[other] * values[other];
        }
        own
    });
    let partials = partial_sums(products);
    (values, partials)
}
