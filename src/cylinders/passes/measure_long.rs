//! The statistic of a triangle with many distances: order statistics by selection.

use super::filter::{bounds, first_quartile, summary, third_quartile};
use super::{Filter, TriangleStatistic};
use crate::numerics::Scalar;

/// The statistic of a triangle's signed distances, equal to that of
/// [`measure_short`](fn@super::measure_short). `keys` is room to work in. The result does not depend on the order of
/// the distances, because the sums are exact.
#[inline(always)]
pub fn measure_long<T: Scalar>(
    distances: &[T],
    filter: &Filter<T>,
    keys: &mut Vec<T::Key>,
) -> TriangleStatistic<T> {
    let bounds = match distances.len() {
        0 | 1 => None,
        _ => bounds(distances, filter, || quartiles(distances, keys)),
    };
    summary(distances, bounds, filter, keys, |keys, rank| *keys.select_nth_unstable(rank).1)
}

#[inline(always)]
fn quartiles<T: Scalar>(distances: &[T], keys: &mut Vec<T::Key>) -> (T, T) {
    let n = distances.len();
    let (r1, r3) = (first_quartile(n) - 1, third_quartile(n) - 1);
    keys.clear();
    keys.extend(distances.iter().map(|d| d.key()));
    let (_, &mut q1, above) = keys.select_nth_unstable(r1);
    // r3 > r1 for every n ≥ 2.
    let (_, &mut q3, _) = above.select_nth_unstable(r3 - r1 - 1);
    (T::from_key(q1), T::from_key(q3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cylinders::passes::measure_short;
    use crate::settings::{Outliers, Statistic};

    #[test]
    fn selection_agrees_with_sorting_whatever_the_order_and_number() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        for n in [2, 3, 5, 23, 24, 25, 63, 64, 65, 127, 128, 129, 1000, 5000] {
            let mut values: Vec<f32> = (0..n).map(|_| rng.random_range(-3.0..3.0_f32)).collect();
            values[0] = 40.0;
            let mut sorted = values.clone();
            sorted.sort_by(f32::total_cmp);
            let (q1, q3) = (sorted[first_quartile(n) - 1], sorted[third_quartile(n) - 1]);
            assert_eq!(quartiles(&values, &mut Vec::new()), (q1, q3));
            for outliers in [Outliers::Iqr, Outliers::Deviation, Outliers::None] {
                for statistic in [Statistic::Mean, Statistic::Median] {
                    let scale = f32::fixed_point_scale(64.0);
                    let filter = Filter { outliers, statistic, scale, unit: 1.0 / scale };
                    let forth = measure_long(&values, &filter, &mut Vec::new());
                    let back: Vec<f32> = values.iter().rev().copied().collect();
                    assert_eq!(forth, measure_long(&back, &filter, &mut Vec::new()));
                    assert_eq!(forth, measure_long(&sorted, &filter, &mut Vec::new()));
                    assert_eq!(forth, measure_short(&values, &filter, &mut Vec::new()));
                }
            }
        }
    }
}
