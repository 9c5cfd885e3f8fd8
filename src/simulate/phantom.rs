//! Vessels defined by formulas.

use super::branching::{self, Limb};
use super::centreline::Centreline;
use super::curve::Curve;
use super::tree::Tree;
use super::vessel::SimulatedVessel;
use super::within;
use crate::setters::setters;
use crate::surface::Surface;
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::str::FromStr;

/// A vessel defined by formulas: a tube about a smooth curve, or several that branch, open at its ends. Its
/// centrelines start at the origin along +z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct Phantom {
    /// Which vessel.
    pub shape: Shape,
    /// Length of the wall's triangle edges, mm. 0.1 to 10.
    #[serde(default = "default_edge_mm")]
    pub edge_mm: f64,
}

setters!(Phantom { with_edge_mm => edge_mm: f64 });

fn default_edge_mm() -> f64 {
    1.2
}

/// The phantoms and their dimensions in mm. Where the tubes of a branching one meet, the wall is rounded off:
/// it lies up to 0.5 mm further out where two of its tubes are less than 2 mm apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[non_exhaustive]
pub enum Shape {
    /// An adult aorta, 320 mm long: ascending (60 mm), arch (a half turn, tightest bend 34 mm) and descending,
    /// bent a little out of its plane. Mean radius 14 mm at the root to 10 mm at the end, with a bulge at the
    /// root, slow waves of 0.4 mm, a cross-section 6 % longer than wide whose long axis turns along the
    /// vessel, and a slight three-lobed bump, so that no local cylinder fits it exactly.
    Aorta,
    /// A straight cylinder.
    Cylinder {
        /// Radius.
        radius_mm: f64,
        /// Length.
        length_mm: f64,
    },
    /// A straight, round, evenly tapering tube.
    Frustum {
        /// Radius at the start.
        start_radius_mm: f64,
        /// Radius at the end.
        end_radius_mm: f64,
        /// Length.
        length_mm: f64,
    },
    /// A round tube bent into part of a circle.
    Arch {
        /// Radius of the tube.
        radius_mm: f64,
        /// Radius of the circle that the centreline follows.
        bend_radius_mm: f64,
        /// How far round it goes, degrees.
        angle_deg: f64,
    },
    /// A straight round tube with a smooth (Gaussian) narrowing halfway.
    Stenosis {
        /// Radius away from the narrowing.
        radius_mm: f64,
        /// Radius at its middle.
        throat_radius_mm: f64,
        /// Standard deviation of the Gaussian along the vessel.
        throat_sd_mm: f64,
        /// Length of the vessel.
        length_mm: f64,
    },
    /// A straight tube with a smooth (Gaussian) bulge halfway that lies more to one side.
    Aneurysm {
        /// Radius away from the bulge.
        radius_mm: f64,
        /// Largest distance from the centreline to the wall in the bulge; across from it the wall bulges half
        /// as much.
        sac_radius_mm: f64,
        /// Standard deviation of the Gaussian along the vessel.
        sac_sd_mm: f64,
        /// Length of the vessel.
        length_mm: f64,
    },
    /// A straight elliptic tube, evenly tapering.
    Ellipse {
        /// Half axes at the start.
        start_half_axes_mm: [f64; 2],
        /// Half axes at the end.
        end_half_axes_mm: [f64; 2],
        /// Length.
        length_mm: f64,
    },
    /// A straight round tube that parts into two of equal size, bending away to +x and -x.
    Bifurcation {
        /// Radius before the parting.
        parent_radius_mm: f64,
        /// Radius of each of the two.
        daughter_radius_mm: f64,
        /// Angle between each of the two and the parent, degrees. The bend starts halfway and takes a quarter
        /// of the length.
        half_angle_deg: f64,
        /// Length along z.
        length_mm: f64,
    },
    /// A straight round tube with a smaller one that leaves it towards +x.
    SideBranch {
        /// Radius of the trunk.
        trunk_radius_mm: f64,
        /// Radius of the branch, smaller than the trunk's.
        branch_radius_mm: f64,
        /// Angle between branch and trunk, degrees.
        angle_deg: f64,
        /// Length of the trunk. Its first third is straight in both centrelines; the branch is cut one trunk
        /// radius and a quarter of this length away from the trunk's middle.
        length_mm: f64,
    },
    /// A straight round tube that parts into two of unequal size, which part again, over one to three levels.
    Tree(Tree),
}

