//! Vessels that branch (`docs/method.md`, section "Branches").
//!
//! `tree` finds the branches that the catheter visited and the frames of each; every branch is swept by itself; `join`
//! makes one surface of the tubes.

mod fit;
mod join;
mod tree;
mod tube;

pub use tree::{BranchPath, BranchTree, Dismissed};

use crate::Result;
use crate::recording::{Frame, Recording};
use crate::settings::Settings;
use crate::surface::Surface;
use crate::sweep::{StageProgress, Support, Sweep};
use fit::{NodeSupport, TubeFit, WorldEcho};
use glam::DVec2;
use join::{Joined, Origin};
use rayon::prelude::*;
use std::f64::consts::TAU;
use tube::Tube;

/// A vessel that branches, by the sweep.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BranchedSweep {
    /// The branches that the catheter visited.
    pub tree: BranchTree,
    /// The sweep of each branch. Frames are numbered as in the recording.
    pub sweeps: Vec<Sweep>,
    whole: Surface,
}

impl BranchedSweep {
    /// Reconstructs the branches of a recording and joins them.
    ///
    /// # Errors
    /// As [`Sweep::of`].
    pub fn of(
        recording: &Recording,
        settings: &Settings,
        tree: BranchTree,
        progress: &StageProgress,
    ) -> Result<Self> {
        let mut sweeps = Vec::new();
        for number in 0..tree.branches.len() {
            let frames: Vec<usize> =
                (0..recording.frames.len()).filter(|&k| tree.frame_branch[k] == Some(number)).collect();
            let part = Recording {
                frames: frames.iter().map(|&k| recording.frames[k].clone()).collect(),
                ..recording.clone()
            };
            let mut sweep = Sweep::run(&part, settings, progress)?;
            for last in sweep.support.last_frame.iter_mut().flatten() {
                *last = frames[*last as usize] as u32;
            }
            sweeps.push(sweep);
        }
        let mut tubes: Vec<Tube> = sweeps
            .iter()
            .map(|sweep| Tube::new(&sweep.axis, sweep.nodes, sweep.radii_mm.clone(), sweep.axis.step_mm))
            .collect();
        let inner_ends: Vec<[Option<usize>; 2]> =
            tree.branches.iter().zip(&sweeps).map(|(branch, sweep)| branch.joined_along(&sweep.axis)).collect();
        let mut joined = join::joined(&mut tubes, &inner_ends)?;
        let fits: Vec<TubeFit> = sweeps.iter().map(tube_fit).collect();
        let echoes = world_echoes(recording, &tree, settings);
        let support = fit::fit(&mut joined, &tubes, &fits, &echoes)?;
        let whole = with_arrays(joined, &sweeps, &support);
        Ok(Self { tree, sweeps, whole })
    }

    /// One surface.
    pub fn surface(&self, keep_unsupported: bool) -> Surface {
        if keep_unsupported {
            return self.whole.clone();
        }
        let supported = self.whole.array("supported").unwrap_or(&[]);
        let mut kept = self.whole.clone();
        kept.triangles.retain(|t| t.iter().all(|&n| supported[n as usize] > 0.5));
        kept.without_loose_nodes()
    }
}

fn tube_fit(sweep: &Sweep) -> TubeFit<'_> {
    TubeFit {
        noise_mm: sweep.report.noise_mm,
        tangential_noise_mm: sweep.report.tangential_noise_mm,
        smoothness_mm2: sweep.report.smoothness_mm2,
        standard_error_mm: &sweep.support.standard_error_mm,
        supported: &sweep.support.supported,
    }
}

/// The echoes of the frames that belong to a branch, in the world.
fn world_echoes(recording: &Recording, tree: &BranchTree, settings: &Settings) -> Vec<WorldEcho> {
    let sensor_from_probe = settings.calibration.sensor_from_probe();
    let frames = recording.frames.par_iter().enumerate().zip(&tree.frame_branch);
    let used = frames.filter(|(_, branch)| branch.is_some());
    used.flat_map_iter(|((k, frame), _)| {
        let pose = frame.world_from_sensor * sensor_from_probe;
        // Contours that do not go round the probe are seen from their middle.
        let origin = if goes_round_probe(frame) { DVec2::ZERO } else { frame.centroid_mm().unwrap_or(DVec2::ZERO) };
        let place = move |p: DVec2| pose.transform_point(p.extend(0.0));
        let origin_mm = place(origin);
        frame.echoes_mm().map(move |p| WorldEcho { origin_mm, point_mm: place(p), frame: k as u32 })
    })
    .collect()
}

/// Whether a contour encloses the probe.
fn goes_round_probe(frame: &Frame) -> bool {
    let points: Vec<DVec2> = frame.echoes_mm().collect();
    let next = points.iter().cycle().skip(1);
    let turn: f64 = points.iter().zip(next).map(|(a, b)| a.angle_to(*b)).sum();
    turn.abs() > std::f64::consts::PI
}

/// The joined surface with the arrays of the sweeps' own surfaces, and `branch`.
fn with_arrays(joined: Joined, sweeps: &[Sweep], support: &[Option<NodeSupport>]) -> Surface {
    let Joined { mut surface, origin, .. } = joined;
    let nearest = |origin: &Origin| match *origin {
        Origin::Grid { tube, node } => (tube, node),
        Origin::Parting { tube, spot } => {
            let nodes = sweeps[tube].nodes;
            let ring = (spot.ring.round() as usize).min(sweeps[tube].axis.rings() - 1);
            let j = (spot.theta_rad / TAU * nodes as f64).round() as usize % nodes;
            (tube, ring * nodes + j)
        }
    };
    let of: Vec<(usize, usize)> = origin.iter().map(nearest).collect();
    let mut array = |name, of_grid: &dyn Fn(&Support, usize) -> f64, of_parting: &dyn Fn(&NodeSupport) -> f64| {
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
