//! The step of the nodes (docs/method.md, "Local cylinder fit").

use super::Filter;
use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;

/// Moves every node along r by the mean of its incident triangles' values and returns the mean |travel|, mm.
pub fn update<T: Scalar>(values: &[T], tube: &Tube, filter: &Filter<T>, radii: &mut [T]) -> T {
    let mut sum = T::Sum::default();
    for (node, radius) in radii.iter_mut().enumerate() {
        let mut triangles = tube.incident_triangles(node);
        let first = triangles.next().map_or(T::default(), |t| values[t]);
        let (mut travel, mut count) = (first, 1);
        for triangle in triangles {
            travel = travel + values[triangle];
            count += 1;
        }
        let travel = travel / T::from_count(count);
        *radius = *radius + travel;
        sum = sum + travel.abs().to_fixed(filter.scale);
    }
    T::mean_of(sum, filter.unit, tube.node_count() as u32)
}