impl Shape {
    /// The names that [`Shape::from_str`] knows.
    pub const NAMES: [&str; 12] = [
        "aorta",
        "cylinder",
        "frustum",
        "arch",
        "small_arch",
        "stenosis",
        "aneurysm",
        "ellipse",
        "bifurcation",
        "side_branch",
        "tree",
        "deep_tree",
    ];

    /// The shape's name.
    pub fn name(&self) -> &'static str {
        match self {
            Shape::Aorta => "aorta",
            Shape::Cylinder { .. } => "cylinder",
            Shape::Frustum { .. } => "frustum",
            Shape::Arch { .. } => "arch",
            Shape::Stenosis { .. } => "stenosis",
            Shape::Aneurysm { .. } => "aneurysm",
            Shape::Ellipse { .. } => "ellipse",
            Shape::Bifurcation { .. } => "bifurcation",
            Shape::SideBranch { .. } => "side_branch",
            Shape::Tree(_) => "tree",
        }
    }
}

impl FromStr for Shape {
    type Err = Error;

    /// A phantom by name, with its usual dimensions.
    fn from_str(name: &str) -> Result<Self> {
        Ok(match name {
            "aorta" => Shape::Aorta,
            "cylinder" => Shape::Cylinder { radius_mm: 12.0, length_mm: 100.0 },
            "frustum" => Shape::Frustum { start_radius_mm: 14.0, end_radius_mm: 9.0, length_mm: 100.0 },
            "arch" => Shape::Arch { radius_mm: 10.0, bend_radius_mm: 35.0, angle_deg: 120.0 },
            // A child's, or a smaller vessel's.
            "small_arch" => Shape::Arch { radius_mm: 4.5, bend_radius_mm: 12.0, angle_deg: 180.0 },
            "stenosis" => Shape::Stenosis {
                radius_mm: 10.0,
                throat_radius_mm: 5.5,
                throat_sd_mm: 7.0,
                length_mm: 100.0,
            },
            "aneurysm" => {
                Shape::Aneurysm { radius_mm: 10.0, sac_radius_mm: 20.0, sac_sd_mm: 14.0, length_mm: 120.0 }
            }
            "ellipse" => Shape::Ellipse {
                start_half_axes_mm: [13.0, 10.0],
                end_half_axes_mm: [10.0, 7.0],
                length_mm: 100.0,
            },
            "bifurcation" => Shape::Bifurcation {
                parent_radius_mm: 9.0,
                daughter_radius_mm: 7.0,
                half_angle_deg: 22.0,
                length_mm: 100.0,
            },
            "side_branch" => Shape::SideBranch {
                trunk_radius_mm: 11.0,
                branch_radius_mm: 6.0,
                angle_deg: 60.0,
                length_mm: 100.0,
            },
            "tree" => Shape::Tree(Tree::default()),
            "deep_tree" => Shape::Tree(Tree::default().with_levels(3)),
            other => {
                return Err(Error::Setting {
                    name: "vessel.shape".into(),
                    found: other.into(),
                    expected: format!("one of {}", Shape::NAMES.join(", ")),
                });
            }
        })
    }
}

impl From<Shape> for Phantom {
    fn from(shape: Shape) -> Self {
        Self { shape, edge_mm: default_edge_mm() }
    }
}

