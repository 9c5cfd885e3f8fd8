//! The median of |miss|, digit by digit (`shaders/sweep/count_misses.wgsl`, `pick_digit.wgsl`).

use super::State;

/// Adds up how many misses have each next digit, among those whose first digits are known.
pub fn count_misses(misses: &[f32], state: &State, counts: &mut [u32; 256]) {
    let shift = 24 - 8 * state.round;
    for miss in misses {
        let key = miss.to_bits() & 0x7fff_ffff;
        if (key >> shift) >> 8 == (state.prefix >> shift) >> 8 {
            counts[((key >> shift) & 0xff) as usize] += 1;
        }
    }
}

/// Takes the next digit of the median, and leaves no counts.
pub fn pick_digit(counts: &mut [u32; 256], state: &mut State) {
    let mut before = 0;
    for (digit, count) in (0..).zip(std::mem::replace(counts, [0; 256])) {
        if before <= state.rest && state.rest < before + count {
            state.prefix |= digit << (24 - 8 * state.round);
            state.rest -= before;
            state.round += 1;
            return;
        }
        before += count;
    }
}
