//! A sweep in numbers.

use super::errors::RecordingErrors;
use super::prepare::Prepared;
use super::prepare::echo::Echo;
use super::support::Support;
use super::tracker::Tracker;
use super::wall::fit::Wall;
use super::wall::residual::is_inlier;
use crate::engine::EngineDescription;
use crate::recording::Frame;
use serde::Serialize;
use std::time::Instant;

/// A sweep in numbers.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct SweepReport {
    /// The engine that fitted the wall.
    pub engine: EngineDescription,
    /// Threads that it could use.
    pub threads: usize,
    /// Frames of the recording.
    pub frames: usize,
    /// Frames that were left out, since their contours are not star-shaped about their centres.
    pub folded_frames: Vec<usize>,
    /// Wall points in the recording.
    pub echoes: usize,
    /// Rays without an echo.
    pub missing: usize,
    /// Echoes beyond the ends of the axis.
    pub beyond_ends: usize,
    /// Echoes too far from the wall to be its own: those of branches, and wrong echoes.
    pub off_wall: usize,
    /// Length of the axis between the outermost supported rings, mm.
    pub length_mm: f64,
    /// Median radius of the contours, mm.
    pub contour_radius_mm: f64,
    /// Rings.
    pub rings: usize,
    /// Nodes.
    pub nodes: usize,
    /// Supported nodes.
    pub supported: usize,
    /// Standard deviation of an echo about the wall within the image plane, mm.
    pub noise_mm: f64,
    /// The part of it along the wall, mm, as far as the contours show it.
    pub tangential_noise_mm: f64,
    /// λ: weight of the wall's bending against the echoes, mm².
    pub smoothness_mm2: f64,
    /// Robust reweightings.
    pub iterations: usize,
    /// Whether the reweightings and the last solution converged within their limits.
    pub converged: bool,
    /// Steps of the solver, summed over the iterations.
    pub solver_steps: usize,
    /// Errors of the tracker, where the settings ask for them.
    pub tracker: Option<Tracker>,
    /// Errors of the recording, as its echoes show them; `None` where there are too few echoes, or they are perfect.
    pub errors: Option<RecordingErrors>,
    /// Time of each stage.
    pub seconds: SweepTimings,
}

/// Wall-clock time of each stage, in seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
#[non_exhaustive]
pub struct SweepTimings {
    /// Finding the axis.
    pub axis: f64,
    /// Placing the echoes about it.
    pub place: f64,
    /// Fitting the wall.
    pub fit: f64,
    /// Correcting the tracker's errors.
    pub tracker: f64,
    /// Estimating the recording's errors, and fitting the wall again with a smoothness that follows its roughness.
    pub errors: f64,
    /// Computing the support of the nodes.
    pub support: f64,
}

impl SweepTimings {
    /// The sum of all stages, s.
    pub fn total(&self) -> f64 {
        let Self { axis, place, fit, tracker, errors, support } = self;
        axis + place + fit + tracker + errors + support
    }
}

/// Does some work and stores its wall-clock time in `seconds`.
pub(super) fn timed<R>(seconds: &mut f64, work: impl FnOnce() -> R) -> R {
    let start = Instant::now();
    let result = work();
    *seconds = start.elapsed().as_secs_f64();
    result
}

/// A fitted wall, and the echoes that it was fitted to.
pub(super) struct FittedWall {
    pub wall: Wall,
    pub echoes: Vec<Echo>,
    pub engine: EngineDescription,
    pub tracker: Option<Tracker>,
    pub errors: Option<RecordingErrors>,
    /// Standard deviation of the echoes along the wall, mm.
    pub tangential_noise_mm: f64,
}

impl SweepReport {
    pub(super) fn of(
        prepared: &Prepared,
        fitted: &FittedWall,
        support: &Support,
        seconds: SweepTimings,
    ) -> Self {
        let Prepared { frames, grid, .. } = prepared;
        let FittedWall { wall, echoes, engine, tracker, errors, tangential_noise_mm } = fitted;
        let is_supported =
            |k: &usize| support.supported[k * grid.nodes..(k + 1) * grid.nodes].contains(&true);
        let mut supported_rings = (0..grid.rings).filter(is_supported);
        let first = supported_rings.next();
        let last = supported_rings.next_back().or(first);
        Self {
            engine: engine.clone(),
            threads: rayon::current_num_threads(),
            frames: frames.len(),
            folded_frames: prepared.folded_frames.iter().map(|&k| frames[k].number.unwrap_or(k)).collect(),
            echoes: frames.iter().map(|frame| frame.echoes_mm().count()).sum(),
            missing: frames.iter().map(Frame::missing_echoes).sum(),
            beyond_ends: prepared.echo_count() - echoes.len(),
            off_wall: echoes.iter().filter(|echo| !is_inlier(echo, wall.noise_mm)).count(),
            length_mm: first.zip(last).map_or(0.0, |(first, last)| (last - first) as f64 * grid.step_mm),
            contour_radius_mm: prepared.contour_radius_mm,
            rings: grid.rings,
            nodes: grid.node_count(),
            supported: support.supported.iter().filter(|s| **s).count(),
            noise_mm: wall.noise_mm,
            tangential_noise_mm: *tangential_noise_mm,
            smoothness_mm2: wall.smoothness_mm2,
            iterations: wall.iterations,
            converged: wall.converged,
            solver_steps: wall.solver_steps,
            tracker: *tracker,
            errors: errors.clone(),
            seconds,
        }
    }
}
