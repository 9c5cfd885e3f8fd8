//! Noise of the tracker and the contours, and motion of the vessel.

use super::within;
use crate::Result;
use crate::geometry::Pose;
use crate::setters::setters;
use glam::{DMat3, DQuat, DVec2, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Which way contour noise moves a wall point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ContourNoise {
    /// Independently in x and y of the probe.
    #[default]
    PerAxis,
    /// Along its ray only.
    Radial,
}

/// Noise that is independent from ray to ray and from frame to frame, and the simplest faults, all from one
/// seed; [`Faults`](super::Faults) has the others.
///
/// Every frame has its own stream of random numbers, in which every fault has its own place: neither the number
/// of threads nor switching one fault on changes what another one does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Noise {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Standard deviation of the tracked position, mm, in each axis.
    pub position_sd_mm: f64,
    /// Standard deviation of the tracked orientation, degrees: of each of the three components of the rotation
    /// vector by which it is off, in the sensor's axes.
    pub rotation_sd_deg: f64,
    /// Standard deviation of a contour point, mm, in the directions that `contour` names.
    pub contour_sd_mm: f64,
    /// Which way contour noise moves a point.
    pub contour: ContourNoise,
    /// Chance of a ray to lose its echo.
    pub dropout_probability: f64,
    /// Chance of a ray to bring an echo from anywhere within the probe's range instead of the wall.
    pub spike_probability: f64,
    /// Slow drift of the tracked position, a random walk, mm per square root of a second in each axis.
    pub position_drift_mm_per_sqrt_s: f64,
    /// Slow drift of the tracked orientation, a random walk of its rotation vector, degrees per square root of
    /// a second in each component.
    pub rotation_drift_deg_per_sqrt_s: f64,
    /// How much older than its contour the pose of a frame is, s.
    pub latency_s: f64,
    /// How much the vessel widens and narrows with the heart, as a fraction of its radius. The wall about a
    /// frame is scaled as a whole, about the centreline beside the tip.
    pub pulsation_fraction: f64,
    /// Heart rate, Hz.
    pub pulsation_rate_hz: f64,
    /// Standard deviation of a simulated local cylinder's axis position, mm, in x and y of the sensor.
    pub cylinder_position_sd_mm: f64,
    /// Standard deviation of its axis direction, degrees, in each of two directions across it.
    pub cylinder_axis_sd_deg: f64,
    /// Standard deviation of its radius, mm.
    pub cylinder_radius_sd_mm: f64,
}

setters!(Noise {
    with_seed => seed: u64,
    with_position_sd_mm => position_sd_mm: f64,
    with_rotation_sd_deg => rotation_sd_deg: f64,
    with_contour_sd_mm => contour_sd_mm: f64,
    with_contour => contour: ContourNoise,
    with_dropout_probability => dropout_probability: f64,
    with_spike_probability => spike_probability: f64,
    with_position_drift_mm_per_sqrt_s => position_drift_mm_per_sqrt_s: f64,
    with_rotation_drift_deg_per_sqrt_s => rotation_drift_deg_per_sqrt_s: f64,
    with_latency_s => latency_s: f64,
    with_pulsation_fraction => pulsation_fraction: f64,
    with_pulsation_rate_hz => pulsation_rate_hz: f64,
    with_cylinder_position_sd_mm => cylinder_position_sd_mm: f64,
    with_cylinder_axis_sd_deg => cylinder_axis_sd_deg: f64,
    with_cylinder_radius_sd_mm => cylinder_radius_sd_mm: f64,
});

impl Default for Noise {
    /// The levels of the thesis: 0.3 mm and 0.5° for the tracker, 1 mm for the contour; nothing else.
    fn default() -> Self {
        Self { position_sd_mm: 0.3, rotation_sd_deg: 0.5, contour_sd_mm: 1.0, ..Self::none() }
    }
}

