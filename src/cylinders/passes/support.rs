//! The number of points that support each node, and their residual.

use super::TriangleStatistic;
use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;

/// Per node: the number of points kept on the triangles that meet there, and their mean |distance|, mm (0 without
/// points).
pub fn support<T: Scalar>(statistics: &[TriangleStatistic<T>], tube: &Tube) -> (Vec<u32>, Vec<T>) {
    (0..tube.node_count())
        .map(|node| {
            let (mut count, mut total) = (0_u32, T::default());
            for triangle in tube.incident_triangles(node) {
                let s = &statistics[triangle];
                count += s.kept;
                total = total + T::from_count(s.kept) * s.residual;
            }
            (count, total / T::from_count(count.max(1)))
        })
        .unzip()
}
