//! A branching vessel in numbers.

use super::tree::{BranchPath, BranchTree, Dismissed};
use crate::cylinders::{CylinderReconstruction, CylindersReport};
use crate::recording::Recording;
use crate::surface::crossing::crossings;
use crate::surface::{Surface, Topology};
use crate::sweep::{Axis, Sweep, SweepReport};
use glam::DVec3;
use serde::Serialize;

/// A branching vessel in numbers.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct BranchesReport {
    /// The branches; the first is that in which the recording begins.
    pub branches: Vec<BranchReport>,
    /// What looked like a branch and is none.
    pub dismissed: Vec<Dismissed>,
    /// Frames of the recording.
    pub frames: usize,
    /// Frames with echoes that belong to no branch, since their contours are not star-shaped about their centres or enclose
    /// no area.
    pub frames_left_out: Vec<usize>,
    /// Nodes of the joined surface, supported or not.
    pub nodes: usize,
    /// Supported nodes.
    pub supported: usize,
    /// Rings of the branches' grids that could not be sewn to the surface of a parting: it is open there.
    pub unsewn: usize,
    /// How the triangles with supported nodes are connected.
    pub topology: Topology,
    /// Time of each stage; those of a branch's sweep are in its own report.
    pub seconds: BranchesTimings,
}

/// A branch in numbers.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct BranchReport {
    /// The branch from which it was entered, as a place in [`BranchesReport::branches`]; `None` for the first.
    pub parent: Option<usize>,
    /// Where it meets that, mm; `None` for the first.
    pub parting_mm: Option<DVec3>,
    /// Why it is taken for a branch.
    pub reason: String,
    /// Its sweep.
    pub sweep: SweepReport,
}

/// Wall-clock time of what is done beside the reconstructions of the branches, in seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
#[non_exhaustive]
pub struct BranchesTimings {
    /// Finding the branches.
    pub tree: f64,
    /// Each of them by itself: sweeps side by side, or cylinders one branch after the other.
    pub branches: f64,
    /// Joining the tubes to one surface.
    pub join: f64,
    /// Fitting it where they meet.
    pub fit: f64,
}

impl BranchesTimings {
    fn total(&self) -> f64 {
        let Self { tree, branches, join, fit } = self;
        tree + branches + join + fit
    }
}

impl BranchesReport {
    pub(super) fn of(
        recording: &Recording,
        tree: &BranchTree,
        sweeps: &[Sweep],
        [whole, supported]: [&Surface; 2],
        unsewn: usize,
        seconds: BranchesTimings,
    ) -> Self {
        let branch = |(path, sweep): (&BranchPath, &Sweep)| BranchReport {
            parent: path.parent,
            parting_mm: path.parting_mm,
            reason: path.reason(),
            sweep: sweep.report.clone(),
        };
        let is_supported = whole.array("supported").unwrap_or_default();
        Self {
            branches: tree.branches.iter().zip(sweeps).map(branch).collect(),
            dismissed: tree.dismissed.clone(),
            frames: recording.frames.len(),
            frames_left_out: left_out(recording, tree),
            nodes: whole.nodes_mm.len(),
            supported: is_supported.iter().filter(|&&is| is > 0.5).count(),
            unsewn,
            topology: supported.topology(),
            seconds,
        }
    }

    /// Wall-clock time of all that was done, s.
    pub fn total_s(&self) -> f64 {
        self.seconds.total()
    }
}

/// The frames with echoes that belong to no branch, by their numbers.
fn left_out(recording: &Recording, tree: &BranchTree) -> Vec<usize> {
    // Screening has emptied the contours that it left out.
    let has_echoes = |k: &usize| recording.frames[*k].echoes_mm().next().is_some();
    let without = (0..recording.frames.len()).filter(|&k| tree.frame_branch[k].is_none());
    without.filter(has_echoes).map(|k| recording.number(k)).collect()
}

/// A branching vessel of cylinders in numbers.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct CylinderBranchesReport {
    /// The branches; the first is that in which the recording begins.
    pub branches: Vec<CylinderBranchReport>,
    /// What looked like a branch and is none.
    pub dismissed: Vec<Dismissed>,
    /// Frames of the recording.
    pub frames: usize,
    /// Frames with echoes that belong to no branch, since their contours are not star-shaped about their centres or enclose
    /// no area.
    pub frames_left_out: Vec<usize>,
    /// Nodes of the joined surface.
    pub nodes: usize,
    /// Nodes of the joined surface that points support.
    pub supported: usize,
    /// Rings of the branches that could not be sewn to the surface of a parting: it is open there.
    pub unsewn: usize,
    /// How its triangles are connected.
    pub topology: Topology,
    /// Pairs of its triangles that cross, as where two branches nearly touch again beside their parting.
    pub crossings: usize,
    /// Time of each stage; those of a branch's cylinders are in its own report.
    pub seconds: BranchesTimings,
}

/// A branch of cylinders in numbers.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct CylinderBranchReport {
    /// The branch from which it was entered, as a place in [`CylinderBranchesReport::branches`]; `None` for the first.
    pub parent: Option<usize>,
    /// Where it meets that, mm; `None` for the first.
    pub parting_mm: Option<DVec3>,
    /// Why it is taken for a branch.
    pub reason: String,
    /// Length of its centreline, from where it leaves the wall of another, mm.
    pub length_mm: f64,
    /// Its cylinders and the vessel merged from them.
    pub cylinders: CylindersReport,
}

impl CylinderBranchesReport {
    pub(super) fn of(
        recording: &Recording,
        tree: &BranchTree,
        branches: &[CylinderReconstruction],
        axes: &[Axis],
        surface: &Surface,
        unsewn: usize,
        seconds: BranchesTimings,
    ) -> Self {
        let branch =
            |((path, branch), axis): ((&BranchPath, &CylinderReconstruction), &Axis)| CylinderBranchReport {
                parent: path.parent,
                parting_mm: path.parting_mm,
                reason: path.reason(),
                length_mm: axis.points_mm.windows(2).map(|pair| pair[0].distance(pair[1])).sum(),
                cylinders: branch.report.clone(),
            };
        let support = surface.array("support").unwrap_or_default();
        Self {
            branches: tree.branches.iter().zip(branches).zip(axes).map(branch).collect(),
            dismissed: tree.dismissed.clone(),
            frames: recording.frames.len(),
            frames_left_out: left_out(recording, tree),
            nodes: surface.nodes_mm.len(),
            supported: support.iter().filter(|&&points| points > 0.0).count(),
            unsewn,
            topology: surface.topology(),
            crossings: crossings(surface).len(),
            seconds,
        }
    }

    /// Tunnels through the surface: two branches that touch again beside their parting make one.
    pub fn tunnels(&self) -> i64 {
        let Topology { components, boundary_loops, euler_characteristic, .. } = self.topology;
        (2 * components as i64 - boundary_loops as i64 - euler_characteristic) / 2
    }

    /// Wall-clock time of all that was done, s.
    pub fn total_s(&self) -> f64 {
        self.seconds.total()
    }
}
