//! The face of each point.

use super::{NONE, Section, TubeGrid};
use crate::numerics::Scalar;

/// Per point: its face, and its place among the points of that face in the order of the section; a point without an
/// owner has the face [`NONE`]. `counts` has one entry per face of all cylinders; it is increased by the
/// number of points of each. `owners` gives the cylinder of each point; without it all belong to cylinder 0.
///
/// The device assigns the places of a face in any order.
pub fn bin<T: Scalar>(
    section: &Section<T>,
    owners: Option<&[u32]>,
    grid: &TubeGrid<T>,
    counts: &mut [u32],
) -> Vec<[u32; 2]> {
    let points = section.theta.iter().zip(&section.z).enumerate();
    let place = |(i, (&theta, &z))| {
        let owner = owners.map_or(0, |owners| owners[i]);
        if owner == NONE {
            return [NONE, 0];
        }
        let (level, node) = grid.face(theta, z);
        let face = owner * grid.face_count() + level * grid.nodes + node;
        let count = &mut counts[face as usize];
        let place = *count;
        *count += 1;
        [face, place]
    };
    points.map(place).collect()
}
