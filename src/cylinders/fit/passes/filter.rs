//! Which of a triangle's distances count, and what stands for them (method, sections 4.2 and 4.3).

use crate::numerics::Scalar;
use crate::settings::{Outliers, Settings, Statistic};

/// What the filter does, with the constants of the fixed-point sums.
#[derive(Debug, Clone, Copy)]
pub struct Filter<T> {
    /// Which distances count.
    pub outliers: Outliers,
    /// What stands for them.
    pub statistic: Statistic,
    /// Steps per mm of the fixed-point sums.
    pub scale: T,
    /// 1/scale, mm.
    pub unit: T,
}

impl<T: Scalar> Filter<T> {
    /// The filter of a cylinder of that radius.
    ///
    /// No distance exceeds the larger of a gated point's and a node's radius, since the nearer triangle is at
    /// most as far as the surface is along r; twice the gate leaves room.
    pub fn new(settings: &Settings, radius_mm: f64) -> Self {
        let scale = T::fixed_point_scale(2.0 * settings.gate[1].max(1.0) * radius_mm);
        Self {
            outliers: settings.outliers,
            statistic: settings.statistic,
            scale,
            unit: T::from_f64(1.0 / scale.to_f64()),
        }
    }
}

/// What a triangle's points say. In f32 it is laid out as the shaders' structure of that name.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[repr(C)]
pub struct TriangleStatistic<T> {
    /// Mean or median of the kept signed distances, mm; 0 where there are none.
    pub value: T,
    /// Number of kept distances.
    pub kept: u32,
    /// Mean of the kept |distances|, mm; 0 where there are none.
    pub residual: T,
}

/// 1-based rank of the first quartile of n ≥ 2 values: (n + 1)/4, rounded half up.
#[inline(always)]
#[expect(clippy::manual_div_ceil, reason = "a rounded rank, and the shader's words")]
fn first_quartile(n: usize) -> usize {
    (n + 3) / 4
}

/// 1-based rank of the third quartile of n ≥ 2 values: 3(n + 1)/4, rounded half up.
#[inline(always)]
fn third_quartile(n: usize) -> usize {
    (3 * n + 5) / 4
}

/// 1-based rank of the median of n ≥ 1 values: (n + 1)/2, rounded half up.
#[inline(always)]
fn median(n: usize) -> usize {
    (n + 2) / 2
}

/// Up to this many values are sorted by insertion; above, order statistics are selected.
const FEW: usize = 24;

/// The statistic of a triangle's signed distances. `keys` is room to work in; the result does not depend on
/// the order of the distances, because order statistics do not and the sums are exact.
#[inline(always)]
pub fn filter<T: Scalar>(
    distances: &[T],
    filter: &Filter<T>,
    keys: &mut Vec<T::Key>,
) -> TriangleStatistic<T> {
    let n = distances.len();
    match n {
        0 => return TriangleStatistic::default(),
        1 => return one(distances[0], filter),
        _ => {}
    }
    let (low, high) = match filter.outliers {
        Outliers::None => return summary(distances, None, filter, keys),
        Outliers::Deviation => {
            let sum = distances.iter().fold(T::Sum::default(), |s, d| s + d.to_fixed(filter.scale));
            let mean = T::mean_of(sum, filter.unit, n as u32);
            let reach = T::from_f64(0.3) * mean.abs();
            (mean - reach, mean + reach)
        }
        Outliers::Iqr => {
            let (q1, q3) = quartiles(distances, keys);
            let reach = T::from_f64(1.5) * (q3 - q1);
            (q1 - reach, q3 + reach)
        }
    };
    summary(distances, Some((low, high)), filter, keys)
}

#[inline(always)]
fn one<T: Scalar>(d: T, filter: &Filter<T>) -> TriangleStatistic<T> {
    let value = match filter.statistic {
        Statistic::Mean => T::mean_of(d.to_fixed(filter.scale), filter.unit, 1),
        Statistic::Median => d,
    };
    let residual = T::mean_of(d.abs().to_fixed(filter.scale), filter.unit, 1);
    TriangleStatistic { value, kept: 1, residual }
}

#[inline(always)]
fn quartiles<T: Scalar>(distances: &[T], keys: &mut Vec<T::Key>) -> (T, T) {
    let n = distances.len();
    let (r1, r3) = (first_quartile(n) - 1, third_quartile(n) - 1);
    keys.clear();
    keys.extend(distances.iter().map(|d| d.key()));
    if n <= FEW {
        for i in 1..n {
            let key = keys[i];
            let mut hole = i;
            while hole > 0 && keys[hole - 1] > key {
                keys[hole] = keys[hole - 1];
                hole -= 1;
            }
            keys[hole] = key;
        }
        return (T::from_key(keys[r1]), T::from_key(keys[r3]));
    }
    let (_, &mut q1, above) = keys.select_nth_unstable(r1);
    // r3 > r1 for every n > 2.
    let (_, &mut q3, _) = above.select_nth_unstable(r3 - r1 - 1);
    (T::from_key(q1), T::from_key(q3))
}

