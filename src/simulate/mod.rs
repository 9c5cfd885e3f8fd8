//! Simulated recordings: a vessel of known geometry, a catheter that moves through it, a probe that measures
//! distances to its wall, and noise.
//!
//! Phantom or any surface → [`SimulatedVessel`] → [`Insertion`] → [`Probe`] → [`Noise`], [`Faults`] →
//! [`Simulation`].
//!
//! ```
//! use lumenmesh::simulate::{Insertion, Phantom, SimulationSettings, Shape, Simulation};
//!
//! let vessel = Phantom::from("cylinder".parse::<Shape>()?).vessel()?;
//! let settings = SimulationSettings::default().with_insertion(Insertion::steady());
//! let simulation = Simulation::run(vessel, &settings)?;
//! assert_eq!(simulation.recording.frames.len(), simulation.truth_recording.frames.len());
//! # Ok::<(), lumenmesh::Error>(())
//! ```

mod branching;
mod centreline;
mod course;
mod curve;
mod faults;
mod insertion;
mod kinds;
mod noise;
mod phantom;
mod probe;
mod route;
mod tracker;
mod tree;
mod vessel;

pub use centreline::Centreline;
pub use faults::{
    Artefacts, Burst, CalibrationFaults, ContourFaults, Faults, Motion, PointOrder, Sampling, ShadowFill,
    TrackerFaults,
};
pub use insertion::{Insertion, Move, ReducedBend};
pub use kinds::FaultKind;
pub use noise::{ContourNoise, Noise};
pub use phantom::{Phantom, Shape};
pub use probe::Probe;
pub use route::{Place, Visit};
pub use tracker::TrackerNoise;
pub use tree::Tree;
pub use vessel::SimulatedVessel;

use crate::geometry::Pose;
use crate::output::write_atomically;
use crate::recording::CylinderModel;
use crate::recording::{Frame, Recording};
use crate::setters::setters;
use crate::{Error, Result};
use course::Course;
use glam::{DVec2, DVec3};
use noise::FrameNoise;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// All settings of a simulated recording except the vessel.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct SimulationSettings {
    /// Motion of the catheter.
    pub insertion: Insertion,
    /// The probe.
    pub probe: Probe,
    /// Independent noise, and the seed.
    pub noise: Noise,
    /// Errors beside the noise.
    pub faults: Faults,
    /// Whether every frame carries a local cylinder: the tangent of the centreline at its point nearest to the
    /// tip, and the inscribed radius there, with the noise that [`Noise`] asks for.
    pub cylinders: bool,
    /// Whether every frame carries the phase of the heart, as from an ECG: 0 where the recording begins.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub heart_phase: bool,
}

setters!(SimulationSettings {
    with_insertion => insertion: Insertion,
    with_probe => probe: Probe,
    with_noise => noise: Noise,
    with_faults => faults: Faults,
    with_cylinders => cylinders: bool,
    with_heart_phase => heart_phase: bool,
});

impl SimulationSettings {
    /// Checks what does not depend on the vessel.
    ///
    /// # Errors
    /// [`Error::Setting`] with the first setting out of range.
    pub fn validate(&self) -> Result<()> {
        self.insertion.validate()?;
        self.probe.validate()?;
        self.noise.validate()?;
        self.faults.validate()
    }
}

/// A simulated recording and its truth.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Simulation {
    /// The recording with noise. The probe is the sensor: `eTi` is the identity.
    pub recording: Recording,
    /// The same frames without any fault, in the vessel at rest: true poses, wall points exactly on the wall.
    pub truth_recording: Recording,
    /// Of every frame, which branch the catheter is in, and where.
    pub places: Vec<Place>,
    /// The vessel.
    pub vessel: SimulatedVessel,
    /// Bends that were reduced to keep the tip in the lumen.
    pub reduced_bends: Vec<ReducedBend>,
}

impl Simulation {
    /// Simulates a recording. The same vessel and settings give the same numbers, whatever the number of
    /// threads.
    ///
    /// # Errors
    /// [`Error::Setting`] for settings that are out of range or do not suit the vessel, [`Error::Surface`] where
    /// the catheter's tip would leave the lumen.
    pub fn run(vessel: SimulatedVessel, settings: &SimulationSettings) -> Result<Self> {
        Self::run_and_tell(vessel, settings, &|_, _| ())
    }

