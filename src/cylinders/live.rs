//! The published method, frame by frame.

use super::estimate::{CylinderEstimator, LocalEstimate};
use super::fit::{Engine, FitRequest};
use super::merge::MergedVessel;
use super::track::Track;
use crate::engine::EngineDescription;
use crate::geometry::Pose;
use crate::recording::Frame;
use crate::settings::{Merge, Settings};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::time::Instant;

/// Newest frames that are kept within [`REST_MM`] of a frame's centre; older ones are dropped.
pub(crate) const MAX_FRAMES_AT_REST: usize = 320;
/// Radius of such a place, mm.
pub(crate) const REST_MM: f64 = 2.0;

/// The track and the vessel while frames arrive.
pub(crate) struct LiveCylinders {
    settings: Settings,
    engine: Box<dyn Engine>,
    fitted_by: Option<EngineDescription>,
    state: State,
}

/// What frames have left behind.
#[derive(Serialize, Deserialize)]
struct State {
    estimator: LocalEstimate,
    track: Track,
    /// Frames with a contour, and the last pose.
    seen: usize,
    pose: Pose,
    vessel: MergedVessel,
}

impl State {
    fn new(settings: &Settings) -> Self {
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        Self {
            estimator: LocalEstimate::new(sensor_from_probe),
            track: Track::without_estimator(sensor_from_probe),
            seen: 0,
            pose: Pose::IDENTITY,
            vessel: MergedVessel::default(),
        }
    }
}

/// Changes of the vessel through one frame.
#[derive(Debug, Default)]
pub(crate) struct Step {
    /// Rings that changed.
    pub changed: Vec<Range<usize>>,
    /// Points in the sections of the cylinders that were fitted, gated ones included.
    pub echoes: usize,
    /// Rings whose radii were computed.
    pub rings: usize,
    /// Times of placing the frame, and of fitting and stitching, s.
    pub placing_s: f64,
    pub solving_s: f64,
}

impl LiveCylinders {
    pub fn new(settings: &Settings, engine: Box<dyn Engine>) -> Result<Self> {
        if settings.merge != Merge::Stitch {
            return Err(Error::Setting {
                name: "merge".into(),
                found: "blend".into(),
                expected: "stitch, as cylinders are merged live".into(),
            });
        }
        Ok(Self { settings: settings.clone(), engine, fitted_by: None, state: State::new(settings) })
    }

    /// Forgets all frames.
    pub fn reset(&mut self) {
        self.state = State::new(&self.settings);
    }

    /// Where the last cylinder was fitted.
    pub fn fitted_by(&self) -> Option<&EngineDescription> {
        self.fitted_by.as_ref()
    }

    /// The vessel so far.
    pub fn vessel(&self) -> &MergedVessel {
        &self.state.vessel
    }

    /// What frames have left behind, to be [restored](Self::restore).
    pub fn state(&self) -> &impl Serialize {
        &self.state
    }

    /// Goes on with a state that was read from a file; whether it is sound and fits the settings. If not, nothing changes.
    pub fn go_on<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let (mut state, rest) = postcard::take_from_bytes::<State>(bytes).ok()?;
        let nodes = self.settings.nodes as usize;
        let sound = state.track.complete() && state.estimator.is_sound() && state.vessel.has_rings_of(nodes);
        sound.then(|| self.state = state)?;
        Some(rest)
    }

    /// Appends a frame; every `every`-th one with a contour adds a cylinder. `None` keeps the place of a frame that is left
    /// out.
    pub fn push(&mut self, frame: Option<&Frame>) -> Result<Step> {
        let Some(frame) = frame else {
            self.state.track.push(&Frame::new(self.state.pose, Vec::new()))?;
            return Ok(Step::default());
        };
        let start = Instant::now();
        frame.check(self.state.track.len())?;
        self.state.pose = frame.world_from_sensor;
        let estimate = self.state.estimator.push(frame);
        self.state.track.push_with(frame, estimate)?;
        self.state.track.drop_oldest_near(REST_MM, MAX_FRAMES_AT_REST);
        let mut step = Step { placing_s: start.elapsed().as_secs_f64(), ..Step::default() };
        if frame.echoes_mm().next().is_none() {
            return Ok(step);
        }
        self.state.seen += 1;
        if !self.state.seen.is_multiple_of(self.settings.every as usize) {
            return Ok(step);
        }
        let start = Instant::now();
        let count = self.state.track.len();
        let fit = self.engine.fit(&FitRequest::new(&self.state.track, &[count - 1], &self.settings))?;
        self.fitted_by = Some(fit.engine);
        let fitted = fit.cylinders;
        let mut first = self.state.vessel.rings.len();
        for cylinder in &fitted {
            first = first.min(self.state.vessel.stitch(cylinder, &cylinder.tube.radii_mm));
            step.echoes += (cylinder.tube.points + cylinder.tube.gated) as usize;
            step.rings += cylinder.tube.tube.levels + 1;
        }
        step.changed.push(first..self.state.vessel.rings.len());
        step.solving_s = start.elapsed().as_secs_f64();
        Ok(step)
    }
}
