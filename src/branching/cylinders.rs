//! The published method in a vessel that branches.
//!
//! The cylinders of each branch are fitted to the frames of that branch and merged by themselves. Rays from the branch's
//! centreline to the merged vessel make a tube of it. The tubes are joined as those of sweeps are, and fitted to the echoes
//! where they meet: no cylinder describes the wall there.

use super::echoes::WorldEchoes;
use super::fit::{self, NodeSupport, TubeFit};
use super::join::{self, Joined, Origin};
use super::report::{BranchesTimings, CylinderBranchesReport};
use super::tree::BranchTree;
use super::tube::Tube;
use super::{nearest_node, part};
use crate::cylinders::merge::MergedVessel;
use crate::cylinders::{CylinderReconstruction, Engine, FittedCylinder};
use crate::geometry::polyline::{Searched, lengths, station};
use crate::numerics::robust::median;
use crate::recording::Recording;
use crate::settings::Settings;
use crate::surface::{RayCaster, Surface};
use crate::sweep::{Axis, BEYOND_RADII};
use crate::{Error, Result};
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::ops::{ControlFlow, RangeInclusive};
use std::time::Instant;

/// Bounds of the distance between the rings of a tube, in shares of the lumen's radius: no coarser than a mesh of a vessel
/// must be, no finer than pays where cylinders have very many nodes.
const COARSEST_RING: f64 = 0.25;
const FINEST_RING: f64 = 0.04;
/// Most nodes of a tube.
const MAX_NODES: usize = 50_000_000;
/// By how much flat triangles deviate from the wall, in edges: perfect echoes are no more precise than that.
const LEAST_NOISE_EDGES: f64 = 0.03;
/// The wall is looked for no farther away than so many lumen radii: beyond lies another part of the vessel.
const REACH_RADII: f64 = 3.0;

/// A vessel that branches: the cylinders of every branch, merged by themselves and joined to one surface.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BranchedCylinders {
    /// The branches that the catheter visited.
    pub tree: BranchTree,
    /// The cylinders of each branch and the vessel merged from them. Frames are numbered as in the recording.
    pub reconstructions: Vec<CylinderReconstruction>,
    /// The centreline of each branch, from where it leaves the wall of another.
    pub axes: Vec<Axis>,
    /// The reconstruction in numbers.
    pub report: CylinderBranchesReport,
    surface: Surface,
}