impl Noise {
    /// No noise.
    pub fn none() -> Self {
        Self {
            seed: 1,
            position_sd_mm: 0.0,
            rotation_sd_deg: 0.0,
            contour_sd_mm: 0.0,
            contour: ContourNoise::PerAxis,
            dropout_probability: 0.0,
            spike_probability: 0.0,
            position_drift_mm_per_sqrt_s: 0.0,
            rotation_drift_deg_per_sqrt_s: 0.0,
            latency_s: 0.0,
            pulsation_fraction: 0.0,
            pulsation_rate_hz: 1.2,
            cylinder_position_sd_mm: 0.0,
            cylinder_axis_sd_deg: 0.0,
            cylinder_radius_sd_mm: 0.0,
        }
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// [`Error::Setting`](crate::Error::Setting).
    pub fn validate(&self) -> Result<()> {
        within("noise.position_sd_mm", self.position_sd_mm, 0.0, 100.0)?;
        within("noise.rotation_sd_deg", self.rotation_sd_deg, 0.0, 90.0)?;
        within("noise.contour_sd_mm", self.contour_sd_mm, 0.0, 100.0)?;
        within("noise.dropout_probability", self.dropout_probability, 0.0, 1.0)?;
        within("noise.spike_probability", self.spike_probability, 0.0, 1.0)?;
        within("noise.position_drift_mm_per_sqrt_s", self.position_drift_mm_per_sqrt_s, 0.0, 100.0)?;
        within("noise.rotation_drift_deg_per_sqrt_s", self.rotation_drift_deg_per_sqrt_s, 0.0, 90.0)?;
        within("noise.latency_s", self.latency_s, -10.0, 10.0)?;
        within("noise.pulsation_fraction", self.pulsation_fraction, 0.0, 0.5)?;
        within("noise.pulsation_rate_hz", self.pulsation_rate_hz, 0.0, 100.0)?;
        within("noise.cylinder_position_sd_mm", self.cylinder_position_sd_mm, 0.0, 100.0)?;
        within("noise.cylinder_axis_sd_deg", self.cylinder_axis_sd_deg, 0.0, 45.0)?;
        within("noise.cylinder_radius_sd_mm", self.cylinder_radius_sd_mm, 0.0, 100.0)
    }

    /// By how much the vessel is larger than at rest.
    pub(super) fn vessel_scale(&self, time_s: f64) -> f64 {
        1.0 + self.pulsation_fraction * (TAU * self.pulsation_rate_hz * time_s).sin()
    }

    /// The tracker's drift at each frame, as the position and the rotation vector (rad) by which it is off.
    pub(super) fn drift(&self, frames: usize, frame_interval_s: f64) -> Vec<(DVec3, DVec3)> {
        // The walk goes from frame to frame, so it has a stream of its own.
        let mut rng = self.stream(u64::MAX);
        let step = frame_interval_s.sqrt();
        let (mut position, mut rotation) = (DVec3::ZERO, DVec3::ZERO);
        (0..frames)
            .map(|_| {
                let here = (position, rotation);
                position += normal3(&mut rng) * self.position_drift_mm_per_sqrt_s * step;
                rotation += normal3(&mut rng) * self.rotation_drift_deg_per_sqrt_s.to_radians() * step;
                here
            })
            .collect()
    }

    /// The random numbers of one frame.
    pub(super) fn of_frame(&self, frame: usize) -> FrameNoise<'_> {
        FrameNoise { noise: self, rng: self.stream(frame as u64) }
    }

    pub(super) fn stream(&self, stream: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(stream);
        rng
    }
}

/// The faults of one frame, to be asked for in the order of the methods.
pub(super) struct FrameNoise<'a> {
    noise: &'a Noise,
    rng: ChaCha8Rng,
}

impl FrameNoise<'_> {
    /// The pose as the tracker gives it.
    pub fn pose(&mut self, truth: &Pose, drift: (DVec3, DVec3)) -> Pose {
        let shift = normal3(&mut self.rng) * self.noise.position_sd_mm + drift.0;
        let turn = normal3(&mut self.rng) * self.noise.rotation_sd_deg.to_radians() + drift.1;
        Pose {
            rotation: truth.rotation * DMat3::from_quat(DQuat::from_scaled_axis(turn)),
            translation_mm: truth.translation_mm + shift,
        }
    }

    /// By how much a local cylinder is off: its axis's position (mm), its axis's direction (rad) and its radius
    /// (mm).
    pub fn cylinder(&mut self) -> (DVec2, DVec2, f64) {
        let (position, axis) = (normal2(&mut self.rng), normal2(&mut self.rng));
        (
            position * self.noise.cylinder_position_sd_mm,
            axis * self.noise.cylinder_axis_sd_deg.to_radians(),
            normal(&mut self.rng) * self.noise.cylinder_radius_sd_mm,
        )
    }

    /// A contour point, mm, from the true range of a ray in the unit `direction`; NaN: no echo.
    pub fn contour_point(&mut self, range_mm: f64, direction: DVec2, probe_range_mm: f64) -> DVec2 {
        let offset = normal2(&mut self.rng) * self.noise.contour_sd_mm;
        let dropped = self.rng.random::<f64>() < self.noise.dropout_probability;
        let spiked = self.rng.random::<f64>() < self.noise.spike_probability;
        let spike_mm = self.rng.random::<f64>() * probe_range_mm;
        if dropped {
            DVec2::NAN
        } else if spiked {
            direction * spike_mm
        } else {
            match self.noise.contour {
                ContourNoise::PerAxis => direction * range_mm + offset,
                ContourNoise::Radial => direction * (range_mm + offset.x).max(0.0),
            }
        }
    }
}

pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn normal2(rng: &mut ChaCha8Rng) -> DVec2 {
    DVec2::new(normal(rng), normal(rng))
}

pub(super) fn normal3(rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::new(normal(rng), normal(rng), normal(rng))
}