impl Phantom {
    /// Builds the vessel.
    ///
    /// # Errors
    /// [`Error::Setting`] where [`Phantom::validate`] refuses the dimensions.
    pub fn vessel(&self) -> Result<SimulatedVessel> {
        self.validate()?;
        if let Shape::Tree(tree) = &self.shape {
            return tree.vessel(self.edge_mm);
        }
        if let Some(branching) = self.branching() {
            return branching.vessel(self.edge_mm);
        }
        // No shape is wider than its widest radius all along.
        branching::not_too_fine(
            self.edge_mm,
            TAU * self.widest_mm() * self.length_mm() / self.edge_mm.powi(2),
        )?;
        let curve = Curve::integrate(self.length_mm(), |s| self.curvature(s));
        SimulatedVessel::new(self.wall(&curve), vec![self.centreline(&curve)?])
    }

    /// Checks the dimensions.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn validate(&self) -> Result<()> {
        within("vessel.edge_mm", self.edge_mm, 0.1, 10.0)?;
        let radius = |name, value| within(name, value, 0.5, 100.0);
        let length = |value| within("vessel.shape.length_mm", value, 5.0, 2000.0);
        match &self.shape {
            Shape::Aorta => Ok(()),
            Shape::Cylinder { radius_mm, length_mm } => {
                radius("vessel.shape.radius_mm", *radius_mm)?;
                length(*length_mm)
            }
            Shape::Frustum { start_radius_mm, end_radius_mm, length_mm } => {
                radius("vessel.shape.start_radius_mm", *start_radius_mm)?;
                radius("vessel.shape.end_radius_mm", *end_radius_mm)?;
                length(*length_mm)
            }
            Shape::Arch { radius_mm, bend_radius_mm, angle_deg } => {
                radius("vessel.shape.radius_mm", *radius_mm)?;
                // A tighter bend would fold the wall into itself; a longer one would meet its own start.
                within("vessel.shape.bend_radius_mm", *bend_radius_mm, 1.2 * radius_mm, 1000.0)?;
                within("vessel.shape.angle_deg", *angle_deg, 10.0, 270.0)
            }
            Shape::Stenosis { radius_mm, throat_radius_mm, throat_sd_mm, length_mm } => {
                radius("vessel.shape.radius_mm", *radius_mm)?;
                within("vessel.shape.throat_radius_mm", *throat_radius_mm, 0.5, *radius_mm)?;
                within("vessel.shape.throat_sd_mm", *throat_sd_mm, 1.0, *length_mm)?;
                length(*length_mm)
            }
            Shape::Aneurysm { radius_mm, sac_radius_mm, sac_sd_mm, length_mm } => {
                radius("vessel.shape.radius_mm", *radius_mm)?;
                within("vessel.shape.sac_radius_mm", *sac_radius_mm, *radius_mm, 100.0)?;
                within("vessel.shape.sac_sd_mm", *sac_sd_mm, 1.0, *length_mm)?;
                length(*length_mm)
            }
            Shape::Bifurcation { parent_radius_mm, daughter_radius_mm, half_angle_deg, length_mm } => {
                radius("vessel.shape.parent_radius_mm", *parent_radius_mm)?;
                within("vessel.shape.daughter_radius_mm", *daughter_radius_mm, 0.5, *parent_radius_mm)?;
                within("vessel.shape.half_angle_deg", *half_angle_deg, 5.0, 60.0)?;
                // Shorter ones end before the two have parted.
                within("vessel.shape.length_mm", *length_mm, 8.0 * parent_radius_mm, 2000.0)
            }
            Shape::SideBranch { trunk_radius_mm, branch_radius_mm, angle_deg, length_mm } => {
                radius("vessel.shape.trunk_radius_mm", *trunk_radius_mm)?;
                within("vessel.shape.branch_radius_mm", *branch_radius_mm, 0.5, 0.9 * trunk_radius_mm)?;
                within("vessel.shape.angle_deg", *angle_deg, 45.0, 90.0)?;
                within("vessel.shape.length_mm", *length_mm, 8.0 * trunk_radius_mm, 2000.0)
            }
            Shape::Tree(tree) => tree.validate(),
            Shape::Ellipse { start_half_axes_mm, end_half_axes_mm, length_mm } => {
                for axis in start_half_axes_mm {
                    radius("vessel.shape.start_half_axes_mm", *axis)?;
                }
                for axis in end_half_axes_mm {
                    radius("vessel.shape.end_half_axes_mm", *axis)?;
                }
                length(*length_mm)
            }
        }
    }

    /// Length of the centreline, mm.
    fn length_mm(&self) -> f64 {
        match &self.shape {
            Shape::Aorta => 320.0,
            Shape::Arch { bend_radius_mm, angle_deg, .. } => bend_radius_mm * angle_deg.to_radians(),
            Shape::Cylinder { length_mm, .. }
            | Shape::Frustum { length_mm, .. }
            | Shape::Stenosis { length_mm, .. }
            | Shape::Aneurysm { length_mm, .. }
            | Shape::Ellipse { length_mm, .. }
            | Shape::Bifurcation { length_mm, .. }
            | Shape::SideBranch { length_mm, .. } => *length_mm,
            Shape::Tree(tree) => tree.length_mm(),
        }
    }

    /// Curvature of the centreline at `s_mm` towards x and y of its rotation-minimising frame, 1/mm.
    fn curvature(&self, s_mm: f64) -> DVec2 {
        match &self.shape {
            Shape::Aorta => {
                let arch = smooth_step((s_mm - 45.0) / 30.0) - smooth_step((s_mm - 145.0) / 35.0);
                let descending = smooth_step((s_mm - 180.0) / 40.0);
                DVec2::new(
                    arch / 34.0 - descending / 400.0,
                    (TAU * s_mm / 260.0).sin() / 180.0 * (1.0 - descending) + descending / 350.0,
                )
            }
            Shape::Arch { bend_radius_mm, .. } => DVec2::new(1.0 / bend_radius_mm, 0.0),
            _ => DVec2::ZERO,
        }
    }

    /// Distance from the centreline to the wall at `s_mm`, in the direction `angle` from x towards y of its
    /// frame, mm.
    fn radius_mm(&self, s_mm: f64, angle: f64) -> f64 {
        let u = s_mm / self.length_mm();
        let bell = |sd: f64| (-0.5 * ((s_mm - 0.5 * self.length_mm()) / sd).powi(2)).exp();
        match &self.shape {
            Shape::Aorta => {
                let mean = 14.0 - 4.0 * smooth_step(u)
                    + 1.5 * (-0.5 * ((s_mm - 14.0) / 9.0).powi(2)).exp()
                    + 0.4 * (TAU * s_mm / 75.0).sin();
                mean * (1.0 + 0.03 * (2.0 * angle - TAU * s_mm / 300.0).cos())
                    + 0.15 * (3.0 * angle + TAU * s_mm / 190.0).cos()
            }
            Shape::Cylinder { radius_mm, .. } | Shape::Arch { radius_mm, .. } => *radius_mm,
            Shape::Frustum { start_radius_mm, end_radius_mm, .. } => {
                start_radius_mm + (end_radius_mm - start_radius_mm) * u
            }
            Shape::Stenosis { radius_mm, throat_radius_mm, throat_sd_mm, .. } => {
                radius_mm + (throat_radius_mm - radius_mm) * bell(*throat_sd_mm)
            }
            Shape::Aneurysm { radius_mm, sac_radius_mm, sac_sd_mm, .. } => {
                radius_mm + (sac_radius_mm - radius_mm) * bell(*sac_sd_mm) * (0.75 + 0.25 * angle.cos())
            }
            Shape::Ellipse { start_half_axes_mm: start, end_half_axes_mm: end, .. } => {
                let (a, b) = (start[0] + (end[0] - start[0]) * u, start[1] + (end[1] - start[1]) * u);
                a * b / (b * angle.cos()).hypot(a * angle.sin())
            }
            Shape::Bifurcation { parent_radius_mm: radius, .. }
            | Shape::SideBranch { trunk_radius_mm: radius, .. } => *radius,
            Shape::Tree(tree) => tree.root_radius_mm,
        }
    }

    /// The largest distance from the centreline to the wall, mm.
    fn widest_mm(&self) -> f64 {
        (0..=1000)
            .flat_map(|i| (0..12).map(move |j| (f64::from(i) / 1000.0, f64::from(j) / 12.0 * TAU)))
            .map(|(u, angle)| self.radius_mm(u * self.length_mm(), angle))
            .fold(0.0, f64::max)
    }

    fn wall(&self, curve: &Curve) -> Surface {
        let length = self.length_mm();
        let around = (TAU * self.widest_mm() / self.edge_mm).ceil().max(12.0) as u32;
        let along = (length / self.edge_mm).ceil().max(1.0) as u32;
        let mut surface = Surface::default();
        for l in 0..=along {
            let s = f64::from(l) / f64::from(along) * length;
            let (point, frame) = curve.at(s);
            for j in 0..around {
                let angle = f64::from(j) / f64::from(around) * TAU;
                let out = frame.x_axis * angle.cos() + frame.y_axis * angle.sin();
                surface.nodes_mm.push(point + out * self.radius_mm(s, angle));
            }
        }
        for l in 0..along {
            for j in 0..around {
                let (here, next) = (l * around + j, l * around + (j + 1) % around);
                surface.triangles.push([here, next, next + around]);
                surface.triangles.push([here, next + around, here + around]);
            }
        }
        surface
    }

    fn centreline(&self, curve: &Curve) -> Result<Centreline> {
        let length = self.length_mm();
        let n = length.ceil() as usize;
        let stations = (0..=n).map(|i| i as f64 / n as f64 * length);
        let narrowest = |s: f64| {
            (0..72).map(|j| self.radius_mm(s, f64::from(j) / 72.0 * TAU)).fold(f64::INFINITY, f64::min)
        };
        Centreline::new(stations.clone().map(|s| curve.at(s).0).collect(), stations.map(narrowest).collect())
    }
}

