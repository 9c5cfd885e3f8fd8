//! Robust statistics: medians, and the weight functions of M-estimators.

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

/// The standard deviation of normal noise about 0, from its absolute values. Reorders them.
pub(crate) fn robust_sd(sizes: &mut [f64]) -> f64 {
    SD_PER_MAD * median(sizes)
}

/// Huber's weight of a residual of absolute value `size`, for noise of standard deviation `sd`.
pub(crate) fn huber_weight(sd: f64, size: f64) -> f64 {
    (HUBER * sd / size.max(f64::MIN_POSITIVE)).min(1.0)
}

/// Tukey's biweight of a residual in units of its cut-off, `|u| < 1`; residuals beyond have no weight.
pub(crate) fn tukey_weight(u: f64) -> f64 {
    (1.0 - u * u).powi(2)
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
    fn weights_fall_with_the_residual() {
        assert_eq!([huber_weight(1.0, 0.0), huber_weight(1.0, 1.3)], [1.0; 2]);
        assert_eq!(huber_weight(2.0, 2.0 * 2.0 * HUBER), 0.5);
        assert_eq!([tukey_weight(0.0), tukey_weight(1.0)], [1.0, 0.0]);
    }
}
