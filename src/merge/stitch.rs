use crate::fit::FittedCylinder;
use crate::surface::Surface;
use crate::tube::face_triangles;
use glam::DVec3;
use std::ops::Range;

/// A ring of a stitched vessel.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring {
    /// The frame whose cylinder it came from.
    pub frame: usize,
    /// Its nodes in the world, mm.
    pub nodes_mm: Vec<DVec3>,
    /// Per node: points that support it.
    pub support: Vec<u32>,
    /// Per node: mean |distance| of those points, mm; NaN without points.
    pub residual_mm: Vec<f64>,
}

/// One vessel from successive cylinders, as a stack of rings (thesis, section 3.3; method, section 5).
///
/// Cylinders are appended as they become ready; all have the same number of nodes a ring.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Stitched {
    /// The rings, in the order of the vessel.
    pub rings: Vec<Ring>,
}

impl Stitched {
    /// The vessel of several cylinders, in their order.
    pub fn of<'a>(cylinders: impl IntoIterator<Item = &'a FittedCylinder>) -> Self {
        let mut vessel = Self::default();
        for cylinder in cylinders {
            vessel.append(cylinder, &cylinder.tube.radii_mm);
        }
        vessel
    }

    /// Appends a cylinder with the given radii (its last ones, or those of another iteration): rings that it
    /// overlaps are dropped whole, the rest keep their order, and the new rings come behind them, all turned by
    /// one shift so that their node 0 is the one nearest to node 0 of the last kept ring. The lowest of equally
    /// near nodes is taken, looked for on the new cylinder's first ring. Returns the first ring that is new or has another
    /// number than before.
    pub fn append(&mut self, cylinder: &FittedCylinder, radii_mm: &[f64]) -> usize {
        let count = cylinder.tube.tube.nodes;
        let nodes: Vec<DVec3> = cylinder.nodes_mm(radii_mm).collect();
        let cylinder_from_world = cylinder.world_from_cylinder.inverse();
        let (low, high) = nodes
            .iter()
            .map(|&node| cylinder_from_world.transform_point(node))
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), q| (low.min(q), high.max(q)));
        let overlaps = |&node: &DVec3| {
            let q = cylinder_from_world.transform_point(node);
            q.x >= low.x && low.y <= q.y && q.y <= high.y && low.z <= q.z && q.z <= high.z
        };
        let (mut first, mut dropped) = (0, false);
        self.rings.retain(|ring| {
            let keep = !ring.nodes_mm.iter().any(overlaps);
            dropped |= !keep;
            first += usize::from(!dropped);
            keep
        });

        let shift = self.rings.last().map_or(0, |last| {
            let distance = |j: usize| nodes[j].distance_squared(last.nodes_mm[0]);
            (1..count).fold(0, |best, j| if distance(j) < distance(best) { j } else { best })
        });
        for (ring, ring_nodes) in nodes.chunks_exact(count).enumerate() {
            let turned = |j: usize| (j + shift) % count;
            let per_node = |j: usize| ring * count + turned(j);
            self.rings.push(Ring {
                frame: cylinder.frame,
                nodes_mm: (0..count).map(|j| ring_nodes[turned(j)]).collect(),
                support: (0..count).map(|j| cylinder.tube.support[per_node(j)]).collect(),
                residual_mm: (0..count).map(|j| cylinder.tube.residual_mm[per_node(j)]).collect(),
            });
        }
        first
    }

    /// The vessel as a triangle surface: consecutive rings joined like the faces of a tube, normals outward,
    /// open at both ends. Arrays: `support` (points), `residual_mm`, `frame`.
    pub fn surface(&self) -> Surface {
        self.part(0..self.rings.len())
    }

    /// Some rings of it.
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
        let array = |value: &dyn Fn(&Ring, usize) -> f64| {
            rings.iter().flat_map(|r| (0..count).map(|j| value(r, j)).collect::<Vec<_>>()).collect()
        };
        surface.set_array("support", array(&|r, j| f64::from(r.support[j])));
        surface.set_array("residual_mm", array(&|r, j| r.residual_mm[j]));
        surface.set_array("frame", array(&|r, _| r.frame as f64));
        surface
    }
}
