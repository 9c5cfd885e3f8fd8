//! Vessels that part again and again.

use super::branching::{self, End, Limb};
use super::centreline::Centreline;
use super::curve::Curve;
use super::vessel::SimulatedVessel;
use super::within;
use crate::setters::setters;
use crate::surface::Surface;
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A vessel that parts into two at the end of every tube, over one to three levels.
///
/// Radii follow Murray's law: the cube of a tube's radius is the sum of those of its two daughters. C. D.
/// Murray, *The physiological principle of minimum work*, PNAS 12(3), 1926. There are 2 to the power of
/// `levels` branches, numbered so that of every two daughters the larger one comes first; each has its
/// centreline from the vessel's beginning on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Tree {
    /// Radius of the trunk, mm.
    pub root_radius_mm: f64,
    /// How often the vessel parts between its beginning and each of its ends: 1 to 3.
    pub levels: usize,
    /// Radius of the smaller daughter by that of the larger one: 0.5 to 1.
    pub daughter_ratio: f64,
    /// Angle between a tube and each of its daughters, degrees; from the radii where absent, by Murray's law of
    /// least work (*The physiological principle of minimum work applied to the angle of branching of arteries*,
    /// J. Gen. Physiol. 9(6), 1926). For daughters of the same size that is 37.5°.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub half_angle_deg: Option<f64>,
    /// Angle between the plane in which a tube parts and that in which its daughters part, degrees.
    pub turn_deg: f64,
    /// Length of the straight part of every tube, in its radii.
    pub straight_radii: f64,
}

setters!(Tree {
    with_root_radius_mm => root_radius_mm: f64,
    with_levels => levels: usize,
    with_daughter_ratio => daughter_ratio: f64,
    with_half_angle_deg => half_angle_deg: Option<f64>,
    with_turn_deg => turn_deg: f64,
    with_straight_radii => straight_radii: f64,
});

impl Default for Tree {
    fn default() -> Self {
        Self {
            root_radius_mm: 8.0,
            levels: 2,
            daughter_ratio: 0.8,
            half_angle_deg: None,
            turn_deg: 90.0,
            straight_radii: 4.0,
        }
    }
}

/// A tube of the tree along one of its branches.
struct Tube {
    /// Where it begins and ends along the branch, mm.
    from_mm: f64,
    until_mm: f64,
    /// Length of the bend at its beginning, mm, and what it turns by, rad, towards x and y of the branch's
    /// frame.
    bend_mm: f64,
    bend: DVec2,
    radius_mm: f64,
}

impl Tree {
    /// Checks the dimensions.
    pub(super) fn validate(&self) -> Result<()> {
        within("vessel.shape.tree.root_radius_mm", self.root_radius_mm, 0.5, 100.0)?;
        if !(1..=3).contains(&self.levels) {
            return Err(Error::setting("vessel.shape.tree.levels", self.levels, "1 to 3"));
        }
        within("vessel.shape.tree.daughter_ratio", self.daughter_ratio, 0.5, 1.0)?;
        if let Some(angle) = self.half_angle_deg {
            within("vessel.shape.tree.half_angle_deg", angle, 20.0, 60.0)?;
        }
        within("vessel.shape.tree.turn_deg", self.turn_deg, -180.0, 180.0)?;
        within("vessel.shape.tree.straight_radii", self.straight_radii, 2.0, 50.0)?;
        // Fillets of 2 mm would close the gap between smaller ones.
        let smallest_mm =
            self.root_radius_mm * (self.larger() * self.daughter_ratio).powi(self.levels as i32);
        within("vessel.shape.tree: smallest radius, mm", smallest_mm, 1.5, 100.0)
    }

    /// Radius of the larger daughter by that of its parent.
    fn larger(&self) -> f64 {
        (1.0 + self.daughter_ratio.powi(3)).cbrt().recip()
    }

    /// Length of the longest branch, mm.
    pub(super) fn length_mm(&self) -> f64 {
        self.tubes(0).last().map_or(0.0, |tube| tube.until_mm)
    }

    /// The tubes along a branch, from the trunk on. The bits of its number, the highest first, choose the
    /// daughters.
    fn tubes(&self, branch: usize) -> Vec<Tube> {
        let whole_steps = |length_mm: f64| (length_mm / CURVE_STEP_MM).round() * CURVE_STEP_MM;
        let trunk_mm = whole_steps(self.straight_radii * self.root_radius_mm);
        let mut tubes = vec![Tube {
            from_mm: 0.0,
            until_mm: trunk_mm,
            bend_mm: 0.0,
            bend: DVec2::ZERO,
            radius_mm: self.root_radius_mm,
        }];
        let (mut from_mm, mut parent_mm) = (trunk_mm, self.root_radius_mm);
        for level in 0..self.levels {
            let is_smaller = branch >> (self.levels - 1 - level) & 1 == 1;
            let larger = self.larger();
            let [own, sister] = match is_smaller {
                false => [larger, larger * self.daughter_ratio],
                true => [larger * self.daughter_ratio, larger],
            };
            let murray = || ((1.0 + own.powi(4) - sister.powi(4)) / (2.0 * own * own)).acos();
            let angle = self.half_angle_deg.map_or_else(murray, f64::to_radians);
            let plane = DVec2::from_angle(level as f64 * self.turn_deg.to_radians());
            let (bend_mm, radius_mm) = (BEND_RADII * parent_mm, own * parent_mm);
            let until_mm = from_mm + whole_steps(bend_mm + self.straight_radii * radius_mm);
            let bend = plane * if is_smaller { -angle } else { angle };
            tubes.push(Tube { from_mm, until_mm, bend_mm, bend, radius_mm });
            (from_mm, parent_mm) = (until_mm, radius_mm);
        }
        tubes
    }

