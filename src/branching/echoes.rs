//! The echoes of a recording in the world.

use crate::geometry::Pose;
use crate::geometry::polygon::turns_about_origin;
use crate::recording::{Frame, Recording};
use crate::settings::Settings;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// An echo in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct WorldEcho {
    /// Where the probe looks from.
    pub origin_mm: DVec3,
    pub point_mm: DVec3,
    /// Unit normal of its image.
    pub image_normal: DVec3,
    pub frame: u32,
}

impl WorldEcho {
    /// The direction that the probe sees it in, and its distance, mm; `None` where that is 0.
    pub(super) fn ray(&self) -> Option<(DVec3, f64)> {
        let ray_mm = self.point_mm - self.origin_mm;
        Some((ray_mm.try_normalize()?, ray_mm.length()))
    }
}

/// The echoes of the frames that are used. They are placed when they are asked for: all of a long recording take more
/// memory than the recording.
pub(super) struct WorldEchoes<'a> {
    frames: Vec<PlacedFrame<'a>>,
    count: usize,
}

struct PlacedFrame<'a> {
    frame: &'a Frame,
    number: u32,
    pose: Pose,
    origin_mm: DVec3,
    /// Number of the echoes of the frames before.
    before: usize,
    /// The largest distance of an echo from the probe, mm.
    reach_mm: f64,
}

impl<'a> WorldEchoes<'a> {
    pub(super) fn of(
        recording: &'a Recording,
        settings: &Settings,
        is_used: impl Fn(usize) -> bool + Sync + Send,
    ) -> Self {
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let placed = |(k, frame): (usize, &'a Frame)| {
            let pose = frame.world_from_sensor * sensor_from_probe;
            // Contours that do not go round the probe are seen from their middle.
            let encloses_probe = turns_about_origin(&frame.echoes_mm().collect::<Vec<_>>()) != 0;
            let origin = if encloses_probe { None } else { frame.centroid_mm() }.unwrap_or(DVec2::ZERO);
            PlacedFrame {
                frame,
                number: k as u32,
                origin_mm: pose.transform_point(origin.extend(0.0)),
                pose,
                before: 0,
                reach_mm: frame.echoes_mm().map(DVec2::length).fold(0.0, f64::max),
            }
        };
        let used = recording.frames.par_iter().enumerate().filter(|(k, _)| is_used(*k));
        let mut frames: Vec<PlacedFrame> = used.map(placed).collect();
        let mut count = 0;
        for placed in &mut frames {
            placed.before = count;
            count += placed.frame.echoes_mm().count();
        }
        Self { frames, count }
    }

    /// The echoes within a box from its lowest to its highest corner.
    pub(super) fn within(&self, [low, high]: [DVec3; 2]) -> Vec<WorldEcho> {
        let may_reach = |placed: &&PlacedFrame| {
            let probe_mm = placed.pose.translation_mm;
            // With room for rounding.
            probe_mm.distance(probe_mm.clamp(low, high)) <= placed.reach_mm * (1.0 + 1e-9)
        };
        let is_within = |echo: &WorldEcho| echo.point_mm.cmpge(low).all() && echo.point_mm.cmple(high).all();
        let near = self.frames.par_iter().filter(may_reach);
        near.flat_map_iter(|placed| placed.echoes().filter(is_within)).collect()
    }

    /// Every echo, or of more than `most` every second one, and so on.
    pub(super) fn at_most(&self, most: usize) -> Vec<WorldEcho> {
        let every = self.count.div_ceil(most).max(1);
        let of_frame = |placed: &PlacedFrame| -> Vec<WorldEcho> {
            // The first one of the frame whose number is a multiple.
            let skipped = (every - placed.before % every) % every;
            placed.echoes().skip(skipped).step_by(every).collect()
        };
        self.frames.par_iter().flat_map_iter(of_frame).collect()
    }
}

impl PlacedFrame<'_> {
    fn echoes(&self) -> impl Iterator<Item = WorldEcho> + '_ {
        self.frame.echoes_mm().map(|p| WorldEcho {
            origin_mm: self.origin_mm,
            point_mm: self.pose.transform_point(p.extend(0.0)),
            image_normal: self.pose.rotation.z_axis,
            frame: self.number,
        })
    }
}
