//! Cross-sections of the lumen, with the standard errors of their measures.

use super::axis::VesselAxis;
use super::find::VesselTree;
use super::uncertainty::{Outline, PointError};
use crate::evaluate::Locator;
use crate::geometry::Pose;
use crate::numerics::robust::median;
use crate::recording::{Recording, Table};
use crate::surface::{Cutter, OnEdge, SectionOutline, Surface};
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

/// The lumen in one plane. Numbers are NaN (`null` in JSON) where the mesh has no closed outline of the lumen there.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LumenSection {
    /// The frame whose plane it is (0-based); none of a section across the axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<usize>,
    /// How far along the axis it lies, mm; none in the plane of a frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_mm: Option<f64>,
    /// The measures.
    #[serde(flatten)]
    pub measures: Measures,
    /// The standard errors of the measures, as far as the mesh has those of its nodes (`standard_error_mm`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub standard_errors: Option<Measures>,
    /// Share of the outline's length that was measured: where all nodes about it have points of the recording. None where
    /// the mesh does not say (`supported` or `support`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_share: Option<f64>,
    /// The branch that parts from the measured one there: the lumen is that of both, and nothing is measured. None elsewhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parting: Option<u32>,
    /// Why numbers are missing or doubtful.
    pub remark: Option<String>,
}

/// What is measured of a section.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Measures {
    /// Cross-sectional area inside the outline, mm².
    pub area_mm2: f64,
    /// Length of the outline, mm.
    pub perimeter_mm: f64,
    /// Shortest chord through the area's centroid, mm; NaN where the centroid lies outside the outline.
    pub least_diameter_mm: f64,
    /// Longest chord through the area's centroid, mm; NaN where the centroid lies outside the outline.
    pub greatest_diameter_mm: f64,
    /// Circular-equivalent diameter: that of the circle of the same area, mm.
    pub equivalent_diameter_mm: f64,
    /// Feret's diameter: the largest distance of two points of the outline, mm.
    pub feret_diameter_mm: f64,
    /// Diameter of the largest sphere within the wall whose centre lies in the plane (maximum inscribed sphere), mm.
    pub inscribed_diameter_mm: f64,
    /// Lumen eccentricity: greatest less least diameter, as a share of the greatest (American College of Cardiology, 2001).
    pub eccentricity: f64,
    /// Centroid of the area, mm.
    pub x_mm: f64,
    /// Centroid of the area, mm.
    pub y_mm: f64,
    /// Centroid of the area, mm.
    pub z_mm: f64,
}

impl Measures {
    /// Names of the measures, in the order of [`Measures::values`].
    pub const NAMES: [&str; 11] = [
        "area_mm2",
        "perimeter_mm",
        "least_diameter_mm",
        "greatest_diameter_mm",
        "equivalent_diameter_mm",
        "feret_diameter_mm",
        "inscribed_diameter_mm",
        "eccentricity",
        "x_mm",
        "y_mm",
        "z_mm",
    ];

    /// Their values.
    pub fn values(&self) -> [f64; 11] {
        [
            self.area_mm2,
            self.perimeter_mm,
            self.least_diameter_mm,
            self.greatest_diameter_mm,
            self.equivalent_diameter_mm,
            self.feret_diameter_mm,
            self.inscribed_diameter_mm,
            self.eccentricity,
            self.x_mm,
            self.y_mm,
            self.z_mm,
        ]
    }

    const NONE: Self = Self {
        area_mm2: f64::NAN,
        perimeter_mm: f64::NAN,
        least_diameter_mm: f64::NAN,
        greatest_diameter_mm: f64::NAN,
        equivalent_diameter_mm: f64::NAN,
        feret_diameter_mm: f64::NAN,
        inscribed_diameter_mm: f64::NAN,
        eccentricity: f64::NAN,
        x_mm: f64::NAN,
        y_mm: f64::NAN,
        z_mm: f64::NAN,
    };
}

impl LumenSection {
    /// A section without numbers.
    pub fn without(remark: String) -> Self {
        Self {
            frame: None,
            at_mm: None,
            measures: Measures::NONE,
            standard_errors: None,
            measured_share: None,
            parting: None,
            remark: Some(remark),
        }
    }

    /// Names it after a frame.
    #[must_use]
    pub fn of_frame(self, frame: usize) -> Self {
        Self { frame: Some(frame), ..self }
    }
}

