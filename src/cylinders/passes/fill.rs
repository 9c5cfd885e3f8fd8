//! Values of triangles without kept points (docs/method.md, "Local cylinder fit").

use super::TriangleStatistic;
use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;
use rayon::prelude::*;

/// Values per parallel task: fewer do not pay for a thread.
const TASK: usize = 32_768;

/// The value of every triangle, mm: its own statistic's, or the mean over its edge neighbours where no distance was
/// kept. Bottom triangles are filled first (an empty neighbour counts 0), then top ones (from filled bottom ones).
/// The values are in the order in which [`Tube`] numbers its triangles: bottom ones, then top ones.
pub fn fill<T: Scalar>(statistics: &[TriangleStatistic<T>], tube: &Tube, values: &mut Vec<T>) {
    let faces = tube.face_count();
    values.resize(2 * faces, T::default());
    for_tasks(values, |first, values| {
        let statistics = &statistics[first..first + values.len()];
        values.iter_mut().zip(statistics).for_each(|(value, s)| *value = s.value);
    });
    let (bottoms, tops) = values.split_at_mut(faces);
    for_tasks(bottoms, |first, bottoms| {
        for (face, value) in (first..).zip(bottoms).filter(|(face, _)| statistics[*face].kept == 0) {
            let ([first, second], third) = tube.bottom_neighbours(face);
            *value = mean(tops[first], tops[second], third.map(|t| tops[t]));
        }
    });
    for_tasks(tops, |first, tops| {
        for (face, value) in (first..).zip(tops).filter(|(face, _)| statistics[faces + *face].kept == 0) {
            let ([first, second], third) = tube.top_neighbours(face);
            *value = mean(bottoms[first], bottoms[second], third.map(|t| bottoms[t]));
        }
    });
}

/// Calls `work` with runs of values and the place of the first of each.
fn for_tasks<T: Send>(values: &mut [T], work: impl Fn(usize, &mut [T]) + Sync) {
    match values.len() <= TASK {
        true => work(0, values),
        false => values.par_chunks_mut(TASK).enumerate().for_each(|(task, run)| work(task * TASK, run)),
    }
}

#[inline(always)]
fn mean<T: Scalar>(a: T, b: T, c: Option<T>) -> T {
    match c {
        Some(c) => (a + b + c) / T::from_count(3),
        None => (a + b) / T::from_count(2),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_neighbour_counts_zero_and_a_filled_bottom_counts_for_the_top() {
        // One level, three nodes: bottoms and tops alternate around the ring.
        let tube = Tube { nodes: 3, levels: 1, height_mm: 1.0 };
        let full = |value: f64| TriangleStatistic { value, kept: 1, residual: 0.0 };
        let none = TriangleStatistic::default();
        // bottom 0 is empty: its neighbours are top 0 (6) and top 1 (empty: 0).
        // top 1 is empty: its neighbours are bottom 1 (4) and bottom 0 (filled: 3).
        let statistics = [none, full(4.0), full(1.0), full(6.0), none, full(2.0)];
        let mut values = Vec::new();
        fill(&statistics, &tube, &mut values);
        assert_eq!(values, [3.0, 4.0, 1.0, 6.0, 3.5, 2.0]);
    }
}
