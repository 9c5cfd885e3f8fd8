//! A branching vessel in numbers.

use super::tree::{BranchTree, Dismissed};
use crate::recording::Recording;
use crate::surface::{Surface, Topology};
use crate::sweep::{Sweep, SweepReport};
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
    /// The branch that it leaves, as a place in [`BranchesReport::branches`]; `None` for the first.
    pub parent: Option<usize>,
    /// Where its middle leaves that of its parent, mm; `None` for the first.
    pub parting_mm: Option<DVec3>,
    /// Why it is taken for a branch.
    pub reason: String,
    /// Its sweep.
    pub sweep: SweepReport,
}

/// Wall-clock time of what is done beside the sweeps, in seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
#[non_exhaustive]
pub struct BranchesTimings {
    /// Finding the branches.
    pub tree: f64,
    /// Sweeping them, side by side.
    pub sweeps: f64,
    /// Joining the tubes to one surface.
    pub join: f64,
    /// Fitting it where they meet.
    pub fit: f64,
}

impl BranchesReport {
    pub(super) fn of(
        recording: &Recording,
        tree: &BranchTree,
        sweeps: &[Sweep],
        whole: &Surface,
        unsewn: usize,
        seconds: BranchesTimings,
    ) -> Self {
        let branch = |(branch, sweep): (&super::BranchPath, &Sweep)| {
            let start = branch.middle_mm[0];
            let reason = match branch.parent {
                None => "the recording begins in it".into(),
                Some(parent) => format!(
                    "contours lie up to {:.1} mm beyond the wall of branch {parent}, in {} frames",
                    branch.depth_mm, branch.frames
                ),
            };
            BranchReport {
                parent: branch.parent,
                parting_mm: branch.parent.map(|_| start),
                reason,
                sweep: sweep.report.clone(),
            }
        };
        let supported = whole.array("supported").unwrap_or_default();
        // Screening has emptied the contours that it left out.
        let has_echoes = |k: &usize| recording.frames[*k].echoes_mm().next().is_some();
        let left_out =
            (0..recording.frames.len()).filter(|&k| tree.frame_branch[k].is_none()).filter(has_echoes);
        Self {
            branches: tree.branches.iter().zip(sweeps).map(branch).collect(),
            dismissed: tree.dismissed.clone(),
            frames: recording.frames.len(),
            frames_left_out: left_out.map(|k| recording.number(k)).collect(),
            nodes: whole.nodes_mm.len(),
            supported: supported.iter().filter(|&&is| is > 0.5).count(),
            unsewn,
            topology: super::supported_part(whole).topology(),
            seconds,
        }
    }

    /// Wall-clock time of all that was done, s.
    pub fn total_s(&self) -> f64 {
        let BranchesTimings { tree, sweeps, join, fit } = self.seconds;
        tree + sweeps + join + fit
    }
}