    /// As [`Simulation::run`], with progress: `tell(frames done, frames in all)` is called from any thread.
    ///
    /// # Errors
    /// As [`Simulation::run`].
    pub fn run_and_tell(
        vessel: SimulatedVessel,
        settings: &SimulationSettings,
        tell: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Self> {
        settings.validate()?;
        let path = settings.insertion.plan(&vessel, 1.0 - settings.noise.pulsation_fraction)?;
        let repeats = settings.faults.sampling.repeats;
        let points = path.ticks() as f64 * settings.probe.rays as f64 * repeats as f64;
        if points > MAX_POINTS {
            let found = format!("{points:.0} points in all");
            return Err(Error::setting(
                "probe.rays",
                found,
                format!("at most {MAX_POINTS:.0}: fewer rays or frames"),
            ));
        }
        let of = Tracking {
            drift: settings.noise.drift(path.ticks(), path.time_s(1)),
            course: Course::new(&settings.faults, &settings.noise, path.ticks(), path.time_s(1)),
            path,
        };
        let path = &of.path;
        let ticks: Vec<usize> = (0..path.ticks()).filter(|&tick| path.is_recorded(tick)).collect();
        let done = std::sync::atomic::AtomicUsize::new(0);
        let pairs = ticks
            .par_iter()
            .map(|&tick| {
                path.check(&vessel, path.time_s(tick))?;
                let pair = frame(&vessel, settings, &of, tick);
                tell(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, ticks.len());
                Ok(pair)
            })
            // Collecting results in parallel would give the first error in time, not in frame order.
            .collect::<Vec<Result<_>>>()
            .into_iter()
            .collect::<Result<Vec<_>>>()?;
        let places = ticks.iter().map(|&tick| path.place(path.time_s(tick)));
        // A recorder that is faster than the probe stores every frame several times.
        let times = |number: usize, frame: &Frame| {
            let step_s = path.time_s(1) * number as f64 / repeats as f64;
            frame.clone().with_time_s(frame.time_s.map(|time_s| time_s + step_s))
        };
        let repeated = |frame: &Frame| (0..repeats).map(|number| times(number, frame)).collect::<Vec<_>>();
        let places = places.flat_map(|place| std::iter::repeat_n(place, repeats)).collect();
        let recording = pairs.iter().flat_map(|(recorded, _)| repeated(recorded)).collect();
        let truth = pairs.iter().flat_map(|(_, truth)| repeated(truth)).collect();
        let path = of.path;
        let reduced_bends = path.reduced_bends;
        Ok(Self {
            recording: Recording { frames: recording },
            truth_recording: Recording { frames: truth },
            places,
            vessel,
            reduced_bends,
        })
    }
}

impl Simulation {
    /// Writes `places` as CSV with the columns `frame` (from 0), `time_s`, `visit`, `branch` and `s_mm`.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_places(&self, path: &std::path::Path) -> Result<()> {
        write_atomically(path, |out| {
            let mut table = csv::Writer::from_writer(out);
            table.write_record(["frame", "time_s", "visit", "branch", "s_mm"])?;
            for (number, (place, frame)) in self.places.iter().zip(&self.truth_recording.frames).enumerate() {
                let time_s = frame.time_s.map_or(String::new(), |time| time.to_string());
                let [visit, branch] = [place.visit, place.branch].map(|n| n.to_string());
                table.write_record([number.to_string(), time_s, visit, branch, place.s_mm.to_string()])?;
            }
            table.flush()
        })
    }
}

/// The most points of a recording: some 100 GB.
const MAX_POINTS: f64 = 2e9;

/// The catheter's motion, and what the tracker makes of it.
struct Tracking<'a> {
    path: insertion::Path<'a>,
    /// Of every tick, the drift's position (mm) and rotation vector (rad).
    drift: Vec<(DVec3, DVec3)>,
    course: Course<'a>,
}

