//! The published method, frame by frame.

use super::{Live, Work};
use crate::cylinder::LocalEstimate;
use crate::fit::{Engine, Job, Track, engine};
use crate::merge::Vessel;
use crate::recording::Frame;
use crate::settings::{Merge, Settings};
use crate::{Error, Result};
use std::ops::Range;

/// Frames, and the vessel of their cylinders.
pub(super) struct Cylinders {
    settings: Settings,
    engine: Box<dyn Engine>,
    track: Track,
    pub vessel: Vessel,
}

impl Cylinders {
    pub fn new(settings: &Settings) -> Result<Self> {
        if settings.merge != Merge::Stitch {
            return Err(Error::Setting {
                name: "merge",
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
            vessel: Vessel::default(),
        })
    }

    /// Takes a frame; every `every`-th brings a cylinder.
    pub fn push(&mut self, frame: &Frame) -> Result<(Vec<Range<usize>>, Work)> {
        self.track.push(frame)?;
        self.track.forget_rest(Live::REST_MM, Live::MOST_FRAMES_AT_REST);
        let count = self.track.len();
        if !count.is_multiple_of(self.settings.every as usize) {
            return Ok((Vec::new(), Work::default()));
        }
        let fitted = self.engine.fit(&Job::new(&self.track, &[count - 1], &self.settings))?;
        let mut work = Work::default();
        let mut first = self.vessel.rings.len();
        for cylinder in &fitted {
            first = first.min(self.vessel.stitch(cylinder, &cylinder.tube.radii_mm));
            work.echoes += (cylinder.tube.points + cylinder.tube.gated) as usize;
            work.rings += cylinder.tube.tube.levels + 1;
        }
        Ok((std::iter::once(first..self.vessel.rings.len()).collect(), work))
    }
}
