//! One smooth vessel from all echoes: a tube swept along the estimated centreline, whose wall is found by penalised least
//! squares (`docs/method.md`, sections "Axis" to "Live").
//!
//! It uses contours and poses only. The data pass through `prepare`, which finds the axis from the contours and places the
//! echoes about it; `wall`, which fits the wall; `tracker`, which corrects the poses where the settings ask for it;
//! `support`, which computes the standard errors of the nodes; and `surface`, which makes triangles of the wall. `live`
//! does the same frame by frame.

mod errors;
mod live;
mod motion;
mod prepare;
mod report;
mod support;
mod surface;
mod tracker;
pub(crate) mod wall;

pub use crate::error::StageProgress;
pub use errors::{AlikeErrors, Beat, CorrectedShifts, RecordingErrors};
pub(crate) use live::{LiveSweep, Step};
pub(crate) use motion::{AtRest, StateError, at_rest};
pub use motion::{Cycle, Motion};
pub(crate) use prepare::BEYOND_RADII;
pub use prepare::axis::Axis;
pub(crate) use prepare::contour::Outlines;
use prepare::noise::most_tangential_mm;
pub(crate) use prepare::noise::outward_bias_mm;
pub use report::{SweepReport, SweepTimings};
pub use support::Support;
pub(crate) use support::{MAX_ERROR_MEDIANS, MAX_ERROR_RADII, MAX_OFF_WALL};
pub use tracker::{CalibrationParameter, Mirror, SelfCalibration, Tracker};
pub(crate) use wall::engine::WallDevice;
#[cfg(feature = "gpu")]
pub use wall::gpu::GpuWallEngine;

use crate::engine::EngineDescription;
use crate::error::unless_cancelled;
use crate::recording::Recording;
use crate::settings::{FrameShifts, Settings};
use crate::surface::Surface;
use crate::{Error, Result};
use glam::DVec3;
use prepare::Prepared;
use prepare::echo::Echo;
use prepare::grid::WallGrid;
use report::{FittedWall, timed};
use std::ops::ControlFlow;
use wall::engine;
use wall::fit::{Aim, Checkpoint, Wall};

/// The stages of a sweep: axis, place, fit, tracker, support.
const STAGES: usize = 5;

/// A vessel swept along its centreline.
///
/// Node j of ring k has index `k·nodes + j` and lies at `θ = 2πj/nodes` of the axis's frame k.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Sweep {
    /// The axis that the section is swept along.
    pub axis: Axis,
    /// N: nodes per ring.
    pub nodes: usize,
    /// Radius at every node, mm.
    pub radii_mm: Vec<f64>,
    /// The data that support each node.
    pub support: Support,
    /// The sweep in numbers.
    pub report: SweepReport,
}

impl Sweep {
    /// Reconstructs the vessel of a recording; cylinder models in it are not used.
    ///
    /// # Errors
    /// Where settings are invalid, a frame cannot be used, or the contours cover no length of a vessel.
    pub fn of(recording: &Recording, settings: &Settings) -> Result<Self> {
        Self::run(recording, settings, &|_, _, _| ControlFlow::Continue(()))
    }

    /// As [`Sweep::of`], and calls `progress` with the stage that begins, the number of stages done, and their number in
    /// all; with the same numbers again before every iteration of a fit.
    ///
    /// # Errors
    /// As [`Sweep::of`].
    pub fn run(recording: &Recording, settings: &Settings, progress: &StageProgress) -> Result<Self> {
        recording.check()?;
        let outlines = Outlines::of(&recording.frames);
        Self::run_with(recording, outlines, settings, progress, &WallDevice::default())
    }

    /// As [`Sweep::run`], of a recording whose contours have these outlines; where a device fits the wall it is this one.
    pub(crate) fn run_with(
        recording: &Recording,
        outlines: Outlines,
        settings: &Settings,
        progress: &StageProgress,
        device: &WallDevice,
    ) -> Result<Self> {
        Self::fitted(recording, outlines, settings, progress, |grid, echoes, aim, checkpoint| {
            engine::fit(grid, echoes, settings, aim, device, checkpoint)
        })
    }

