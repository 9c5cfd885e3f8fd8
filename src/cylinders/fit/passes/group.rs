//! Points grouped by face: a counting sort, once per cylinder, since a node moves in r only and a point's face
//! never changes (method, section 3).

use super::Section;
use crate::cylinders::Tube;
use crate::numerics::Scalar;

/// The steps of a tube's grid, as every pass uses them.
#[derive(Debug, Clone, Copy)]
pub struct Grid<T> {
    /// N.
    pub nodes: u32,
    /// L.
    pub levels: u32,
    /// H/2, mm.
    pub half_height: T,
    /// 2π/N, rad.
    pub step_theta: T,
    /// H/L, mm.
    pub step_z: T,
    /// N/2π.
    pub faces_per_rad: T,
    /// L/H.
    pub faces_per_mm: T,
}

impl<T: Scalar> Grid<T> {
    /// The grid of a tube.
    pub fn new(tube: &Tube) -> Self {
        let (n, l, h) = (tube.nodes as f64, tube.levels as f64, tube.height_mm);
        Self {
            nodes: tube.nodes as u32,
            levels: tube.levels as u32,
            half_height: T::from_f64(h / 2.0),
            step_theta: T::from_f64(std::f64::consts::TAU / n),
            step_z: T::from_f64(h / l),
            faces_per_rad: T::from_f64(n / std::f64::consts::TAU),
            faces_per_mm: T::from_f64(l / h),
        }
    }

    /// Level and node of the face that holds a point with that angle and height.
    #[inline(always)]
    pub fn face(&self, theta: T, z: T) -> (u32, u32) {
        let level = ((z + self.half_height) * self.faces_per_mm).floor_to_u32().min(self.levels - 1);
        let node = (theta * self.faces_per_rad).floor_to_u32().min(self.nodes - 1);
        (level, node)
    }
}

/// A section's points, face after face.
#[derive(Debug, Clone, Default)]
pub struct Groups<T> {
    /// Where each face's points begin; one entry more than there are faces.
    pub offsets: Vec<u32>,
    /// r, θ - θⱼ and z - zₗ of each point: measured from the face's corner a, so that they stay small and
    /// keep their digits.
    pub points: Vec<[T; 3]>,
}

impl<T: Scalar> Groups<T> {
    /// The points of a face.
    pub fn of_face(&self, face: usize) -> &[[T; 3]] {
        &self.points[self.offsets[face] as usize..self.offsets[face + 1] as usize]
    }
}

/// Groups a section's points by face.
pub fn group<T: Scalar>(section: &Section<T>, tube: &Tube) -> Groups<T> {
    let grid = Grid::<T>::new(tube);
    let faces = tube.face_count();
    let mut offsets = vec![0_u32; faces + 1];
    let mut face_of: Vec<u32> = Vec::with_capacity(section.len());
    for i in 0..section.len() {
        let (level, node) = grid.face(section.theta[i], section.z[i]);
        let face = level * grid.nodes + node;
        offsets[face as usize + 1] += 1;
        face_of.push(face);
    }
    for face in 0..faces {
        offsets[face + 1] += offsets[face];
    }
    let mut next = offsets.clone();
    let mut points = vec![[T::default(); 3]; section.len()];
    for (i, &face) in face_of.iter().enumerate() {
        let (level, node) = (face / grid.nodes, face % grid.nodes);
        let slot = &mut next[face as usize];
        points[*slot as usize] = [
            section.r[i],
            section.theta[i] - T::from_count(node) * grid.step_theta,
            (section.z[i] + grid.half_height) - T::from_count(level) * grid.step_z,
        ];
        *slot += 1;
    }
    Groups { offsets, points }
}
