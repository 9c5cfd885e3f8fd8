//! Ranks of order statistics, bounds of the distances that count, and the statistic of those within them
//! (docs/method.md, "Local cylinder fit").

use super::{Filter, TriangleStatistic};
use crate::numerics::Scalar;
use crate::settings::{Outliers, Statistic};

/// 1-based rank of the first quartile of n ≥ 2 values: (n + 1)/4, rounded half up.
#[inline(always)]
#[expect(clippy::manual_div_ceil, reason = "a rounded rank, and the shader's words")]
pub(super) fn first_quartile(n: usize) -> usize {
    (n + 3) / 4
}

/// 1-based rank of the third quartile of n ≥ 2 values: 3(n + 1)/4, rounded half up.
#[inline(always)]
pub(super) fn third_quartile(n: usize) -> usize {
    (3 * n + 5) / 4
}

/// 1-based rank of the median of n ≥ 1 values: (n + 1)/2, rounded half up.
#[inline(always)]
pub(super) fn median(n: usize) -> usize {
    (n + 2) / 2
}

/// The interval of distances that count, both ends included.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds<T> {
    low: T,
    high: T,
}

impl<T: Scalar> Bounds<T> {
    #[inline(always)]
    fn contains(&self, d: T) -> bool {
        (self.low <= d) & (d <= self.high)
    }
}

/// Tukey's fences: 1.5 times the interquartile range beyond the quartiles.
#[inline(always)]
fn box_plot<T: Scalar>((q1, q3): (T, T)) -> Bounds<T> {
    let reach = T::from_f64(1.5) * (q3 - q1);
    Bounds { low: q1 - reach, high: q3 + reach }
}

/// 30 % of the mean on either side of it.
#[inline(always)]
fn deviation<T: Scalar>(mean: T) -> Bounds<T> {
    let reach = T::from_f64(0.3) * mean.abs();
    Bounds { low: mean - reach, high: mean + reach }
}

/// The bounds of two or more distances, `None` where all count; `quartiles` is called where they are needed.
#[inline(always)]
pub(super) fn bounds<T: Scalar>(
    distances: &[T],
    filter: &Filter<T>,
    quartiles: impl FnOnce() -> (T, T),
) -> Option<Bounds<T>> {
    match filter.outliers {
        Outliers::None => None,
        Outliers::Deviation => {
            let sum = distances.iter().fold(T::Sum::default(), |s, d| s + d.to_fixed(filter.scale));
            Some(deviation(T::mean_of(sum, filter.unit, distances.len() as u32)))
        }
        Outliers::Iqr => Some(box_plot(quartiles())),
    }
}

/// The statistic of the distances within `bounds`; `select` gives the key at a 0-based rank of some keys.
#[inline(always)]
pub(super) fn summary<T: Scalar>(
    distances: &[T],
    bounds: Option<Bounds<T>>,
    filter: &Filter<T>,
    keys: &mut Vec<T::Key>,
    select: impl FnOnce(&mut [T::Key], usize) -> T::Key,
) -> TriangleStatistic<T> {
    let (mut kept, mut sum, mut sum_abs) = (0_u32, T::Sum::default(), T::Sum::default());
    match bounds {
        Some(bounds) => {
            for &d in distances {
                let keep = bounds.contains(d);
                let counted = if keep { d } else { T::default() };
                kept += u32::from(keep);
                sum = sum + counted.to_fixed(filter.scale);
                sum_abs = sum_abs + counted.abs().to_fixed(filter.scale);
            }
        }
        None => {
            for &d in distances {
                sum = sum + d.to_fixed(filter.scale);
                sum_abs = sum_abs + d.abs().to_fixed(filter.scale);
            }
            kept = distances.len() as u32;
        }
    }
    if kept == 0 {
        return TriangleStatistic::default();
    }
    let value = match filter.statistic {
        Statistic::Mean => T::mean_of(sum, filter.unit, kept),
        Statistic::Median => {
            let within = |d: &&T| bounds.is_none_or(|bounds| bounds.contains(**d));
            keys.clear();
            keys.extend(distances.iter().filter(within).map(|d| d.key()));
            T::from_key(select(keys, median(kept as usize) - 1))
        }
    };
    TriangleStatistic { value, kept, residual: T::mean_of(sum_abs, filter.unit, kept) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_rounded_half_up() {
        let round_half_up = |x: f64| (x + 0.5).floor() as usize;
        for n in 2..200 {
            let f = n as f64 + 1.0;
            assert_eq!(first_quartile(n), round_half_up(f / 4.0));
            assert_eq!(third_quartile(n), round_half_up(3.0 * f / 4.0).min(n));
            assert_eq!(median(n), round_half_up(f / 2.0));
            assert!(third_quartile(n) <= n && (n == 2 || third_quartile(n) > first_quartile(n)));
        }
    }
}
