//! The step of the nodes (docs/method.md, "Local cylinder fit").

use super::Filter;
use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;
use rayon::prelude::*;

/// Nodes per parallel task: fewer do not pay for a thread.
const TASK: usize = 16_384;

/// Moves every node along r by the mean of its incident triangles' values and returns the mean |travel|, mm.
pub fn update<T: Scalar>(values: &[T], tube: &Tube, filter: &Filter<T>, radii: &mut [T]) -> T {
    let of_task = |(task, radii): (usize, &mut [T])| {
        let mut sum = T::Sum::default();
        for (node, radius) in (task * TASK..).zip(radii) {
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
        sum
    };
    let sum = match radii.len() <= TASK {
        true => of_task((0, radii)),
        // Integers: the same in every order.
        false => radii.par_chunks_mut(TASK).enumerate().map(of_task).reduce(T::Sum::default, |a, b| a + b),
    };
    T::mean_of(sum, filter.unit, tube.node_count() as u32)
}
