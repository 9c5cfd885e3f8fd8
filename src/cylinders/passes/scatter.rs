//! Points, face after face.

use super::{NONE, Section, TubeGrid};
use crate::numerics::Scalar;

/// A point, measured from its face's corner, as the device groups it: the bits of its coordinates, and its face among
/// those of all cylinders.
pub fn grouped_point(point: [f32; 3], face_of_all: u32) -> [u32; 4] {
    let [r, theta, z] = point.map(f32::to_bits);
    [r, theta, z, face_of_all]
}

/// Moves each point to its place behind its face's offset, measured from the face's corner a: r, θ - θⱼ and z - zₗ,
/// which stay small and so preserve f32 precision. Points without a face are left out.
pub fn scatter<T: Scalar>(
    section: &Section<T>,
    places: &[[u32; 2]],
    offsets: &[u32],
    grid: &TubeGrid<T>,
    grouped: &mut [[T; 3]],
) {
    let faces = grid.face_count();
    let points = section.r.iter().zip(&section.theta).zip(&section.z);
    for (((&r, &theta), &z), &[face_of_all, place]) in points.zip(places) {
        if face_of_all == NONE {
            continue;
        }
        let face = face_of_all % faces;
        let (level, node) = (face / grid.nodes, face % grid.nodes);
        grouped[(offsets[face_of_all as usize] + place) as usize] =
            grid.from_corner([r, theta, z], level, node);
    }
}