impl BranchedCylinders {
    /// Finds the branches of a recording, fits and merges the cylinders of each, and joins them. `None` where there is but
    /// one branch: [`CylinderReconstruction::of`] is for such. `history` and `progress` are as in
    /// [`CylinderReconstruction::run`].
    ///
    /// # Errors
    /// As [`CylinderReconstruction::of`], and where the branches cannot be joined.
    pub fn of(
        recording: &Recording,
        settings: &Settings,
        engine: &dyn Engine,
        history: bool,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<Option<Self>> {
        settings.validate()?;
        recording.check()?;
        let start = Instant::now();
        let mut tree = BranchTree::of(&recording.frames, &settings.calibration.sensor_from_probe());
        let tree_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let mut branches = loop {
            if tree.is_single() {
                return Ok(None);
            }
            match fitted(recording, &tree, settings, engine, history, progress)? {
                Ok(branches) => break branches,
                Err((number, why)) => {
                    tree = tree.without(number, format!("it has no vessel of cylinders: {why}"));
                }
            }
        };
        let branches_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        for (branch, path) in branches.iter_mut().zip(&tree.branches) {
            branch.inner_ends = path.joined_along(&branch.axis);
        }
        let inner_ends: Vec<[Option<usize>; 2]> = branches.iter().map(|branch| branch.inner_ends).collect();
        let mut tubes: Vec<Tube> = branches.iter().map(Branch::tube).collect();
        let mut joined =
            join::joined(&mut tubes, &inner_ends, &|_, _| true).map_err(|error| match error {
                Error::Surface { what, found, .. } => Error::Surface {
                    what: format!("joined branches: {what}"),
                    found,
                    expected: "branches that meet in one surface; with branches = off there is one tube"
                        .into(),
                },
                other => other,
            })?;
        let axes = tubes.iter().map(|tube| {
            let rings = tube.rings.clone();
            Axis {
                points_mm: tube.axis.points_mm[rings.clone()].to_vec(),
                frames: tube.axis.frames[rings].to_vec(),
                step_mm: tube.axis.step_mm,
            }
        });
        let axes: Vec<Axis> = axes.collect();
        let join_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let noise_mm: Vec<f64> = branches.iter().map(Branch::noise_mm).collect();
        let unsupported: Vec<Vec<bool>> = tubes.iter().map(|tube| vec![false; tube.radii_mm.len()]).collect();
        let fits = noise_mm.iter().zip(&unsupported).map(|(&noise_mm, supported)| TubeFit {
            noise_mm,
            along_wall_mm: 0.0,
            smoothness_mm2: (noise_mm / settings.sweep.roughness).powi(2),
            standard_error_mm: &[],
            supported,
        });
        let fits: Vec<TubeFit> = fits.collect();
        let echoes = WorldEchoes::of(recording, settings, |k| tree.frame_branch[k].is_some());
        let support = fit::fit(&mut joined, &tubes, &fits, &echoes)?;
        let unsewn = joined.unsewn;
        let surface = with_arrays(joined, &tubes, &branches, &support);
        let reconstructions: Vec<CylinderReconstruction> =
            branches.into_iter().map(|branch| branch.reconstruction).collect();
        let fit_s = start.elapsed().as_secs_f64();
        let seconds = BranchesTimings { tree: tree_s, branches: branches_s, join: join_s, fit: fit_s };
        let report =
            CylinderBranchesReport::of(recording, &tree, &reconstructions, &axes, &surface, unsewn, seconds);
        Ok(Some(Self { tree, reconstructions, axes, report, surface }))
    }

    /// The vessel as one triangle surface, normals outward, open at its ends. Arrays: `support`, `residual_mm` and `frame`
    /// of the nearest node of the branch's own vessel, [`MergedVessel::surface`]; where branches meet, of the echoes nearest to
    /// the node, and the root mean square of their distances. And `branch`: the place in [`BranchTree::branches`].
    pub fn surface(&self) -> &Surface {
        &self.surface
    }
}

/// The vessel of one branch, and the tube that its centreline sees of it.
struct Branch {
    reconstruction: CylinderReconstruction,
    /// The surface of its vessel.
    vessel: Surface,
    axis: Axis,
    /// Nodes per ring.
    nodes: usize,
    /// Of each node of the tube's grid: the distance of the vessel's wall, mm, and the nearest node of the vessel there.
    radii_mm: Vec<f64>,
    seen: Vec<Option<u32>>,
    /// The rings that see the vessel all around.
    rings: RangeInclusive<usize>,
    inner_ends: [Option<usize>; 2],
}

/// The branches of a tree, or the number of one that has no vessel and why.
fn fitted(
    recording: &Recording,
    tree: &BranchTree,
    settings: &Settings,
    engine: &dyn Engine,
    history: bool,
    progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
) -> Result<std::result::Result<Vec<Branch>, (usize, String)>> {
    let cylinders = |number: usize| tree.branches[number].frames / settings.every as usize;
    let all = (0..tree.branches.len()).map(cylinders).sum();
    let (mut branches, mut before) = (Vec::new(), 0);
    // Small branches first: what has no vessel is known early.
    for number in (0..tree.branches.len()).rev() {
        let frames = tree.frames_of(number);
        let tell = |done: usize, _: usize| progress(before + done, all);
        match Branch::of(&part(recording, &frames), settings, engine, history, &tell) {
            Ok(mut branch) => {
                branch.number_frames(&frames);
                branches.push(branch);
            }
            Err(
                why @ (Error::Recording { .. }
                | Error::Surface { .. }
                | Error::Frame { .. }
                | Error::Setting { .. }),
            ) if number > 0 => return Ok(Err((number, why.to_string()))),
            Err(Error::Frame { frame, field, found, expected }) => {
                return Err(Error::Frame { frame: frames[frame], field, found, expected });
            }
            Err(error) => return Err(error),
        }
        before += cylinders(number);
    }
    branches.reverse();
    Ok(Ok(branches))
}

impl Branch {
    /// Of the frames of one branch alone: no cylinder's section has points of another branch.
    fn of(
        part: &Recording,
        settings: &Settings,
        engine: &dyn Engine,
        history: bool,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<Self> {
        let mut reach_mm = 0.0;
        let mut nodes = 0;
        let level_mm = settings.height_mm / f64::from(settings.levels);
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let axis = Axis::through(&part.frames, &sensor_from_probe, |radius_mm| {
            reach_mm = REACH_RADII * radius_mm;
            let edge_mm = level_mm.min(TAU * radius_mm / f64::from(settings.nodes));
            let step_mm = edge_mm.clamp(FINEST_RING * radius_mm, COARSEST_RING * radius_mm);
            nodes = (TAU * radius_mm / step_mm).ceil() as usize;
            // A cylinder about the last contour goes on by half its height.
            [step_mm, (BEYOND_RADII * radius_mm).max(settings.height_mm / 2.0 + 2.0 * step_mm)]
        })?;
        if axis.rings().saturating_mul(nodes) > MAX_NODES {
            return Err(Error::Surface {
                what: "nodes of a branch".into(),
                found: format!("{} rings of {nodes}", axis.rings()),
                expected: format!(
                    "at most {MAX_NODES} nodes: a shorter centreline, or longer levels of the cylinders"
                ),
            });
        }
        let merged = |cylinders: &[FittedCylinder]| merged_along(&axis, cylinders, settings);
        let reconstruction =
            CylinderReconstruction::merged_by(merged, part, settings, engine, history, progress)?;
        let vessel = reconstruction.vessel.surface();
        let (radii_mm, seen): (Vec<f64>, Vec<Option<u32>>) =
            seen_from(&axis, nodes, &vessel, reach_mm)?.into_iter().unzip();
        let mut complete = (0..axis.rings())
            .filter(|ring| seen[ring * nodes..(ring + 1) * nodes].iter().all(Option::is_some));
        let rings = complete.next().zip(complete.next_back()).map(|(first, last)| first..=last);
        let Some(rings) = rings.filter(|rings| rings.end() - rings.start() >= 4) else {
            return Err(Error::Surface {
                what: "vessel about the centreline".into(),
                found: "hardly a ring of it that is closed".into(),
                expected: "a wall all around the contours' centres".into(),
            });
        };
        let mut branch =
            Self { reconstruction, vessel, axis, nodes, radii_mm, seen, rings, inner_ends: [None; 2] };
        branch.fill();
        Ok(branch)
    }

    /// Gives the nodes that see no wall a radius: between those before and after them along the axis, and that of the last
    /// one beyond the ends of the wall.
    fn fill(&mut self) {
        let (first, last) = (*self.rings.start(), *self.rings.end());
        let count = self.axis.rings();
        for j in 0..self.nodes {
            let at = |ring: usize| ring * self.nodes + j;
            let seen: Vec<usize> = (first..=last).filter(|&ring| self.seen[at(ring)].is_some()).collect();
            for pair in seen.windows(2) {
                let [low, high] = [pair[0], pair[1]];
                let (from, to) = (self.radii_mm[at(low)], self.radii_mm[at(high)]);
                for ring in low + 1..high {
                    let share = (ring - low) as f64 / (high - low) as f64;
                    self.radii_mm[at(ring)] = from + (to - from) * share;
                }
            }
            // Where the wall has ended, a ray may still meet another part of it.
            let beyond: [Vec<usize>; 2] = [(0..first).rev().collect(), (last + 1..count).collect()];
            for (mut outermost, rings) in [first, last].into_iter().zip(beyond) {
                for ring in rings {
                    if self.seen[at(ring)].is_some() && outermost.abs_diff(ring) == 1 {
                        outermost = ring;
                    } else {
                        self.radii_mm[at(ring)] = self.radii_mm[at(outermost)];
                        self.seen[at(ring)] = None;
                    }
                }
            }
        }
    }

    /// The tube of its wall. At an end that lies in another branch it is as long as the axis, so that it reaches into it.
    fn tube(&self) -> Tube<'_> {
        let first = if self.inner_ends[0].is_some() { 0 } else { *self.rings.start() };
        let last = if self.inner_ends[1].is_some() { self.axis.rings() - 1 } else { *self.rings.end() };
        Tube::new(&self.axis, self.nodes, self.radii_mm.clone(), first..=last)
    }