    /// The vessel.
    pub(super) fn vessel(&self, edge_mm: f64) -> Result<SimulatedVessel> {
        let mut limbs: Vec<Limb> = Vec::new();
        let mut ends = Vec::new();
        let mut curves = Vec::new();
        for branch in 0..1_usize << self.levels {
            let tubes = self.tubes(branch);
            let length_mm = tubes.last().map_or(0.0, |tube| tube.until_mm);
            let curve = Curve::integrate(length_mm, |s| {
                let here =
                    tubes.iter().rev().find(|tube| s >= tube.from_mm && s < tube.from_mm + tube.bend_mm);
                // A bend that starts and ends softly.
                here.map_or(DVec2::ZERO, |tube| {
                    tube.bend / tube.bend_mm * (1.0 - (TAU * (s - tube.from_mm) / tube.bend_mm).cos())
                })
            });
            let place = |s: f64| (s / CURVE_STEP_MM).round() as usize;
            for (level, tube) in tubes.iter().enumerate() {
                // A tube that several branches share is made with the first of them.
                if branch % (1 << (self.levels - level)) != 0 {
                    continue;
                }
                let (from, until) = (place(tube.from_mm), place(tube.until_mm).min(curve.points.len() - 1));
                let mut middle_mm: Vec<DVec3> =
                    curve.points[from..until].iter().copied().step_by(20).collect();
                middle_mm.push(curve.points[until]);
                // Round ends lie beyond the openings.
                if level == 0 {
                    middle_mm.insert(0, DVec3::Z * -2.0 * tube.radius_mm);
                }
                if level == self.levels {
                    let onward = curve.at(tube.until_mm).1.z_axis;
                    let beyond_mm = tube.radius_mm + edge_mm;
                    ends.push(End {
                        middle_mm: curve.points[until],
                        onward,
                        reach_mm: 2.5 * tube.radius_mm + 3.0 * edge_mm,
                    });
                    middle_mm.push(curve.points[until] + onward * beyond_mm);
                }
                limbs.push(Limb::new(middle_mm, tube.radius_mm));
            }
            curves.push(curve);
        }
        let centreline = |curve: &Curve| {
            let points: Vec<DVec3> = curve.points.iter().copied().step_by(20).collect();
            let radii = points.iter().map(|p| -branching::distance_mm(&limbs, *p)).collect();
            Centreline::new(points, radii)
        };
        let centrelines = curves.iter().map(centreline).collect::<Result<Vec<_>>>()?;
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for limb in &limbs {
            for p in &limb.middle_mm {
                low = low.min(p - limb.radius_mm - 2.0 * edge_mm);
                high = high.max(p + limb.radius_mm + 2.0 * edge_mm);
            }
        }
        let mut surface = branching::wall(&limbs, low.with_z(0.0), high, edge_mm)?;
        for end in &ends {
            branching::open(&mut surface, end, edge_mm);
        }
        self.refuse_faults(&surface)?;
        SimulatedVessel::new(surface, centrelines)
    }

    /// Refuses walls whose branches run into each other, or that the lattice was too coarse for.
    fn refuse_faults(&self, surface: &Surface) -> Result<()> {
        let topology = surface.topology();
        let openings = (1 << self.levels) + 1;
        if topology.boundary_loops == openings
            && topology.components == 1
            && topology.euler_characteristic == 2 - openings as i64
            && topology.is_oriented_manifold()
        {
            return Ok(());
        }
        Err(Error::setting(
            "vessel.shape.tree",
            format!("a wall of {} pieces with {} openings", topology.components, topology.boundary_loops),
            format!(
                "one piece with {openings} openings: shorter edges (vessel.edge_mm), or other angles (half_angle_deg, \
                 turn_deg) or lengths (straight_radii) that keep branches apart"
            ),
        ))
    }
}

/// Length of a bend in radii of the tube that parts: no daughter's wall folds at any angle that is allowed.
const BEND_RADII: f64 = 2.5;

/// Lengths are multiples of this step of [`Curve`], mm, so that branches have the same points where they run
/// together.
const CURVE_STEP_MM: f64 = 0.05;