/// The distance of neighbouring nodes, mm, in the mean: where a mesh does not say how far errors are alike, they count as
/// independent beyond it.
fn spacing_mm(surface: &Surface) -> f64 {
    let areas = surface.node_areas_mm2();
    (areas.iter().sum::<f64>() / areas.len().max(1) as f64).sqrt()
}

/// Why there is no outline of a lumen alone.
struct Missing {
    remark: String,
    /// The other branch that the outline runs into.
    other: Option<u32>,
}

impl Missing {
    fn because(remark: String) -> Self {
        Self { remark, other: None }
    }
}

/// Which outline of a plane is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Choice {
    /// The one about the plane's origin, or else the nearest one.
    Nearest,
    /// That of the lumen of a branch: about the origin, or as near to it as slits leave it, and of that branch only.
    OfBranch(u32),
}

/// Cuts one surface by many planes and measures the lumen there.
pub struct Sections<'a> {
    cutter: Cutter<'a>,
    locator: Locator,
    standard_error_mm: Option<&'a [f64]>,
    /// Distance over which errors of nodes are alike, mm: that of each node, or of all.
    error_reach_mm: Result<&'a [f64], f64>,
    measured: Option<Vec<bool>>,
    tree: Option<&'a VesselTree>,
    /// Of each branch: its median radius in its outer half, mm.
    radius_mm: Vec<f64>,
}

impl<'a> Sections<'a> {
    /// Prepares a surface. Its node arrays `standard_error_mm`, `error_reach_mm`, `support` and `supported` are used where
    /// it has them. The tree tells its branches apart.
    ///
    /// # Errors
    /// As [`Surface::check`], and where no triangle has an area.
    pub fn of(surface: &'a Surface, tree: Option<&'a VesselTree>) -> Result<Self> {
        let is_one = |values: &[f64]| values.iter().map(|&v| v > 0.0).collect();
        let measured = surface.array("supported").or_else(|| surface.array("support")).map(is_one);
        let locator = Locator::new(surface)?;
        let radius_mm = |axis: &VesselAxis| {
            let outer = &axis.points_mm()[axis.points_mm().len() / 2..];
            median(&mut locator.closest_all(outer).iter().map(|c| c.distance_mm).collect::<Vec<_>>())
        };
        let radius_mm = tree.map_or(Vec::new(), |tree| tree.axes.iter().map(radius_mm).collect());
        Ok(Self {
            cutter: Cutter::new(surface)?,
            locator,
            radius_mm,
            standard_error_mm: surface.array("standard_error_mm"),
            error_reach_mm: surface.array("error_reach_mm").ok_or_else(|| spacing_mm(surface)),
            measured,
            tree,
        })
    }

    /// The section in the xy-plane of a pose: the outline about its origin, or the one nearest to it where none is
    /// about it, which is then said.
    pub fn nearest(&self, world_from_plane: &Pose) -> LumenSection {
        self.measure(world_from_plane, Choice::Nearest)
    }

    /// The sections in the planes of a recording's frames, the xy-planes of the probe `{i}`. `sensor_from_probe` is the
    /// calibration `eTi`.
    pub fn of_frames(&self, recording: &Recording, sensor_from_probe: Pose) -> Vec<LumenSection> {
        let poses: Vec<Pose> =
            recording.frames.iter().map(|frame| frame.world_from_sensor * sensor_from_probe).collect();
        poses.par_iter().enumerate().map(|(frame, pose)| self.nearest(pose).of_frame(frame)).collect()
    }

    /// The sections of a branch across its axis at some places, mm along it. An outline that is not the branch's lumen
    /// alone is not measured; the remark says why.
    pub fn across(&self, axis: &VesselAxis, branch: u32, at_mm: &[f64]) -> Vec<LumenSection> {
        let mouths = self.mouths(axis, branch);
        let section = |&at: &f64| {
            let mouth = mouths.iter().find(|([from, to], _)| (*from..=*to).contains(&at));
            let section = match mouth {
                Some(&(_, other)) => LumenSection {
                    parting: Some(other),
                    ..LumenSection::without(format!("a parting: the outline runs into branch {other}"))
                },
                None => self.measure(&axis.pose(at), Choice::OfBranch(branch)),
            };
            LumenSection { at_mm: Some(at), ..section }
        };
        at_mm.par_iter().map(section).collect()
    }

