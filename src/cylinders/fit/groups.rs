//! Points grouped by face: a counting sort, once per cylinder, since a node moves in r only and a point's face
//! never changes.

use crate::cylinders::passes::{Section, TubeGrid, bin, scan_downsweep, scan_reduce, scan_spine, scatter};
use crate::cylinders::tube::Tube;
use crate::numerics::Scalar;

/// A section's points, face after face.
#[derive(Debug, Clone, Default)]
pub struct Groups<T> {
    /// Where each face's points begin; one entry more than there are faces.
    pub offsets: Vec<u32>,
    /// r (mm), θ - θⱼ (rad) and z - zₗ (mm) of each point: measured from the face's corner a, so that they stay
    /// small, which preserves f32 precision.
    pub points: Vec<[T; 3]>,
}

impl<T: Scalar> Groups<T> {
    /// The points of a face.
    pub fn of_face(&self, face: usize) -> &[[T; 3]] {
        &self.points[self.offsets[face] as usize..self.offsets[face + 1] as usize]
    }
}

/// Groups a section's points by face; those of a face stay in the order of the section.
pub fn group<T: Scalar>(section: &Section<T>, tube: &Tube) -> Groups<T> {
    let grid = TubeGrid::<T>::new(tube);
    let mut counts = vec![0_u32; tube.face_count()];
    let places = bin(section, None, &grid, &mut counts);
    let mut block_sums = scan_reduce(&counts);
    scan_spine(&mut block_sums);
    let offsets = scan_downsweep(&counts, &block_sums);
    let mut points = vec![[T::default(); 3]; section.len()];
    scatter(section, &places, &offsets, &grid, &mut points);
    Groups { offsets, points }
}
