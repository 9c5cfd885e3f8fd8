//! Vessels that branch (`docs/method.md`, section "Branches").
//!
//! `tree` finds the branches that the catheter visited and the frames of each; every branch is swept by itself; `join`
//! makes one surface of the tubes, and `fit` fits it to the echoes where they meet. `cylinders` does the same by the
//! published method.

mod cylinders;
mod echoes;
mod fit;
mod join;
mod mouths;
mod plate;
mod report;
mod tree;
mod tube;

pub use cylinders::BranchedCylinders;
pub use mouths::Mouth;
pub use report::{
    BranchReport, BranchesReport, BranchesTimings, CylinderBranchReport, CylinderBranchesReport,
};
pub use tree::{BranchPath, BranchTree, Dismissed};

use crate::recording::Recording;
use crate::settings::{FrameShifts, Settings};
use crate::surface::Surface;
use crate::sweep::{Outlines, StageProgress, StateError, Support, Sweep, WallDevice};
use crate::{Error, Result};
use echoes::WorldEchoes;
use fit::{NodeSupport, TubeFit};
use glam::DVec3;
use join::{Joined, Origin};
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use tube::{Spot, Tube};

/// Parts of the supported surface with a smaller share of its triangles than this are islands beyond an end.
const LEAST_PART: f64 = 0.01;

/// A vessel that branches: a sweep of every branch, joined to one surface.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BranchedSweep {
    /// The branches that the catheter visited.
    pub tree: BranchTree,
    /// The sweep of each branch. Frames are numbered as in the recording.
    pub sweeps: Vec<Sweep>,
    /// The mouths of branches that were seen but not entered.
    pub mouths: Vec<Mouth>,
    /// The reconstruction in numbers.
    pub report: BranchesReport,
    whole: Surface,
    supported: Surface,
}

impl BranchedSweep {
    /// Finds the branches of a recording, sweeps each and joins them. `None` where there is but one: [`Sweep::of`] is for
    /// such. `progress` is called as by [`Sweep::run`], with the stages of all branches.
    ///
    /// # Errors
    /// As [`Sweep::of`].
    pub fn of(recording: &Recording, settings: &Settings, progress: &StageProgress) -> Result<Option<Self>> {
        recording.check()?;
        let outlines = Outlines::of(&recording.frames);
        Self::with_device(recording, &outlines, settings, progress, &WallDevice::default())
    }