    /// The outline of a branch's lumen in a plane, in the plane's coordinates, or why there is none.
    pub(super) fn lumen(
        &self,
        world_from_plane: &Pose,
        branch: u32,
    ) -> std::result::Result<SectionOutline, String> {
        let found = self.outline(world_from_plane, Choice::OfBranch(branch));
        found.map(|(outline, ..)| outline).map_err(|missing| missing.remark)
    }

    /// Where another branch opens into this one, mm along its axis, and which: where outlines run into it, and beside that as
    /// far as the area grows towards it.
    fn mouths(&self, axis: &VesselAxis, branch: u32) -> Vec<([f64; 2], u32)> {
        /// Distance of the planes, in diameters; least growth of the area per diameter; farthest from the others' outlines.
        const STEP: f64 = 0.05;
        const GROWTH: f64 = 0.25;
        const REACH: f64 = 1.0;
        if self.tree.is_none_or(|tree| tree.axes.len() < 2) {
            return Vec::new();
        }
        let diameter = 2.0 * self.radius_mm.get(branch as usize).copied().unwrap_or(0.0);
        let Ok(at) = places(0.0, axis.length_mm(), (STEP * diameter).max(axis.length_mm() / 1e4)) else {
            return Vec::new();
        };
        let area = |&at: &f64| {
            self.outline(&axis.pose(at), Choice::OfBranch(branch)).map(|found| found.0.area_mm2())
        };
        let areas: Vec<_> = at.par_iter().map(area).collect();
        let runs_into = |k: usize| areas[k].as_ref().err().and_then(|missing| missing.other);
        let mut mouths: Vec<([f64; 2], u32)> = Vec::new();
        let mut k = 0;
        while k < at.len() {
            let Some(other) = runs_into(k) else {
                k += 1;
                continue;
            };
            let first = k;
            while k < at.len() && areas[k].is_err() {
                k += 1;
            }
            let grows = |near: usize, far: usize| match (&areas[near], &areas[far]) {
                (Ok(a), Ok(b)) => (a - b) / b * diameter / (at[near] - at[far]).abs() > GROWTH,
                _ => false,
            };
            let (mut low, mut high) = (first, k - 1);
            let in_reach = |k: usize, of: usize| (at[k] - at[of]).abs() <= REACH * diameter;
            while low > 0 && in_reach(low - 1, first) && (low == first || grows(low, low - 1)) {
                low -= 1;
            }
            while high + 1 < at.len() && in_reach(high + 1, k - 1) && (high == k - 1 || grows(high, high + 1))
            {
                high += 1;
            }
            mouths.push(([at[low], at[high]], other));
        }
        mouths
    }

    /// Areas as [`across`](Self::across) has them, mm²; NaN where there is none.
    pub(super) fn areas_mm2(&self, axis: &VesselAxis, branch: u32, at_mm: &[f64]) -> Vec<f64> {
        let area = |&at: &f64| {
            let lumen = self.lumen(&axis.pose(at), branch);
            lumen.map_or(f64::NAN, |outline| outline.area_mm2())
        };
        at_mm.par_iter().map(area).collect()
    }

    /// Distance from a point to the wall, mm.
    pub(super) fn wall_distance_mm(&self, point_mm: DVec3) -> f64 {
        self.locator.distance_mm(point_mm)
    }

    fn outline(
        &self,
        pose: &Pose,
        choice: Choice,
    ) -> std::result::Result<(SectionOutline, Vec<OnEdge>, Option<String>), Missing> {
        let mut cut = self.cutter.cut(pose);
        let away: Vec<f64> = cut
            .outlines
            .iter()
            .map(|outline| match outline.contains(DVec2::ZERO) {
                true => 0.0,
                false => outline.distance_mm(DVec2::ZERO),
            })
            .collect();
        let Some(nearest) = (0..away.len()).min_by(|&a, &b| away[a].total_cmp(&away[b])) else {
            return Err(Missing::because(match cut.open {
                0 => "the plane misses the mesh".into(),
                _ => "the outline is open: the wall has a hole there".into(),
            }));
        };
        let (outline, on_edges) = (cut.outlines.swap_remove(nearest), cut.on_edges.swap_remove(nearest));
        let off = away[nearest];
        let Choice::OfBranch(branch) = choice else {
            let remark = (off > 0.0).then(|| format!("the outline is {off:.2} mm from the probe"));
            return Ok((outline, on_edges, remark));
        };
        if off > (outline.area_mm2() / PI).sqrt() {
            return Err(Missing::because(match cut.open {
                0 => format!("no outline about the axis: the nearest is {off:.2} mm away"),
                _ => "the outline is open: the wall has a hole there".into(),
            }));
        }
        match self.tree.and_then(|tree| self.other_branch(tree, branch, pose, &outline, &on_edges)) {
            Some(other) => {
                Err(Missing { remark: format!("the outline runs into branch {other}"), other: Some(other) })
            }
            None => Ok((outline, on_edges, None)),
        }
    }