#[inline(always)]
fn summary<T: Scalar>(
    distances: &[T],
    bounds: Option<(T, T)>,
    filter: &Filter<T>,
    keys: &mut Vec<T::Key>,
) -> TriangleStatistic<T> {
    let (mut kept, mut sum, mut sum_abs) = (0_u32, T::Sum::default(), T::Sum::default());
    match bounds {
        Some((low, high)) => {
            for &d in distances {
                let keep = (low <= d) & (d <= high);
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
            let within = |d: &&T| bounds.is_none_or(|(low, high)| low <= **d && **d <= high);
            keys.clear();
            keys.extend(distances.iter().filter(within).map(|d| d.key()));
            T::from_key(*keys.select_nth_unstable(median(kept as usize) - 1).1)
        }
    };
    TriangleStatistic { value, kept, residual: T::mean_of(sum_abs, filter.unit, kept) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(outliers: Outliers, statistic: Statistic) -> Filter<f64> {
        Filter { outliers, statistic, scale: 2.0_f64.powi(60), unit: 2.0_f64.powi(-60) }
    }

    fn of(values: &[f64], outliers: Outliers, statistic: Statistic) -> TriangleStatistic<f64> {
        filter(values, &with(outliers, statistic), &mut Vec::new())
    }

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

    #[test]
    fn the_box_plot_keeps_its_bounds_and_drops_what_lies_beyond() {
        // Quartiles 1 and 3 (ranks 2 and 5 of 6... of 0, 1, 2, 3, 3, x): fences -2 and 6.
        let s = of(&[0.0, 1.0, 2.0, 3.0, 3.0, 6.0], Outliers::Iqr, Statistic::Mean);
        assert_eq!((s.kept, s.value), (6, 2.5));
        let s = of(&[0.0, 1.0, 2.0, 3.0, 3.0, 6.001], Outliers::Iqr, Statistic::Mean);
        assert_eq!((s.kept, s.value), (5, 1.8));
    }

    #[test]
    fn equal_distances_are_all_kept() {
        let s = of(&[0.7; 9], Outliers::Iqr, Statistic::Mean);
        assert_eq!(s.kept, 9);
        assert!((s.value - 0.7).abs() < 1e-16);
    }

    #[test]
    fn one_or_no_distance() {
        assert_eq!(of(&[], Outliers::Iqr, Statistic::Mean), TriangleStatistic::default());
        let s = of(&[-2.0], Outliers::Iqr, Statistic::Median);
        assert_eq!((s.value, s.kept, s.residual), (-2.0, 1, 2.0));
    }

    #[test]
    fn deviation_drops_what_differs_from_the_mean_by_more_than_30_percent() {
        let s = of(&[1.0, 1.0, 1.0, 1.0, 2.0], Outliers::Deviation, Statistic::Mean);
        assert_eq!((s.kept, s.value), (4, 1.0));
        // Around a negative mean the reach is still positive.
        let s = of(&[-1.0, -1.0, -1.0, -1.0, -2.0], Outliers::Deviation, Statistic::Mean);
        assert_eq!((s.kept, s.value), (4, -1.0));
    }

    #[test]
    fn the_median_is_that_of_the_kept() {
        let s = of(&[5.0, 1.0, 2.0, 3.0, 4.0, 100.0], Outliers::Iqr, Statistic::Median);
        assert_eq!((s.kept, s.value), (5, 3.0));
        let s = of(&[1.0, 2.0, 3.0, 4.0], Outliers::None, Statistic::Median);
        assert_eq!(s.value, 3.0);
    }

    #[test]
    fn selection_agrees_with_sorting_whatever_the_order_and_number() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        for n in [2, 3, 5, FEW - 1, FEW, FEW + 1, 63, 64, 65, 127, 128, 129, 1000, 5000] {
            let mut values: Vec<f32> = (0..n).map(|_| rng.random_range(-3.0..3.0_f32)).collect();
            values[0] = 40.0;
            let mut sorted = values.clone();
            sorted.sort_by(f32::total_cmp);
            let (q1, q3) = (sorted[first_quartile(n) - 1], sorted[third_quartile(n) - 1]);
            assert_eq!(quartiles(&values, &mut Vec::new()), (q1, q3));
            for outliers in [Outliers::Iqr, Outliers::Deviation, Outliers::None] {
                for statistic in [Statistic::Mean, Statistic::Median] {
                    let scale = f32::fixed_point_scale(64.0);
                    let filter_of = Filter { outliers, statistic, scale, unit: 1.0 / scale };
                    let forth = filter(&values, &filter_of, &mut Vec::new());
                    let back: Vec<f32> = values.iter().rev().copied().collect();
                    assert_eq!(forth, filter(&back, &filter_of, &mut Vec::new()));
                    assert_eq!(forth, filter(&sorted, &filter_of, &mut Vec::new()));
                }
            }
        }
    }
}