/// A vessel whose wall is the union of round tubes.
struct Branching {
    /// What the catheter can follow, and the radius of the tube about each.
    branches: Vec<(Curve, f64)>,
    /// Tubes that are no branch of their own.
    trunk: Option<Limb>,
    /// Where the ends are cut off.
    cut_z_mm: f64,
    cut_x_mm: f64,
}

impl Phantom {
    fn branching(&self) -> Option<Branching> {
        // A bend that starts and ends softly, through `angle` from `start` on.
        let bend = |angle: f64, start: f64, length: f64| {
            move |s: f64| {
                let u = ((s - start) / length).clamp(0.0, 1.0);
                DVec2::new(angle / length * (1.0 - (TAU * u).cos()), 0.0)
            }
        };
        match self.shape {
            Shape::Bifurcation { parent_radius_mm, daughter_radius_mm, half_angle_deg, length_mm } => {
                let angle = half_angle_deg.to_radians();
                let daughter = |angle: f64| {
                    // Long enough to pass the cut in spite of its bend.
                    let curve =
                        Curve::integrate(2.5 * length_mm, bend(angle, 0.5 * length_mm, 0.25 * length_mm));
                    (curve, daughter_radius_mm)
                };
                Some(Branching {
                    branches: vec![daughter(angle), daughter(-angle)],
                    trunk: Some(Limb::new(
                        vec![DVec3::Z * -2.0 * parent_radius_mm, DVec3::Z * 0.55 * length_mm],
                        parent_radius_mm,
                    )),
                    cut_z_mm: length_mm,
                    cut_x_mm: f64::INFINITY,
                })
            }
            Shape::SideBranch { trunk_radius_mm, branch_radius_mm, angle_deg, length_mm } => {
                let trunk = Curve::integrate(1.5 * length_mm, |_| DVec2::ZERO);
                let turn = bend(angle_deg.to_radians(), length_mm / 3.0, 0.25 * length_mm);
                let branch = Curve::integrate(2.5 * length_mm, turn);
                Some(Branching {
                    branches: vec![(trunk, trunk_radius_mm), (branch, branch_radius_mm)],
                    trunk: None,
                    cut_z_mm: length_mm,
                    cut_x_mm: trunk_radius_mm + 0.25 * length_mm,
                })
            }
            _ => None,
        }
    }
}