    /// Another branch whose lumen an outline holds too: the outline lies on its nodes, or its axis passes the plane within the
    /// outline and a tube about it reaches beyond the wall that is nearest to this branch's axis.
    fn other_branch(
        &self,
        tree: &VesselTree,
        branch: u32,
        pose: &Pose,
        outline: &SectionOutline,
        on_edges: &[OnEdge],
    ) -> Option<u32> {
        let others = on_edges.iter().flat_map(|on| on.nodes).map(|n| tree.node_branch[n as usize]);
        if let Some(other) = others.filter(|&other| other != branch).max() {
            return Some(other);
        }
        let plane_from_world = pose.inverse();
        let wall = outline.distance_mm(DVec2::ZERO);
        let passes = |axis: &VesselAxis, radius_mm: f64| {
            let points: Vec<DVec3> =
                axis.points_mm().iter().map(|&p| plane_from_world.transform_point(p)).collect();
            points.windows(2).filter(|pair| (pair[0].z < 0.0) != (pair[1].z < 0.0)).any(|pair| {
                let place = pair[0].truncate();
                place.length() + radius_mm > wall && outline.contains(place)
            })
        };
        (0..)
            .zip(&tree.axes)
            .find(|&(other, axis)| other != branch && passes(axis, self.radius_mm[other as usize]))
            .map(|(other, _)| other)
    }

    fn measure(&self, pose: &Pose, choice: Choice) -> LumenSection {
        let (outline, on_edges, remark) = match self.outline(pose, choice) {
            Ok(found) => found,
            Err(missing) => {
                return LumenSection { parting: missing.other, ..LumenSection::without(missing.remark) };
            }
        };
        let centroid = outline.centroid_mm();
        let chords = outline.chords();
        let feret = outline.feret();
        let [least, greatest] = chords.map_or([f64::NAN; 2], |chords| chords.map(|c| c.length_mm));
        let (sphere_centre, sphere_radius) = self.inscribed(pose, &outline);
        let area_mm2 = outline.area_mm2();
        let equivalent = 2.0 * (area_mm2 / PI).sqrt();
        let world = pose.transform_point(centroid.extend(0.0));
        let measures = Measures {
            area_mm2,
            perimeter_mm: outline.perimeter_mm(),
            least_diameter_mm: least,
            greatest_diameter_mm: greatest,
            equivalent_diameter_mm: equivalent,
            feret_diameter_mm: feret.length_mm,
            inscribed_diameter_mm: 2.0 * sphere_radius,
            eccentricity: (greatest - least) / greatest,
            x_mm: world.x,
            y_mm: world.y,
            z_mm: world.z,
        };
        let standard_errors = self.standard_error_mm.and_then(|of_node| {
            let error = |on: &OnEdge| PointError {
                standard_error_mm: on.value(of_node),
                reach_mm: self.error_reach_mm.map_or_else(|all| all, |reach| on.value(reach)),
            };
            let errors: Vec<PointError> = on_edges.iter().map(error).collect();
            let of = Outline::with_errors(&outline.points_mm, centroid, &errors)?;
            let area = of.error_of_area();
            let [least_error, greatest_error] = match chords {
                Some(chords) => chords.map(|chord| of.error_of_chord(chord.ends_mm)),
                None => [f64::NAN; 2],
            };
            let [across, up] = of.errors_of_centroid(area_mm2);
            let [x, y] = [pose.rotation.x_axis, pose.rotation.y_axis];
            let along = |world: fn(DVec3) -> f64| (world(x) * across).hypot(world(y) * up);
            Some(Measures {
                area_mm2: area,
                perimeter_mm: of.error_of_perimeter(),
                least_diameter_mm: least_error,
                greatest_diameter_mm: greatest_error,
                equivalent_diameter_mm: 2.0 * area / (PI * equivalent),
                feret_diameter_mm: of.error_of_chord(feret.ends_mm),
                inscribed_diameter_mm: of.error_of_circle(sphere_centre, sphere_radius),
                eccentricity: (least_error / greatest).hypot(least * greatest_error / greatest.powi(2)),
                x_mm: along(|v| v.x),
                y_mm: along(|v| v.y),
                z_mm: along(|v| v.z),
            })
        });
        let measured_share = self.measured.as_ref().map(|measured| {
            let is_measured = |on: &OnEdge| on.nodes.iter().all(|&n| measured[n as usize]);
            let points = &outline.points_mm;
            let edges = (0..points.len()).map(|i| (i, (i + 1) % points.len()));
            let length = |(i, j): (usize, usize)| points[i].distance(points[j]);
            let of_measured =
                edges.clone().filter(|&(i, j)| is_measured(&on_edges[i]) && is_measured(&on_edges[j]));
            of_measured.map(length).fold(0.0, |sum, l| sum + l) / edges.map(length).sum::<f64>()
        });
        LumenSection {
            measures,
            standard_errors,
            measured_share,
            remark,
            ..LumenSection::without(String::new())
        }
    }