    /// As [`BranchedSweep::of`], of a recording whose contours have these outlines; where a device fits walls it is this one.
    pub(crate) fn with_device(
        recording: &Recording,
        outlines: &Outlines,
        settings: &Settings,
        progress: &StageProgress,
        device: &WallDevice,
    ) -> Result<Option<Self>> {
        settings.validate()?;
        recording.check()?;
        let start = Instant::now();
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let mut tree = BranchTree::with_outlines(&recording.frames, outlines, &sensor_from_probe);
        let tree_s = outlines.seconds + start.elapsed().as_secs_f64();
        let start = Instant::now();
        // A branch that cannot be swept, such as one that was hardly entered, is none.
        let mut sweeps = loop {
            if tree.is_single() {
                return Ok(None);
            }
            match swept(recording, outlines, &tree, settings, progress, device)? {
                Ok(sweeps) => break sweeps,
                Err((number, why)) => tree = tree.without(number, format!("it cannot be swept: {why}")),
            }
        };
        let branches_s = start.elapsed().as_secs_f64();
        for (number, sweep) in sweeps.iter_mut().enumerate() {
            let frames = tree.frames_of(number);
            for last in sweep.support.last_frame.iter_mut().flatten() {
                *last = frames[*last as usize] as u32;
            }
        }
        let start = Instant::now();
        let mut tubes: Vec<Tube> = sweeps.iter().map(Tube::of).collect();
        let inner_ends: Vec<[Option<usize>; 2]> = tree
            .branches
            .iter()
            .zip(&sweeps)
            .map(|(branch, sweep)| branch.joined_along(&sweep.axis))
            .collect();
        let is_supported = |tube: usize, node: usize| sweeps[tube].support.supported[node];
        let mut joined = join::joined(&mut tubes, &inner_ends, &is_supported)?;
        let join_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let fits: Vec<TubeFit> = sweeps.iter().map(tube_fit).collect();
        let echoes = WorldEchoes::of(recording, settings, |k| tree.frame_branch[k].is_some());
        let support = fit::fit(&mut joined, &tubes, &fits, &echoes)?;
        let unsewn = joined.unsewn;
        let of_tubes: Vec<Vec<(DVec3, bool)>> = sweeps.iter().map(flattened).collect();
        let flat = joined.origin.iter().zip(&joined.surface.nodes_mm).map(|(origin, &p)| match *origin {
            Origin::Grid { tube, node } => of_tubes[tube][node],
            Origin::Parting { .. } => (p, false),
        });
        let flat = flat.collect();
        let mut whole = with_arrays(joined, &tubes, &sweeps, &support);
        let of: Vec<&Sweep> = sweeps.iter().collect();
        let mouths = open_mouths(&mut whole, flat, &of, &echoes)?;
        let fit_s = start.elapsed().as_secs_f64();
        let seconds = BranchesTimings { tree: tree_s, branches: branches_s, join: join_s, fit: fit_s };
        let supported = supported_part(&whole);
        let report = BranchesReport::of(recording, &tree, &sweeps, [&whole, &supported], unsewn, seconds);
        Ok(Some(Self { tree, sweeps, mouths, report, whole, supported }))
    }

    /// As [`Sweep::add_error`].
    pub(crate) fn add_error(&mut self, error: &StateError) {
        self.sweeps.iter_mut().for_each(|sweep| sweep.add_error(error));
        let normals = self.whole.node_normals();
        let array = |name: &str| self.whole.array(name).unwrap_or_default();
        let of_node = array("standard_error_mm").iter().zip(array("branch")).zip(normals);
        let with_error = of_node.map(|((standard_mm, branch), normal)| {
            let radius_mm = self.sweeps[*branch as usize].report.contour_radius_mm;
            standard_mm.hypot(error.variance_mm2(normal, radius_mm).sqrt())
        });
        let with_error = with_error.collect();
        self.whole.set_array("standard_error_mm", with_error);
        self.supported = supported_part(&self.whole);
    }

    /// The vessel as one triangle surface, normals outward, open at its ends; without the nodes that are not supported,
    /// and parts of less than 1 % of the triangles that this cuts off, unless `keep_unsupported`. Arrays as those of [`Sweep::surface`], and `branch`: the place in [`BranchTree::branches`].
    /// Away from partings the nodes are those of the branches' own grids.
    pub fn surface(&self, keep_unsupported: bool) -> Surface {
        if keep_unsupported { self.whole.clone() } else { self.supported.clone() }
    }
}

/// Finds the mouths in the wall of a single sweep; its nodes within them are no longer supported.
///
/// # Errors
/// [`Error::Surface`] where the sweep's wall is no surface.
pub(crate) fn open_mouths_of(
    recording: &Recording,
    settings: &Settings,
    sweep: &mut Sweep,
) -> Result<Vec<Mouth>> {
    let flat = flattened(sweep);
    if sweep.report.off_wall == 0 && !flat.iter().any(|(_, is_bulging)| *is_bulging) {
        return Ok(Vec::new());
    }
    let is_folded = |k: usize| sweep.report.folded_frames.contains(&recording.number(k));
    let echoes = WorldEchoes::of(recording, settings, |k| !is_folded(k));
    let mut whole = sweep.surface(true);
    let mouths = open_mouths(&mut whole, flat, &[sweep], &echoes)?;
    if let Some(supported) = whole.array("supported").filter(|_| !mouths.is_empty()) {
        let is_supported = supported.iter().map(|&is| is > 0.5);
        sweep.support.supported = is_supported.collect();
        sweep.report.supported = sweep.support.supported.iter().filter(|is| **is).count();
    }
    Ok(mouths)
}