    /// Standard deviation of the points about the vessel, mm, from their mean distances.
    fn noise_mm(&self) -> f64 {
        /// Of a normal distribution, the standard deviation in mean deviations.
        const SD_PER_MEAN_DEVIATION: f64 = 1.2533;
        let residuals = self.vessel.array("residual_mm").unwrap_or_default();
        let mut known: Vec<f64> = residuals.iter().copied().filter(|mm| mm.is_finite()).collect();
        (SD_PER_MEAN_DEVIATION * median(&mut known)).max(LEAST_NOISE_EDGES * self.axis.step_mm)
    }

    /// Numbers the frames as in the recording instead of among those of the branch.
    fn number_frames(&mut self, frames: &[usize]) {
        let CylinderReconstruction { cylinders, vessel, report, .. } = &mut self.reconstruction;
        cylinders.iter_mut().for_each(|cylinder| cylinder.frame = frames[cylinder.frame]);
        vessel.rings.iter_mut().for_each(|ring| ring.frame = frames[ring.frame]);
        report.cylinders_left_out.iter_mut().for_each(|left_out| left_out.place = frames[left_out.place]);
        self.vessel = vessel.surface();
    }
}

/// Merges the cylinders of a branch in the order in which they lie along it: stitching assumes that the probe advances,
/// and a branch is left the way that it was entered.
fn merged_along(axis: &Axis, cylinders: &[FittedCylinder], settings: &Settings) -> MergedVessel {
    let along_mm = lengths(&axis.points_mm);
    let line = Searched::of(&axis.points_mm);
    let station_mm = |cylinder: &FittedCylinder| {
        station(&axis.points_mm, &along_mm, line.nearest(cylinder.world_from_cylinder.translation_mm))
    };
    let mut placed: Vec<(f64, &FittedCylinder)> = cylinders.iter().map(|c| (station_mm(c), c)).collect();
    // Against the axis where the cylinders point so.
    let ahead = |(station_mm, cylinder): &(f64, &FittedCylinder)| {
        let ring = along_mm.partition_point(|along| along < station_mm).min(axis.rings() - 1);
        cylinder.world_from_cylinder.rotation.x_axis.dot(axis.frames[ring].z_axis)
    };
    let sense = if placed.iter().map(ahead).sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
    placed.sort_by(|a, b| (sense * a.0).total_cmp(&(sense * b.0)));
    MergedVessel::of(placed.into_iter().map(|(_, cylinder)| cylinder), settings.merge)
}

/// Of each node of a grid about an axis: the distance at which its ray meets the vessel, mm, and the vessel's nearest node
/// there.
fn seen_from(axis: &Axis, nodes: usize, vessel: &Surface, reach_mm: f64) -> Result<Vec<(f64, Option<u32>)>> {
    let caster = RayCaster::new(vessel)?;
    let look = |node: usize| {
        let (ring, theta_rad) = (node / nodes, TAU * (node % nodes) as f64 / nodes as f64);
        let origin = axis.points_mm[ring];
        let direction = axis.point_mm(ring, theta_rad, 1.0) - origin;
        let Some((triangle, radius_mm)) = caster.cast(origin, direction, reach_mm) else {
            return (0.0, None);
        };
        let there = origin + direction * radius_mm;
        let squared = |n: &u32| vessel.nodes_mm[*n as usize].distance_squared(there);
        let corners = vessel.triangles[triangle as usize].into_iter();
        (radius_mm, corners.min_by(|a, b| squared(a).total_cmp(&squared(b)).then(a.cmp(b))))
    };
    Ok((0..axis.rings() * nodes).into_par_iter().map(look).collect())
}

/// The joined surface with the arrays of the branches' own vessels, and `branch`.
fn with_arrays(
    joined: Joined,
    tubes: &[Tube],
    branches: &[Branch],
    support: &[Option<NodeSupport>],
) -> Surface {
    let Joined { mut surface, origin, .. } = joined;
    let of: Vec<(usize, Option<u32>)> = origin
        .iter()
        .map(|origin| {
            let (tube, node) = match *origin {
                Origin::Grid { tube, node } => (tube, node),
                Origin::Parting { tube, spot } => (tube, nearest_node(&tubes[tube], &spot)),
            };
            (tube, branches[tube].seen[node])
        })
        .collect();
    let mut array = |name: &str, unseen: f64, of_parting: &dyn Fn(&NodeSupport) -> f64| {
        let values: Vec<&[f64]> =
            branches.iter().map(|branch| branch.vessel.array(name).unwrap_or_default()).collect();
        let value = |(&(tube, node), at): (&(usize, Option<u32>), &Option<NodeSupport>)| match (at, node) {
            (Some(at), _) => of_parting(at),
            (None, Some(node)) => values[tube].get(node as usize).copied().unwrap_or(unseen),
            (None, None) => unseen,
        };
        surface.set_array(name, of.iter().zip(support).map(value).collect());
    };
    array("support", 0.0, &|at| at.echoes);
    array("residual_mm", f64::NAN, &|at| at.residual_mm);
    array("frame", f64::NAN, &|at| at.last_frame.map_or(f64::NAN, f64::from));
    surface.set_array("branch", of.iter().map(|&(tube, _)| tube as f64).collect());
    surface
}
