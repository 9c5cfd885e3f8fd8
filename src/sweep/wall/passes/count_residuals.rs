//! The histogram of a digit of |residual| (`shaders/sweep/count_residuals.wgsl`).

use super::State;

/// Counts the next digit of every |residual| that shares the digits of the median known so far.
pub fn count_residuals(residuals: &[f32], state: &State, counts: &mut [u32; 256]) {
    let shift = 24 - 8 * state.digits;
    for residual in residuals {
        let key = residual.to_bits() & 0x7fff_ffff;
        if (key >> shift) >> 8 == (state.prefix >> shift) >> 8 {
            counts[((key >> shift) & 0xff) as usize] += 1;
        }
    }
}