/// The nodes of a sweep's wall without its bulges, mm, and whether each is moved.
fn flattened(sweep: &Sweep) -> Vec<(DVec3, bool)> {
    let tube = Tube::of(sweep);
    let radii = mouths::flattened(&tube, sweep.report.contour_radius_mm, sweep.report.noise_mm);
    let place = |(node, (radius_mm, moved)): (usize, (f64, bool))| {
        let theta_rad = TAU * (node % sweep.nodes) as f64 / sweep.nodes as f64;
        (sweep.axis.point_mm(node / sweep.nodes, theta_rad, radius_mm), moved)
    };
    radii.into_iter().enumerate().map(place).collect()
}

/// Finds the mouths in a whole wall, which is `flat` without its bulges; its nodes within them are no longer supported.
fn open_mouths(
    whole: &mut Surface,
    flat: Vec<(DVec3, bool)>,
    sweeps: &[&Sweep],
    echoes: &WorldEchoes,
) -> Result<Vec<Mouth>> {
    let nodes = whole.nodes_mm.len();
    let (nodes_mm, is_bulging) = flat.into_iter().unzip();
    let surface = Surface { nodes_mm, triangles: whole.triangles.clone(), arrays: Vec::new() };
    let wall = mouths::Wall {
        surface: &surface,
        swept_mm: &whole.nodes_mm,
        is_bulging,
        branch: whole
            .array("branch")
            .map_or_else(|| vec![0; nodes], |of| of.iter().map(|&branch| branch as usize).collect()),
        noise_mm: sweeps.iter().map(|sweep| sweep.report.noise_mm).collect(),
        radius_mm: sweeps.iter().map(|sweep| sweep.report.contour_radius_mm).collect(),
        along_mm: sweeps.iter().map(|sweep| sweep.along_wall_mm()).collect(),
    };
    let (mouths, within): (Vec<Mouth>, Vec<Vec<u32>>) = mouths::find(&wall, echoes)?.into_iter().unzip();
    if !mouths.is_empty() {
        let mut supported = whole.array("supported").unwrap_or_default().to_vec();
        within.into_iter().flatten().for_each(|node| supported[node as usize] = 0.0);
        whole.set_array("supported", supported);
    }
    Ok(mouths)
}

/// The supported nodes of a joined surface, but small parts of them.
fn supported_part(whole: &Surface) -> Surface {
    let supported = whole.array("supported").unwrap_or_default();
    let mut part = whole.clone();
    part.triangles.retain(|t| t.iter().all(|&n| supported[n as usize] > 0.5));
    part.with_touching_parts_split().without_small_parts(LEAST_PART).without_loose_nodes()
}

/// Some frames of a recording, with their numbers there.
fn part(recording: &Recording, frames: &[usize]) -> Recording {
    let frames = frames.iter().map(|&k| recording.frames[k].clone().with_number(Some(recording.number(k))));
    Recording { frames: frames.collect() }
}

