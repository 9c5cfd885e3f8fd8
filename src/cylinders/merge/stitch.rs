use super::{MergedVessel, VesselRing};
use crate::cylinders::fit::FittedCylinder;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Which way the cylinders follow each other along their own axes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Travel {
    /// Centre of the last cylinder, mm.
    last_mm: Option<DVec3>,
    /// The way along the cylinders' axes so far, mm.
    along_mm: f64,
    /// Whether the probe moves against its axis, as where a catheter that looks forwards is pulled back.
    backwards: bool,
}

impl Travel {
    /// Takes the next cylinder. Whether the direction has turned: it has once the cylinders have gone half a height from
    /// where they began, the other way.
    fn turns(&mut self, cylinder: &FittedCylinder) -> bool {
        let centre_mm = cylinder.world_from_cylinder.translation_mm;
        let last_mm = self.last_mm.replace(centre_mm).unwrap_or(centre_mm);
        self.along_mm += (centre_mm - last_mm).dot(cylinder.world_from_cylinder.rotation.x_axis);
        let turns = match self.backwards {
            false => self.along_mm < -cylinder.tube.tube.height_mm / 2.0,
            true => self.along_mm > cylinder.tube.tube.height_mm / 2.0,
        };
        self.backwards ^= turns;
        turns
    }
}

impl VesselRing {
    /// The same ring the other way round: node 0 stays.
    fn turn_round(&mut self) {
        self.nodes_mm[1..].reverse();
        self.support[1..].reverse();
        self.residual_mm[1..].reverse();
    }
}

impl MergedVessel {
    /// Appends a cylinder with the given radii (its last ones, or those of another iteration) as published (thesis,
    /// section 3.3; `docs/method.md`, "Merging"). Rings that it overlaps are dropped as a whole, the others keep their
    /// order, and the new rings follow them: those of a probe that moves against its axis from the last to the first. One shift turns all new rings so that, on the cylinder's first ring, node 0 is
    /// the node nearest to node 0 of the last kept ring; the lowest index wins a tie. Returns the index of the first ring
    /// that is new or was renumbered.
    pub fn stitch(&mut self, cylinder: &FittedCylinder, radii_mm: &[f64]) -> usize {
        let has_turned = self.travel.turns(cylinder);
        let backwards = self.travel.backwards;
        if has_turned {
            self.rings.reverse();
            self.rings.iter_mut().for_each(VesselRing::turn_round);
        }
        let count = cylinder.tube.tube.nodes;
        let nodes: Vec<DVec3> = cylinder.nodes_mm(radii_mm).collect();
        let cylinder_from_world = cylinder.world_from_cylinder.inverse();
        let (low, high) = nodes
            .iter()
            .map(|&node| cylinder_from_world.transform_point(node))
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), q| (low.min(q), high.max(q)));
        let overlaps = |&node: &DVec3| {
            let q = cylinder_from_world.transform_point(node);
            let ahead = if backwards { q.x <= high.x } else { q.x >= low.x };
            ahead && low.y <= q.y && q.y <= high.y && low.z <= q.z && q.z <= high.z
        };
        let (mut first, mut dropped) = (0, false);
        self.rings.retain(|ring| {
            let keep = !ring.nodes_mm.iter().any(overlaps);
            dropped |= !keep;
            first += usize::from(!dropped);
            keep
        });

        let levels = nodes.len() / count;
        let mut rings: Vec<VesselRing> = (0..levels)
            .map(|level| {
                let own = level * count..(level + 1) * count;
                VesselRing {
                    frame: cylinder.frame,
                    nodes_mm: nodes[own.clone()].to_vec(),
                    support: cylinder.tube.support[own.clone()].to_vec(),
                    residual_mm: cylinder.tube.residual_mm[own].to_vec(),
                }
            })
            .collect();
        if backwards {
            rings.reverse();
            rings.iter_mut().for_each(VesselRing::turn_round);
        }
        if let Some((last, next)) = self.rings.last().zip(rings.first()) {
            let distance = |j: usize| next.nodes_mm[j].distance_squared(last.nodes_mm[0]);
            let shift = (1..count).fold(0, |best, j| if distance(j) < distance(best) { j } else { best });
            for ring in &mut rings {
                ring.nodes_mm.rotate_left(shift);
                ring.support.rotate_left(shift);
                ring.residual_mm.rotate_left(shift);
            }
        }
        self.rings.extend(rings);
        if has_turned { 0 } else { first }
    }
}