impl Branching {
    fn vessel(self, edge_mm: f64) -> Result<SimulatedVessel> {
        let inside = |p: DVec3| p.z <= self.cut_z_mm && p.x <= self.cut_x_mm;
        let mut limbs: Vec<Limb> = self.trunk.into_iter().collect();
        for (curve, radius_mm) in &self.branches {
            // Round ends lie beyond the cuts.
            let before = DVec3::Z * -2.0 * radius_mm;
            let middle_mm = std::iter::once(before).chain(curve.points.iter().copied().step_by(40)).collect();
            limbs.push(Limb::new(middle_mm, *radius_mm));
        }
        let centreline = |(curve, _): &(Curve, f64)| {
            let points: Vec<DVec3> =
                curve.points.iter().copied().step_by(20).take_while(|p| inside(*p)).collect();
            let radii = points.iter().map(|p| -branching::distance_mm(&limbs, *p)).collect();
            Centreline::new(points, radii)
        };
        let centrelines = self.branches.iter().map(centreline).collect::<Result<Vec<_>>>()?;
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for limb in &limbs {
            for p in limb.middle_mm.iter().filter(|p| p.z <= self.cut_z_mm + 2.0 * limb.radius_mm) {
                low = low.min(p - limb.radius_mm - edge_mm);
                high = high.max(p + limb.radius_mm + edge_mm);
            }
        }
        let low = low.with_z(0.0);
        let high = high.min(DVec3::new(self.cut_x_mm, f64::INFINITY, self.cut_z_mm));
        SimulatedVessel::new(branching::wall(&limbs, low, high, edge_mm)?, centrelines)
    }
}

