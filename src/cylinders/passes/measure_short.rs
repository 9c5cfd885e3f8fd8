//! The statistic of a triangle with few distances: order statistics by insertion sort.

use super::filter::{bounds, first_quartile, summary, third_quartile};
use super::{Filter, TriangleStatistic};
use crate::numerics::Scalar;
use crate::settings::Statistic;

/// The statistic of a triangle's signed distances. `keys` is room to work in. The result does not depend on the order
/// of the distances, because the sums are exact.
#[inline(always)]
pub fn measure_short<T: Scalar>(
    distances: &[T],
    filter: &Filter<T>,
    keys: &mut Vec<T::Key>,
) -> TriangleStatistic<T> {
    match distances {
        [] => return TriangleStatistic::default(),
        [d] => return one(*d, filter),
        _ => {}
    }
    let bounds = bounds(distances, filter, || quartiles(distances, keys));
    summary(distances, bounds, filter, keys, |keys, rank| {
        sort(keys);
        keys[rank]
    })
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
    keys.clear();
    keys.extend(distances.iter().map(|d| d.key()));
    sort(keys);
    (T::from_key(keys[first_quartile(n) - 1]), T::from_key(keys[third_quartile(n) - 1]))
}

/// Insertion sort.
#[inline(always)]
fn sort<K: Copy + Ord>(keys: &mut [K]) {
    for i in 1..keys.len() {
        let key = keys[i];
        let mut hole = i;
        while hole > 0 && keys[hole - 1] > key {
            keys[hole] = keys[hole - 1];
            hole -= 1;
        }
        keys[hole] = key;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cylinders::passes::measure_long;
    use crate::settings::Outliers;

    fn with(outliers: Outliers, statistic: Statistic) -> Filter<f64> {
        Filter { outliers, statistic, scale: 2.0_f64.powi(60), unit: 2.0_f64.powi(-60) }
    }

    /// The statistic by insertion sort, which that by selection equals.
    fn of(values: &[f64], outliers: Outliers, statistic: Statistic) -> TriangleStatistic<f64> {
        let filter = with(outliers, statistic);
        let short = measure_short(values, &filter, &mut Vec::new());
        assert_eq!(short, measure_long(values, &filter, &mut Vec::new()));
        short
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
}
