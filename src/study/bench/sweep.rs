//! The sweep's wall fit on the CPU and on a device.

use super::{Parity, RADIUS_MM, Times};
use crate::geometry::Pose;
use crate::recording::{Frame, Recording};
use crate::settings::{Backend, Settings, SweepSettings};
use crate::sweep::Sweep;
use crate::{Error, Result};
use glam::{DQuat, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use serde::Serialize;
use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

/// Length of the vessel, mm.
const LENGTH_MM: f64 = 500.0;
/// Most rays of a frame.
const MAX_RAYS: usize = 512;

/// One size of a sweep: `512x1e6`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SweepCase {
    /// N: nodes per ring.
    pub nodes: u32,
    /// Number of echoes, rounded down to whole frames.
    pub echoes: usize,
}

impl FromStr for SweepCase {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let Some((nodes, echoes)) = text.split_once('x') else {
            return Err(Error::setting("case", text, "NODESxECHOES, such as 512x1e6"));
        };
        let number = |part: &str, range: std::ops::RangeInclusive<f64>| {
            let whole = part.parse().ok().filter(|x: &f64| x.fract() == 0.0 && range.contains(x));
            let (low, high) = (range.start(), range.end());
            whole
                .ok_or_else(|| Error::setting("case", part, format!("a whole number from {low} to {high:e}")))
        };
        Ok(Self { nodes: number(nodes, 8.0..=8192.0)? as u32, echoes: number(echoes, 1e4..=1e9)? as usize })
    }
}

impl fmt::Display for SweepCase {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "sweep, {} nodes per ring, {:.0e} echoes", self.nodes, self.echoes as f64)
    }
}

impl SweepCase {
    /// A pullback through a wavy, winding vessel with a noise of 0.5 mm, the same for the same seed.
    pub fn recording(&self, seed: u64) -> Recording {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let rays = (self.nodes as usize).min(MAX_RAYS);
        let count = self.echoes / rays;
        let curve = |s: f64| DVec3::new(s, 15.0 * (s / 70.0).sin(), 15.0 * (s / 90.0).cos());
        let mut frame = |k: usize| {
            let s = LENGTH_MM * k as f64 / count as f64;
            let along = (curve(s + 0.5) - curve(s - 0.5)).normalize();
            let contour_mm = (0..rays).map(|ray| {
                let angle = TAU * ray as f64 / rays as f64;
                let noise: f64 = rng.sample(rand_distr::StandardNormal);
                let wave = 1.0 + 0.08 * (2.0 * angle).cos() + 0.06 * (s / 9.0).sin();
                DVec2::from_angle(angle) * (RADIUS_MM * wave + 0.5 * noise)
            });
            let rotation = DQuat::from_rotation_arc(DVec3::Z, along);
            Frame::new(Pose::from_quaternion(curve(s), rotation), contour_mm.collect())
        };
        Recording { frames: (0..count).map(&mut frame).collect() }
    }

    /// The settings of the case.
    pub fn settings(&self) -> Settings {
        let sweep = SweepSettings { nodes: Some(self.nodes), ..SweepSettings::default() };
        Settings { backend: Backend::Cpu, sweep, ..Settings::default() }
    }
}

/// Times of fitting a wall.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct SweepRow {
    /// The case.
    pub case: SweepCase,
    /// Rings of the wall.
    pub rings: usize,
    /// Robust reweightings.
    pub iterations: usize,
    /// Steps of the solver in all of them.
    pub solver_steps: usize,
    /// Fitting the wall on the CPU, in f64, once.
    pub cpu_ms: f64,
    /// The same on the device, where there is one, with the transfer of the echoes to it and back.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<SweepDeviceRow>,
}

/// Times of fitting a wall on a device.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct SweepDeviceRow {
    /// The whole fit, after half a second of fits.
    pub fit: Times,
    /// The first fit, for which the device had to make memory, and before which it idled while the CPU prepared the echoes:
    /// a card that idles runs at a fraction of its clock.
    pub first_ms: f64,
    /// Where that time went; the rest is the host's own computation.
    pub of_it: super::EndToEnd,
    /// The comparison of the walls before anything was timed.
    pub parity: Parity,
    /// Device time of each pass over a fit, ms; absent where the device has no timestamps.
    pub passes: Vec<SweepPassRow>,
}

/// A pass over a whole fit.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct SweepPassRow {
    /// The pass.
    pub name: &'static str,
    /// Its device time over a fit, ms.
    pub ms: f64,
}

/// Times the fit of a sweep's wall on the CPU and on the device, after comparing their walls.
///
/// # Errors
/// Where the two disagree, or one fails.
pub fn run_sweep(
    case: SweepCase,
    repeats: usize,
    #[cfg(feature = "gpu")] device: Option<&crate::sweep::wall::gpu::GpuWallEngine>,
) -> Result<SweepRow> {
    let (recording, settings) = (case.recording(1), case.settings());
    let expected = Sweep::of(&recording, &settings)?;
    let mut row = SweepRow {
        case,
        rings: expected.report.rings,
        iterations: expected.report.iterations,
        solver_steps: expected.report.solver_steps,
        cpu_ms: expected.report.seconds.fit * 1e3,
        device: None,
    };
    #[cfg(feature = "gpu")]
    if let Some(engine) = device {
        engine.warm_up()?;
        let found = Sweep::on_device(&recording, &settings, engine)?;
        let first_ms = found.report.seconds.fit * 1e3;
        let parity = Parity::of(["cpu", "gpu"], &expected.radii_mm, &found.radii_mm)?;
        let repeats = repeats.max(1);
        let (mut seconds, mut spent) = (Vec::new(), Vec::new());
        engine.take_spent();
        let mut fit = Sweep::fits(&recording, &settings, engine)?;
        // Warm as `Times::measure_warm` does.
        let start = std::time::Instant::now();
        while seconds.len() < repeats {
            let warm = start.elapsed() >= super::WARM_UP;
            let fit_s = fit()?;
            let parts = engine.take_spent();
            if warm {
                seconds.push(fit_s);
                spent.push(parts);
            }
        }
        let (_, passes) = engine.timed(|_| fit())?;
        let passes = passes.into_iter().map(|(name, seconds)| SweepPassRow { name, ms: seconds * 1e3 });
        let (fit, of_it) = (Times::of(seconds), super::EndToEnd::of(&spent));
        row.device = Some(SweepDeviceRow { fit, first_ms, of_it, parity, passes: passes.collect() });
    }
    #[cfg(not(feature = "gpu"))]
    let _ = (&mut row, repeats);
    Ok(row)
}
