//! Axes as files that VMTK, ParaView and 3D Slicer read.

use super::axis::VesselAxis;
use super::find::VesselTree;
use super::sections::Sections;
use crate::output::{ending, write_atomically};
use crate::surface::{PolyData, Space, Surface, read_polylines};
use crate::{Error, Result};
use glam::DVec3;
use std::f64::consts::PI;
use std::path::Path;

impl VesselTree {
    /// Writes the axes as polylines with the node arrays of VMTK's centrelines: `Abscissas` (length along the axis, mm),
    /// `MaximumInscribedSphereRadius` (distance from the axis to the wall, mm), `CenterlineSectionArea` (mm²; NaN where no
    /// outline of the branch's lumen alone is closed), `Curvature` and `Torsion` (1/mm), `FrenetTangent` and
    /// `ParallelTransportNormals` (unit vectors along and across the axis); and `EquivalentRadius` (of the circle of that
    /// area, mm), `BranchId` (also of each line), `SectionClosed` (1 or 0) and `BifurcationOf` (at the node of an axis at which
    /// another branch leaves it, that branch; NaN elsewhere). `surface` is what the axes belong to.
    ///
    /// # Errors
    /// [`Error::UnknownEnding`] for another ending than .vtp; as [`Sections::of`]; [`Error::Write`].
    pub fn write(&self, surface: &Surface, path: &Path, space: Space) -> Result<()> {
        check_axis_ending(path)?;
        let sections = Sections::of(surface, Some(self))?;
        let mut lines: Vec<Vec<u32>> = Vec::new();
        let mut nodes_mm: Vec<DVec3> = Vec::new();
        let mut scalars: [Vec<f64>; 9] = Default::default();
        let mut vectors: [Vec<f64>; 2] = Default::default();
        for (branch, axis) in (0..).zip(&self.axes) {
            let steps = axis.length_mm().ceil().clamp(50.0, 2000.0);
            let at: Vec<f64> = (0..=steps as usize).map(|k| axis.length_mm() * k as f64 / steps).collect();
            let areas = sections.areas_mm2(axis, branch, &at);
            lines.push((0..at.len() as u32).map(|k| nodes_mm.len() as u32 + k).collect());
            for (&at, &area) in at.iter().zip(&areas) {
                let pose = axis.pose(at);
                let inscribed = sections.wall_distance_mm(pose.translation_mm);
                let [curvature, torsion] = axis.bending(at, 2.0 * inscribed.max(0.1));
                let closed = f64::from(u8::from(area.is_finite()));
                let values =
                    [at, inscribed, area, (area / PI).sqrt(), curvature, torsion, f64::from(branch), closed];
                scalars.iter_mut().zip(values).for_each(|(array, value)| array.push(value));
                let directions =
                    [pose.rotation.z_axis, pose.rotation.x_axis].map(|v| space.swapped(v).to_array());
                vectors.iter_mut().zip(directions).for_each(|(array, v)| array.extend(v));
                nodes_mm.push(space.swapped(pose.translation_mm));
            }
        }
        let leaving = self.leaving(&lines, |node| space.swapped(nodes_mm[node as usize]));
        scalars[8] = leaving;
        let names = [
            "Abscissas",
            "MaximumInscribedSphereRadius",
            "CenterlineSectionArea",
            "EquivalentRadius",
            "Curvature",
            "Torsion",
            "BranchId",
            "SectionClosed",
            "BifurcationOf",
        ];
        let of_scalars = names.into_iter().zip(&scalars).map(|(name, values)| (name, 1, values.as_slice()));
        let of_vectors = ["FrenetTangent", "ParallelTransportNormals"].into_iter().zip(&vectors);
        let of_vectors = of_vectors.map(|(name, values)| (name, 3, values.as_slice()));
        let branches: Vec<i32> = (0..self.axes.len() as i32).collect();
        let file = PolyData {
            nodes_mm: &nodes_mm,
            lines: &lines,
            node_arrays: of_scalars.chain(of_vectors).collect(),
            cell_arrays: vec![("BranchId", &branches)],
            ..PolyData::default()
        };
        write_atomically(path, |w| file.write(space, w))
    }

    /// Of each node of the lines along the axes: the branch that leaves there, NaN for none. A branch leaves the axis, of those
    /// before it, that one of its ends is nearest to.
    fn leaving(&self, lines: &[Vec<u32>], place: impl Fn(u32) -> DVec3) -> Vec<f64> {
        let mut leaving = vec![f64::NAN; lines.iter().map(Vec::len).sum()];
        for (branch, axis) in self.axes.iter().enumerate().skip(1) {
            let ends = [0.0, axis.length_mm()].map(|at| axis.pose(at).translation_mm);
            let away = |node: u32| {
                ends.map(|end| end.distance_squared(place(node))).into_iter().fold(f64::MAX, f64::min)
            };
            let earlier = lines[..branch].iter().flatten().copied();
            let nearest = earlier.map(|node| (away(node), node)).min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, node)) = nearest {
                leaving[node as usize] = branch as f64;
            }
        }
        leaving
    }
}

impl VesselAxis {
    /// Reads the polylines of a .vtp file, such as [`VesselTree::write`] or VMTK write them, as axes, mm.
    ///
    /// # Errors
    /// [`Error::UnknownEnding`], [`Error::Read`] and [`Error::Input`] where the file holds no polylines.
    pub fn read(path: &Path) -> Result<Vec<Self>> {
        check_axis_ending(path)?;
        let lines = read_polylines(path)?;
        lines.iter().map(|line| Self::through(line).map_err(|e| e.in_file(path))).collect()
    }
}

/// Refuses a file name that is not that of an axis.
///
/// # Errors
/// [`Error::UnknownEnding`].
pub fn check_axis_ending(path: &Path) -> Result<()> {
    match ending(path).as_str() {
        "vtp" => Ok(()),
        ending => Err(Error::UnknownEnding { path: path.into(), ending: ending.into(), expected: ".vtp" }),
    }
}
