//! Robust statistics: medians, and the weight functions of M-estimators.

use rayon::prelude::*;

/// The standard deviation of a normal distribution in units of its median absolute deviation.
pub(crate) const SD_PER_MAD: f64 = 1.4826;

/// Huber's constant, in standard deviations: 95 % as efficient as least squares for normal noise.
pub(crate) const HUBER: f64 = 1.345;

/// The upper median; 0 of nothing. Reorders the values.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// As [`median`], of |values|, on all threads.
pub(crate) fn median_size(values: &[f64]) -> f64 {
    // The sign apart, bits sort like numbers: their top 14 are counted, and those that share the median's are selected from.
    const SHIFT: u32 = 50;
    const TASK: usize = 1 << 14;
    let top = |value: &f64| (value.abs().to_bits() >> SHIFT) as usize;
    let count = |mut counts: Vec<u32>, task: &[f64]| {
        task.iter().for_each(|value| counts[top(value)] += 1);
        counts
    };
    let none = || vec![0_u32; 1 << (63 - SHIFT)];
    let add = |mut a: Vec<u32>, b: Vec<u32>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    };
    let counts = values.par_chunks(TASK).fold(none, count).reduce(none, add);
    let (mut rank, mut prefix) = (values.len() / 2, 0);
    for (bits, count) in counts.into_iter().enumerate() {
        prefix = bits;
        if rank < count as usize {
            break;
        }
        rank -= count as usize;
    }
    let same = values.par_iter().filter(|value| top(value) == prefix);
    let mut near: Vec<f64> = same.map(|value| value.abs()).collect();
    if near.is_empty() { 0.0 } else { *near.select_nth_unstable_by(rank, f64::total_cmp).1 }
}

/// The standard deviation of normal noise about 0, from its absolute values. Reorders them.
pub(crate) fn robust_sd(sizes: &mut [f64]) -> f64 {
    SD_PER_MAD * median(sizes)
}

/// Huber's weight of a residual of absolute value `size`, for noise of standard deviation `sd`.
pub(crate) fn huber_weight(sd: f64, size: f64) -> f64 {
    (HUBER * sd / size.max(f64::MIN_POSITIVE)).min(1.0)
}

/// Tukey's biweight of a residual in units of its cut-off; residuals beyond it have no weight.
pub(crate) fn tukey_weight(u: f64) -> f64 {
    (1.0 - u * u).max(0.0).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_the_upper_one() {
        assert_eq!(median(&mut []), 0.0);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 3.0);
    }

    #[test]
    fn the_median_size_is_the_median_of_the_sizes() {
        for count in [0, 1, 2, 3, 1000, 70_001, 200_000] {
            let value = |i: usize| ((i * i % 977) as f64 - 400.0) * 0.013_f64.powi((i % 5) as i32);
            let values: Vec<f64> = (0..count).map(value).collect();
            let found = median_size(&values);
            assert_eq!(found, median(&mut values.iter().map(|x| x.abs()).collect::<Vec<_>>()), "{count}");
        }
        assert!(median_size(&[f64::NAN, -f64::NAN, 1.0]).is_nan());
    }

    #[test]
    fn weights_fall_with_the_residual() {
        assert_eq!([huber_weight(1.0, 0.0), huber_weight(1.0, 1.3)], [1.0; 2]);
        assert_eq!(huber_weight(2.0, 2.0 * 2.0 * HUBER), 0.5);
        assert_eq!([0.0, 1.0, -2.0, 30.0].map(tukey_weight), [1.0, 0.0, 0.0, 0.0]);
    }
}