/// 0 up to 0, 1 from 1 on, with continuous slope.
fn smooth_step(x: f64) -> f64 {
    0.5 - 0.5 * (PI * x.clamp(0.0, 1.0)).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_makes_a_vessel_that_needs_no_repair() {
        for name in Shape::NAMES {
            let vessel = Phantom::from(name.parse::<Shape>().unwrap()).vessel().unwrap();
            assert_eq!(vessel.notes(), [] as [&str; 0], "{name}");
        }
    }

    #[test]
    fn a_wall_that_does_not_fit_in_memory_is_refused() {
        for shape in [
            Shape::Cylinder { radius_mm: 100.0, length_mm: 2000.0 },
            Shape::Bifurcation {
                parent_radius_mm: 20.0,
                daughter_radius_mm: 15.0,
                half_angle_deg: 30.0,
                length_mm: 2000.0,
            },
        ] {
            let error = Phantom { shape, edge_mm: 0.1 }.vessel().unwrap_err();
            assert!(error.to_string().contains("vessel.edge_mm: found 0.1, which makes"), "{error}");
        }
    }

    #[test]
    fn an_arch_that_folds_into_itself_is_refused() {
        let shape = Shape::Arch { radius_mm: 20.0, bend_radius_mm: 15.0, angle_deg: 90.0 };
        let error = Phantom::from(shape).vessel().unwrap_err();
        assert!(error.to_string().contains("bend_radius_mm: found 15"), "{error}");
    }
}
