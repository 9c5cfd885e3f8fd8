//! The ultrasound probe.

use super::vessel::SimulatedVessel;
use super::within;
use crate::geometry::Pose;
use crate::setters::setters;
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A rotating IVUS transducer that sends its rays out in the xy-plane of the probe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Probe {
    /// Rays per frame; ray j leaves at the angle 2πj/rays from x towards y.
    pub rays: usize,
    /// Walls farther away give no echo, mm.
    pub range_mm: f64,
}

setters!(Probe {
    with_rays => rays: usize,
    with_range_mm => range_mm: f64,
});

impl Default for Probe {
    fn default() -> Self {
        Self { rays: 90, range_mm: 30.0 }
    }
}

impl Probe {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn validate(&self) -> Result<()> {
        if !(1..=100_000).contains(&self.rays) {
            return Err(Error::Setting {
                name: "probe.rays".into(),
                found: self.rays.to_string(),
                expected: "1 to 100000".into(),
            });
        }
        within("probe.range_mm", self.range_mm, 0.1, 1000.0)
    }

    /// Direction of a ray in the probe's plane, from x towards y, rad.
    pub fn angle_rad(&self, ray: usize) -> f64 {
        ray as f64 / self.rays as f64 * TAU
    }

    /// Unit direction of a ray in the probe's plane.
    pub fn direction(&self, ray: usize) -> DVec2 {
        DVec2::from_angle(self.angle_rad(ray))
    }

    /// Distance to the wall along each ray, mm; NaN: no wall within range.
    pub fn ranges_mm(&self, vessel: &SimulatedVessel, world_from_probe: &Pose) -> Vec<f64> {
        self.ranges_in_scaled_mm(vessel, world_from_probe, DVec3::ZERO, 1.0)
    }

    /// The same in a vessel that is enlarged by `scale` about a point: scaling the ray down instead is exact.
    pub(super) fn ranges_in_scaled_mm(
        &self,
        vessel: &SimulatedVessel,
        world_from_probe: &Pose,
        about_mm: DVec3,
        scale: f64,
    ) -> Vec<f64> {
        let origin = world_from_probe.translation_mm;
        let origin = if scale == 1.0 { origin } else { about_mm + (origin - about_mm) / scale };
        (0..self.rays)
            .map(|ray| {
                let direction = world_from_probe.rotation * self.direction(ray).extend(0.0);
                vessel
                    .cast_mm(origin, direction, self.range_mm / scale)
                    .map_or(f64::NAN, |range| range * scale)
            })
            .collect()
    }
}