    /// Centre, in the plane, and radius of the largest sphere within the wall whose centre lies in the plane inside the
    /// outline, mm.
    fn inscribed(&self, pose: &Pose, outline: &SectionOutline) -> (DVec2, f64) {
        /// Places across the outline where the search starts, in either direction.
        const STARTS: usize = 9;
        let points = &outline.points_mm;
        let low = points.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = points.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        let radius = |p: DVec2| match outline.contains(p) {
            true => self.locator.distance_mm(pose.transform_point(p.extend(0.0))),
            false => 0.0,
        };
        let grid = (0..STARTS * STARTS).map(|k| {
            let share = DVec2::new((k % STARTS) as f64, (k / STARTS) as f64) + 0.5;
            low + (high - low) * share / STARTS as f64
        });
        let better = |a: (DVec2, f64), b: (DVec2, f64)| if b.1 > a.1 { b } else { a };
        let start = grid.chain([outline.centroid_mm()]).map(|p| (p, radius(p)));
        let mut best = start.fold((outline.centroid_mm(), 0.0), better);
        let mut step = (high - low).max_element() / STARTS as f64;
        let smallest = 1e-5 * (high - low).max_element();
        while step > smallest {
            let around = (0..8).map(|k| best.0 + DVec2::from_angle(f64::from(k) * PI / 4.0) * step);
            let found = around.map(|p| (p, radius(p))).fold(best, better);
            if found.1 > best.1 {
                best = found;
            } else {
                step /= 2.0;
            }
        }
        best
    }
}

/// The places from `from_mm` to `to_mm` every `step_mm`, both ends among them.
///
/// # Errors
/// [`Error::Setting`] where the step is not positive or there are more than a million.
pub fn places(from_mm: f64, to_mm: f64, step_mm: f64) -> Result<Vec<f64>> {
    let count = (to_mm - from_mm) / step_mm;
    if !(step_mm > 0.0 && count.is_finite() && (0.0..1e6).contains(&count)) {
        let found = format!("{step_mm} mm from {from_mm} to {to_mm} mm");
        return Err(Error::setting("step", found, "a positive step and at most a million of them"));
    }
    let mut places: Vec<f64> = (0..=(count + 1e-9) as usize).map(|k| from_mm + step_mm * k as f64).collect();
    if places.last().is_some_and(|last| to_mm - last > 1e-6 * step_mm.max(1e-3)) {
        places.push(to_mm);
    }
    Ok(places)
}

/// Reads a value per frame, such as areas measured by hand: a table with a column `frame` and another of any name.
/// Frames without a value are left out.
///
/// # Errors
/// Where the file cannot be read, lacks a column, holds something else than numbers or names a frame twice.
pub fn read_values(path: &Path, column: &str) -> Result<BTreeMap<u64, f64>> {
    let mut table = Table::open(path)?;
    let (frame, value) = (table.column("frame")?, table.column_headed(column)?);
    let mut values = BTreeMap::new();
    while let Some(row) = table.next_row()? {
        let number = table.count(&row, frame)? as u64;
        if let Some(value) = table.optional_number(&row, value)?
            && values.insert(number, value).is_some()
        {
            return Err(table.fault(&row, frame, number, "each frame once"));
        }
    }
    if values.is_empty() {
        return Err(Error::input(path, column, "no values", "at least one"));
    }
    Ok(values)
}
