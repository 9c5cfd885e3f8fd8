//! Values of triangles without kept points (docs/method.md, "Local cylinder fit").

use super::TriangleStatistic;
use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;

/// The value of every triangle, mm: its own statistic's, or the mean over its edge neighbours where no distance was
/// kept. Bottom triangles are filled first (an empty neighbour counts 0), then top ones (from filled bottom ones).
/// The values are in the order in which [`Tube`] numbers its triangles: bottom ones, then top ones.
pub fn fill<T: Scalar>(statistics: &[TriangleStatistic<T>], tube: &Tube, values: &mut Vec<T>) {
    let faces = tube.face_count();
    values.clear();
    values.extend(statistics.iter().map(|s| s.value));
    for face in (0..faces).filter(|&f| statistics[f].kept == 0) {
        let ([first, second], third) = tube.bottom_neighbours(face);
        let [a, b] = [values[faces + first], values[faces + second]];
        values[face] = mean(a, b, third.map(|t| values[faces + t]));
    }
    for face in (0..faces).filter(|&f| statistics[faces + f].kept == 0) {
        let ([first, second], third) = tube.top_neighbours(face);
        let [a, b] = [values[first], values[second]];
        values[faces + face] = mean(a, b, third.map(|t| values[t]));
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