/// The frame of a tick as recorded, and in truth.
fn frame(
    vessel: &SimulatedVessel,
    settings: &SimulationSettings,
    Tracking { path, drift, course }: &Tracking,
    tick: usize,
) -> (Frame, Frame) {
    let SimulationSettings { probe, noise, .. } = settings;
    let time_s = path.time_s(tick);
    let tip = path.tip(time_s);
    let true_ranges = probe.ranges_mm(vessel, &tip);
    let scale = noise.vessel_scale(time_s);
    let ranges = if scale == 1.0 {
        true_ranges.clone()
    } else {
        let middle = path.line(time_s).at(path.station_mm(time_s)).0;
        probe.ranges_in_scaled_mm(vessel, &tip, middle, scale)
    };
    let mut of_frame = noise.of_frame(tick);
    let tracked = |of_frame: &mut FrameNoise, tick: usize| {
        let seen_s = path.time_s(tick) - noise.latency_s;
        let tip = path.tip(seen_s);
        let shifted = Pose { translation_mm: tip.translation_mm + course.shift_mm(seen_s), ..tip };
        course.slow(of_frame.pose(&shifted, drift[tick]), tick, seen_s)
    };
    let own = tracked(&mut of_frame, tick);
    let tracked = match course.pose_of(tick) {
        earlier if earlier != tick => tracked(&mut noise.of_frame(earlier), earlier),
        _ => own,
    };
    let tracked = course.stored(tracked, tick);
    let true_cylinder = settings
        .cylinders
        .then(|| local_cylinder(path, time_s, &tip, (DVec2::ZERO, DVec2::ZERO, 0.0)))
        .flatten();
    let cylinder_noise = of_frame.cylinder();
    let cylinder = settings.cylinders.then(|| local_cylinder(path, time_s, &tip, cylinder_noise)).flatten();
    let true_contour = contour(&true_ranges, probe, |range, direction| direction * range);
    let phase = settings.heart_phase.then_some(noise.pulsation_rate_hz * time_s);
    let of_time = |frame: Frame| frame.with_time_s(Some(time_s)).with_phase(phase);
    let truth = of_time(Frame::new(tip, true_contour)).with_cylinder(true_cylinder);
    let angles: Vec<f64> = (0..probe.rays).map(|ray| probe.angle_rad(ray)).collect();
    // A missing echo stays one: the larger of NaN and 0 would be 0.
    let not_behind = |range: f64| if range < 0.0 { 0.0 } else { range };
    let off =
        ranges.iter().zip(&angles).map(|(range, &angle)| not_behind(range + course.smooth_mm(tick, angle)));
    let noisy_contour = noisy_contour(&off.collect::<Vec<_>>(), probe, &mut of_frame);
    let noisy_contour = course.contour_mm(tick, time_s, &angles, noisy_contour);
    let recorded = of_time(Frame::new(tracked, noisy_contour)).with_cylinder(cylinder);
    (recorded, truth)
}

fn contour(ranges_mm: &[f64], probe: &Probe, mut point: impl FnMut(f64, DVec2) -> DVec2) -> Vec<DVec2> {
    ranges_mm
        .iter()
        .enumerate()
        .map(|(ray, &range)| {
            let p = point(range, probe.direction(ray));
            if p.is_nan() { DVec2::NAN } else { p }
        })
        .collect()
}

fn noisy_contour(ranges_mm: &[f64], probe: &Probe, noise: &mut FrameNoise) -> Vec<DVec2> {
    contour(ranges_mm, probe, |range, direction| noise.contour_point(range, direction, probe.range_mm))
}

/// The vessel about a frame as a cylinder in `{e}`; `None` where its axis runs along the plane z = 0.
fn local_cylinder(
    path: &insertion::Path,
    time_s: f64,
    tip: &Pose,
    (position, axis, radius): (DVec2, DVec2, f64),
) -> Option<CylinderModel> {
    let centreline = path.line(time_s);
    let station = path.station_mm(time_s);
    let s = centreline.nearest_mm(tip.translation_mm, station, path.bending_length_mm());
    let local = tip.inverse() * centreline.frame(s);
    let axis = (local.rotation * axis.extend(1.0)).normalize();
    if axis.z.abs() < 0.1 {
        return None;
    }
    let middle = local.translation_mm;
    let p = middle - axis * (middle.z / axis.z);
    let radius_mm = (centreline.inscribed_radius_at_mm(s) + radius).max(0.1);
    Some(CylinderModel::from_axis(p.x + position.x, p.y + position.y, axis, radius_mm))
}

fn within(name: &'static str, value: f64, low: f64, high: f64) -> Result<()> {
    // NaN is in no range.
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(Error::setting(name, value, format!("{low} to {high}")))
    }
}
