//! The next digit of the median of |residual| (`shaders/sweep/pick_digit.wgsl`).

use super::State;
use crate::numerics::inclusive_scan;

/// Finds the next digit of the median, and clears the counts.
pub fn pick_digit(counts: &mut [u32; 256], state: &mut State) {
    let own = std::mem::replace(counts, [0; 256]);
    let mut sums = own;
    inclusive_scan(&mut sums);
    for (digit, (own, sum)) in (0..).zip(own.into_iter().zip(sums)) {
        let before = sum - own;
        if before <= state.rank && state.rank < sum {
            state.prefix |= digit << (24 - 8 * state.digits);
            state.rank -= before;
            state.digits += 1;
            return;
        }
    }
}