    /// As [`Sweep::of`], with the wall fitted by an engine on a device, whatever the settings' backend.
    ///
    /// # Errors
    /// As [`Sweep::of`], and [`Error::Gpu`] where the device fails.
    #[cfg(feature = "gpu")]
    pub fn on_device(recording: &Recording, settings: &Settings, device: &GpuWallEngine) -> Result<Self> {
        recording.check()?;
        let outlines = Outlines::of(&recording.frames);
        let quiet = |_: &'static str, _: usize, _: usize| ControlFlow::Continue(());
        Self::fitted(recording, outlines, settings, &quiet, |grid, echoes, aim, checkpoint| {
            let wall = engine::fit_on_device(grid, echoes, aim, device, checkpoint)?;
            Ok((wall, device.describe()))
        })
    }

    /// What fits the wall of a recording by an engine on a device, as often as it is called and with nothing between, and
    /// returns the seconds that it took.
    #[cfg(feature = "gpu")]
    pub(crate) fn fits<'a>(
        recording: &Recording,
        settings: &'a Settings,
        device: &'a GpuWallEngine,
    ) -> Result<impl FnMut() -> Result<f64> + 'a> {
        let prepared = Prepared::of(recording, Outlines::of(&recording.frames), settings)?;
        let mut echoes = prepared.echoes(&prepared.sensors());
        Ok(move || {
            let mut seconds = 0.0;
            let aim = Aim::alone(settings.sweep.roughness);
            let fit = || engine::fit_on_device(&prepared.grid, &mut echoes, aim, device, &|| Ok(()));
            timed(&mut seconds, fit)?;
            Ok(seconds)
        })
    }

    fn fitted(
        recording: &Recording,
        outlines: Outlines,
        settings: &Settings,
        progress: &StageProgress,
        fit: impl FnOnce(&WallGrid, &mut [Echo], Aim, &Checkpoint) -> Result<(Wall, EngineDescription)>,
    ) -> Result<Self> {
        settings.validate()?;
        recording.check()?;
        let mut seconds = SweepTimings { axis: outlines.seconds, ..SweepTimings::default() };
        let progress = |stage, done| unless_cancelled(progress(stage, done, STAGES));
        progress("finding the axis", 0)?;
        let prepared = timed(&mut seconds.axis, || Prepared::of(recording, outlines, settings))?;
        progress("placing the echoes", 1)?;
        let mut sensors = prepared.sensors();
        let mut echoes = timed(&mut seconds.place, || prepared.echoes(&sensors));
        let fitting = || progress("fitting the wall", 2);
        fitting()?;
        let aim = Aim {
            roughness: settings.sweep.roughness,
            is_continued: !settings.sweep.even_smoothness && errors::suffice(prepared.frames.len(), &echoes),
        };
        let (mut wall, engine) = timed(&mut seconds.fit, || fit(&prepared.grid, &mut echoes, aim, &fitting))?;
        let correcting = || progress("correcting the poses", 3);
        correcting()?;
        let tracker = timed(&mut seconds.tracker, || {
            Tracker::correct(&prepared, &settings.sweep, &mut sensors, &mut echoes, &mut wall, &correcting)
        })?;
        let estimating = || progress("estimating the errors", 4);
        estimating()?;
        let mut support = timed(&mut seconds.support, || Support::of(&prepared.grid, &echoes, &wall));
        let errors = timed(&mut seconds.errors, || {
            let times_s: Vec<Option<f64>> = prepared.frames.iter().map(|frame| frame.time_s).collect();
            // A model of all errors of the poses leaves no shifts of single frames to correct.
            let moves = settings.sweep.frame_shifts == FrameShifts::Auto && !settings.sweep.correct_poses;
            let moved = |moves_mm: &[DVec3]| {
                let mut sensors = sensors.clone();
                let poses = sensors.iter_mut().zip(moves_mm);
                poses.for_each(|(pose, move_mm)| pose.translation_mm += *move_mm);
                prepared.echoes(&sensors)
            };
            let movable = moves.then_some(errors::Movable { axis: &prepared.axis, moved: &moved });
            let keeps_out_of_plane = tracker.as_ref().is_some_and(|tracker| tracker.poses_corrected);
            let frames = errors::Frames { times_s: &times_s, movable, keeps_out_of_plane };
            let Prepared { grid, .. } = &prepared;
            errors::estimate(grid, frames, &settings.sweep, &mut echoes, &mut wall, &support, &estimating)
        })?;
        let most_mm = most_tangential_mm(wall.noise_mm, prepared.contour_radius_mm);
        let tangential_noise_mm = prepared.tangential_noise_mm().min(most_mm);
        let along_mm = along_wall_mm(tangential_noise_mm, errors.as_ref().map(|(errors, _)| errors));
        for radius in &mut wall.radii_mm {
            *radius -= outward_bias_mm(*radius, along_mm);
        }
        let errors = errors.map(|(errors, of_nodes)| {
            let mut again_s = 0.0;
            support = timed(&mut again_s, || Support::of(&prepared.grid, &echoes, &wall));
            seconds.support += again_s;
            support.replace_errors(of_nodes);
            errors
        });
        if !surface::has_support(prepared.grid.nodes, prepared.grid.rings, &support) {
            return Err(Error::Surface {
                what: "wall that echoes support".into(),
                found: format!(
                    "no triangle from {} echoes for {} nodes, with a noise of {:.3} mm",
                    echoes.len(),
                    prepared.grid.node_count(),
                    wall.noise_mm
                ),
                expected: "more echoes on each part of the wall, or less noise".into(),
            });
        }
        let fitted = FittedWall { wall, echoes, engine, tracker, errors, tangential_noise_mm };
        let report = SweepReport::of(&prepared, &fitted, &support, seconds);
        let Prepared { axis, grid, .. } = prepared;
        progress("done", STAGES)?;
        Ok(Self { axis, nodes: grid.nodes, radii_mm: fitted.wall.radii_mm, support, report })
    }

    /// Adds the error of the state that the vessel is shown in to the nodes' standard errors.
    pub(crate) fn add_error(&mut self, error: &StateError) {
        let normals = self.surface(true).node_normals();
        let of_nodes = self.support.standard_error_mm.iter_mut().zip(normals).zip(&self.radii_mm);
        for ((standard_mm, normal), radius_mm) in of_nodes {
            *standard_mm = standard_mm.hypot(error.variance_mm2(normal, *radius_mm).sqrt());
        }
    }

    /// Standard deviation of an echo along the wall, mm: its own noise, and shifts of whole frames.
    pub(crate) fn along_wall_mm(&self) -> f64 {
        along_wall_mm(self.report.tangential_noise_mm, self.report.errors.as_ref())
    }

    /// The vessel as a triangle surface, normals outward, open at its ends; without the nodes that are not
    /// supported unless `keep_unsupported`. Arrays: `support` (echoes), `residual_mm`, `standard_error_mm`,
    /// `error_reach_mm`, `frame` (last seen), `supported` (1 or 0).
    pub fn surface(&self, keep_unsupported: bool) -> Surface {
        let rings = 0..self.axis.rings();
        let radius_mm = |node: usize| self.radii_mm[node];
        let is_supported = |node: usize| self.support.supported[node];
        surface::surface(
            &self.axis,
            self.nodes,
            rings,
            &self.support,
            is_supported,
            radius_mm,
            keep_unsupported,
        )
    }
}

fn along_wall_mm(tangential_noise_mm: f64, errors: Option<&RecordingErrors>) -> f64 {
    tangential_noise_mm.hypot(errors.map_or(0.0, RecordingErrors::shift_mm))
}
