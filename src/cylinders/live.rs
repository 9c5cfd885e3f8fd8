//! The published method, frame by frame.

use super::estimate::LocalEstimate;
use super::fit::{Engine, FitRequest, engine};
use super::merge::MergedVessel;
use super::track::Track;
use crate::geometry::Pose;
use crate::recording::Frame;
use crate::settings::{Merge, Settings};
use crate::{Error, Result};
use std::ops::Range;
use std::time::Instant;

/// Newest frames that are kept within [`REST_MM`] of a frame's centre; older ones are dropped.
pub(crate) const MAX_FRAMES_AT_REST: usize = 512;
/// Radius of such a place, mm.
pub(crate) const REST_MM: f64 = 2.0;

/// The track and the vessel while frames arrive.
pub(crate) struct LiveCylinders {
    settings: Settings,
    engine: Box<dyn Engine>,
    track: Track,
    /// Frames with a contour, and the last pose.
    seen: usize,
    pose: Pose,
    pub vessel: MergedVessel,
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
    pub fn new(settings: &Settings) -> Result<Self> {
        if settings.merge != Merge::Stitch {
            return Err(Error::Setting {
                name: "merge".into(),
                found: "blend".into(),
                expected: "stitch, as cylinders are merged live".into(),
            });
        }
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let estimator = LocalEstimate::new(sensor_from_probe);
        Ok(Self {
            settings: settings.clone(),
            engine: engine(settings)?,
            track: Track::new(sensor_from_probe, Box::new(estimator)),
            seen: 0,
            pose: Pose::IDENTITY,
            vessel: MergedVessel::default(),
        })
    }

    /// Appends a frame; every `every`-th one with a contour adds a cylinder. `None` keeps the place of a frame that is left
    /// out.
    pub fn push(&mut self, frame: Option<&Frame>) -> Result<Step> {
        let Some(frame) = frame else {
            self.track.push(&Frame::new(self.pose, Vec::new()))?;
            return Ok(Step::default());
        };
        let start = Instant::now();
        self.pose = frame.world_from_sensor;
        self.track.push(frame)?;
        self.track.drop_oldest_near(REST_MM, MAX_FRAMES_AT_REST);
        let mut step = Step { placing_s: start.elapsed().as_secs_f64(), ..Step::default() };
        if frame.echoes_mm().next().is_none() {
            return Ok(step);
        }
        self.seen += 1;
        if !self.seen.is_multiple_of(self.settings.every as usize) {
            return Ok(step);
        }
        let start = Instant::now();
        let count = self.track.len();
        let fitted = self.engine.fit(&FitRequest::new(&self.track, &[count - 1], &self.settings))?.cylinders;
        let mut first = self.vessel.rings.len();
        for cylinder in &fitted {
            first = first.min(self.vessel.stitch(cylinder, &cylinder.tube.radii_mm));
            step.echoes += (cylinder.tube.points + cylinder.tube.gated) as usize;
            step.rings += cylinder.tube.tube.levels + 1;
        }
        step.changed.push(first..self.vessel.rings.len());
        step.solving_s = start.elapsed().as_secs_f64();
        Ok(step)
    }
}