/// The sweeps of all branches, or the number of one that has none and why.
fn swept(
    recording: &Recording,
    outlines: &Outlines,
    tree: &BranchTree,
    settings: &Settings,
    progress: &StageProgress,
    device: &WallDevice,
) -> Result<std::result::Result<Vec<Sweep>, (usize, String)>> {
    // Where branches meet, the surface is fitted to the echoes of all as they were recorded.
    let settings =
        &Settings { sweep: settings.sweep.with_frame_shifts(FrameShifts::Off), ..settings.clone() };
    let count = tree.branches.len();
    let reached: Vec<AtomicUsize> = (0..count).map(|_| AtomicUsize::new(0)).collect();
    let sweep = |number: usize| {
        let frames = tree.frames_of(number);
        let (part, outlines) = (part(recording, &frames), outlines.part(&frames));
        let tell = |stage: &'static str, done: usize, total: usize| -> ControlFlow<()> {
            reached[number].fetch_max(done, Ordering::Relaxed);
            let done = reached.iter().map(|reached| reached.load(Ordering::Relaxed)).sum();
            progress(stage, done, count * total)
        };
        Sweep::run_with(&part, outlines, settings, &tell, device)
    };
    let found: Vec<Result<Sweep>> = (0..count).into_par_iter().map(sweep).collect();
    let mut sweeps = Vec::new();
    // Of several branches that cannot be swept the smallest goes first.
    for (number, sweep) in found.into_iter().enumerate().rev() {
        match sweep {
            Ok(sweep) => sweeps.push(sweep),
            Err(why @ (Error::Recording { .. } | Error::Surface { .. } | Error::Frame { .. }))
                if number > 0 =>
            {
                return Ok(Err((number, why.to_string())));
            }
            Err(Error::Frame { frame, field, found, expected }) => {
                return Err(Error::Frame { frame: tree.frames_of(number)[frame], field, found, expected });
            }
            Err(error) => return Err(error),
        }
    }
    sweeps.reverse();
    Ok(Ok(sweeps))
}

fn tube_fit(sweep: &Sweep) -> TubeFit<'_> {
    TubeFit {
        noise_mm: sweep.report.noise_mm,
        along_wall_mm: sweep.along_wall_mm(),
        smoothness_mm2: sweep.report.smoothness_mm2,
        standard_error_mm: &sweep.support.standard_error_mm,
        supported: &sweep.support.supported,
    }
}

/// The node of a tube's grid nearest to a place on its wall.
fn nearest_node(tube: &Tube, spot: &Spot) -> usize {
    let ring = (spot.ring.round() as usize).min(tube.axis.rings() - 1);
    let j = (spot.theta_rad / TAU * tube.nodes as f64).round() as usize % tube.nodes;
    ring * tube.nodes + j
}

/// The joined surface with the arrays of the sweeps' own surfaces, and `branch`.
fn with_arrays(joined: Joined, tubes: &[Tube], sweeps: &[Sweep], support: &[Option<NodeSupport>]) -> Surface {
    let Joined { mut surface, origin, .. } = joined;
    let nearest = |origin: &Origin| match *origin {
        Origin::Grid { tube, node } => (tube, node),
        Origin::Parting { tube, spot } => (tube, nearest_node(&tubes[tube], &spot)),
    };
    let of: Vec<(usize, usize)> = origin.iter().map(nearest).collect();
    let mut array =
        |name, of_grid: &dyn Fn(&Support, usize) -> f64, of_parting: &dyn Fn(&NodeSupport) -> f64| {
            let value = |(&(tube, node), at): (&(usize, usize), &Option<NodeSupport>)| match at {
                Some(at) => of_parting(at),
                None => of_grid(&sweeps[tube].support, node),
            };
            surface.set_array(name, of.iter().zip(support).map(value).collect());
        };
    let frame = |last: Option<u32>| last.map_or(f64::NAN, f64::from);
    let flag = |is: bool| f64::from(u8::from(is));
    array("support", &|s, n| f64::from(s.echoes[n]), &|at| at.echoes);
    array("residual_mm", &|s, n| s.residual_mm[n], &|at| at.residual_mm);
    array("standard_error_mm", &|s, n| s.standard_error_mm[n], &|at| at.standard_error_mm);
    array("frame", &|s, n| frame(s.last_frame[n]), &|at| frame(at.last_frame));
    array("supported", &|s, n| flag(s.supported[n]), &|at| flag(at.supported));
    let reach = |&(tube, node): &(usize, usize)| sweeps[tube].support.error_reach_mm[node];
    surface.set_array("error_reach_mm", of.iter().map(reach).collect());
    surface.set_array("branch", of.iter().map(|&(tube, _)| tube as f64).collect());
    surface
}
