//! The total of partial sums (`shaders/sweep/common/partials.wgsl`).

use super::sum_of_workgroup;

/// The total of the partial sums, by one workgroup of 256.
pub fn sum_of_partials(partials: &[f32]) -> f32 {
    let mut own = [0.0; 256];
    for (i, partial) in partials.iter().enumerate() {
        own[i % 256] += partial;
    }
    sum_of_workgroup(&mut own)
}
