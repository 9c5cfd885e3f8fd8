use super::{MergedVessel, VesselRing};
use crate::cylinders::fit::FittedCylinder;
use glam::DVec3;

impl MergedVessel {
    /// Appends a cylinder with the given radii (its last ones, or those of another iteration) as published (thesis,
    /// section 3.3; `docs/method.md`, "Merging"). Rings that it overlaps are dropped as a whole, the others keep their
    /// order, and the new rings follow them. One shift turns all new rings so that, on the cylinder's first ring, node 0 is
    /// the node nearest to node 0 of the last kept ring; the lowest index wins a tie. Returns the index of the first ring
    /// that is new or was renumbered.
    pub fn stitch(&mut self, cylinder: &FittedCylinder, radii_mm: &[f64]) -> usize {
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
            self.rings.push(VesselRing {
                frame: cylinder.frame,
                nodes_mm: (0..count).map(|j| ring_nodes[turned(j)]).collect(),
                support: (0..count).map(|j| cylinder.tube.support[per_node(j)]).collect(),
                residual_mm: (0..count).map(|j| cylinder.tube.residual_mm[per_node(j)]).collect(),
            });
        }
        first
    }
}
