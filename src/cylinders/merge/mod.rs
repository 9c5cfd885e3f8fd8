//! Merging fitted cylinders into one vessel: stitched as published, or blended.

mod blend;
mod stitch;

pub use blend::Blend;

use crate::cylinders::fit::FittedCylinder;
use crate::settings::Merge;
use crate::surface::Surface;
use crate::surface::face_triangles;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A ring of a vessel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct VesselRing {
    /// The frame whose cylinder it came from; the last one where several were blended.
    pub frame: usize,
    /// Its nodes in the world, mm.
    pub nodes_mm: Vec<DVec3>,
    /// Per node: points that support it.
    pub support: Vec<u32>,
    /// Per node: mean |distance| of those points, mm; NaN without points.
    pub residual_mm: Vec<f64>,
}

/// One vessel, as a stack of rings with the same number of nodes each.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct MergedVessel {
    /// The rings, in the order of the vessel.
    pub rings: Vec<VesselRing>,
    /// How the probe has moved, where the cylinders are stitched.
    travel: stitch::Travel,
}

impl MergedVessel {
    /// Whether all rings have so many nodes, each with its values.
    pub(in crate::cylinders) fn has_rings_of(&self, nodes: usize) -> bool {
        let of_nodes = |ring: &VesselRing| [ring.nodes_mm.len(), ring.support.len(), ring.residual_mm.len()];
        self.rings.iter().all(|ring| of_nodes(ring) == [nodes; 3])
    }

    /// Merges cylinders in the order in which they were recorded.
    pub fn of<'a>(cylinders: impl IntoIterator<Item = &'a FittedCylinder>, merge: Merge) -> Self {
        match merge {
            Merge::Stitch => {
                let mut vessel = Self::default();
                for cylinder in cylinders {
                    vessel.stitch(cylinder, &cylinder.tube.radii_mm);
                }
                vessel
            }
            Merge::Blend => {
                let mut blend = Blend::default();
                cylinders.into_iter().for_each(|c| blend.append(c, &c.tube.radii_mm));
                blend.vessel()
            }
        }
    }

    /// The vessel as a triangle surface: consecutive rings joined like the faces of a tube, normals outward,
    /// open at both ends. Arrays: `support` (points), `residual_mm`, `frame`.
    pub fn surface(&self) -> Surface {
        self.part(0..self.rings.len())
    }

    /// The surface of a range of rings.
    pub(crate) fn part(&self, rings: Range<usize>) -> Surface {
        let rings = &self.rings[rings];
        let count = rings.first().map_or(0, |ring| ring.nodes_mm.len());
        let node = |ring: usize, j: usize| (ring * count + j % count) as u32;
        let triangles = (1..rings.len())
            .flat_map(|ring| (0..count).map(move |j| (ring - 1, j)))
            .flat_map(|(ring, j)| {
                face_triangles(node(ring, j), node(ring, j + 1), node(ring + 1, j + 1), node(ring + 1, j))
            })
            .collect();
        let mut surface = Surface {
            nodes_mm: rings.iter().flat_map(|r| r.nodes_mm.iter().copied()).collect(),
            triangles,
            arrays: Vec::new(),
        };
        let array = |value: &dyn Fn(&VesselRing, usize) -> f64| {
            rings.iter().flat_map(|r| (0..count).map(|j| value(r, j)).collect::<Vec<_>>()).collect()
        };
        surface.set_array("support", array(&|r, j| f64::from(r.support[j])));
        surface.set_array("residual_mm", array(&|r, j| r.residual_mm[j]));
        surface.set_array("frame", array(&|r, _| r.frame as f64));
        surface
    }
}
