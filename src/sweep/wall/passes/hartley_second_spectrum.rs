//! The second stage of the transform into a spectrum (`shaders/sweep/hartley_second_spectrum.wgsl`).

use super::WallParameters;
use super::hartley_second::second_stage;

/// The second stage: the spectrum of every ring.
pub fn hartley_second_spectrum(
    parameters: &WallParameters,
    twiddles: &[[f32; 2]],
    intermediate: &[[f32; 2]],
) -> Vec<f32> {
    let nodes = parameters.nodes as usize;
    let mut spectrum = vec![0.0; intermediate.len()];
    for (ring, spectrum) in spectrum.chunks_mut(nodes).enumerate() {
        for frequency in 0..=nodes / 2 {
            let [a, b] = second_stage(parameters, twiddles, intermediate, ring, frequency);
            spectrum[frequency] = a;
            if frequency > 0 && 2 * frequency != nodes {
                spectrum[nodes - frequency] = b;
            }
        }
    }
    spectrum
}
