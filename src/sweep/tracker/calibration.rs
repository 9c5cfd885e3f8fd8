//! Self-calibration: errors of the probe's place on the sensor, of the speed of sound and of time, and mirrored images, as far
//! as the wall shows them where it is seen more than once.
//!
//! A wrong calibration puts the same wall at another place for every tilt, bend and speed. Its errors are global parameters of
//! the model of wall and poses ([`joint`](super::joint)): Gauss-Newton steps with radii and pose errors eliminated, each about
//! a wall that is fitted anew.

use super::joint::{BendingPrior, GlobalEquations, Joint, NoiseLevels, STRETCHES, Velocity, corrected};
use super::{Estimate, Estimator, FITS, SIGNIFICANT, moved, velocities};
use crate::error::{StageProgress, unless_cancelled};
use crate::geometry::Pose;
use crate::numerics::cholesky::{self, Matrix, cholesky, dot, inverse_column};
use crate::recording::Recording;
use crate::settings::{Backend, Calibration, Settings};
use crate::sweep::prepare::Prepared;
use crate::sweep::prepare::axis::Axis;
use crate::sweep::prepare::contour::Outlines;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::{Corners, WallGrid};
use crate::sweep::wall::engine::{self, WallDevice};
use crate::sweep::wall::fit::{Aim, Checkpoint, Wall};
use crate::{Error, Result};
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use serde::Serialize;
use std::cell::Cell;
use std::f64::consts::{PI, TAU};

/// The errors of a calibration, as far as a recording shows them.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SelfCalibration {
    /// Offset of the true probe from the calibrated one along that one's x, y and z, its rotation about them, by how much the
    /// speed of sound exceeds the assumed one, and how much older poses are than contours.
    pub parameters: [CalibrationParameter; PARAMETERS],
    /// Whether images are mirrored; `None` where the recording does not tell.
    pub mirror: Option<Mirror>,
    /// Whether the estimate converged.
    pub converged: bool,
    /// Rounds of linearisation.
    pub rounds: usize,
}

/// A parameter of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CalibrationParameter {
    /// What it is called.
    pub name: &'static str,
    /// Unit of its values.
    pub unit: &'static str,
    /// What the calibration lacks.
    pub estimate: f64,
    /// The standard error of that; where the recording tells nothing, the size of usual errors.
    pub standard_error: f64,
    /// Whether the standard error is below a third of the size of usual errors.
    pub told: bool,
    /// What a correction adds: parameters that are told and significant, as they are likeliest when the other ones are 0.
    pub correction: f64,
}

/// Whether images are mirrored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Mirror {
    /// They are not.
    No,
    /// y stands for -y.
    Y,
    /// x stands for -x.
    X,
}

impl Mirror {
    /// The plane of the image turned over: what is mirrored is seen from behind.
    fn turned_over(self) -> Pose {
        let rotation = match self {
            Self::No => return Pose::IDENTITY,
            Self::Y => DMat3::from_rotation_x(PI),
            Self::X => DMat3::from_rotation_y(PI),
        };
        Pose { rotation, ..Pose::IDENTITY }
    }
}

const PARAMETERS: usize = 8;
type Parameters = [f64; PARAMETERS];

const DEGREES: f64 = 180.0 / PI;
/// Names, units, and how many of the unit make 1 mm, rad, relative change or s.
const NAMES: [(&str, &str, f64); PARAMETERS] = [
    ("offset x", "mm", 1.0),
    ("offset y", "mm", 1.0),
    ("offset z", "mm", 1.0),
    ("rotation x", "deg", DEGREES),
    ("rotation y", "deg", DEGREES),
    ("rotation z", "deg", DEGREES),
    ("speed of sound", "%", 100.0),
    ("time", "s", 1.0),
];
/// Standard deviations that the errors have beforehand, in mm, rad, relative change and s: 3 mm, 5°, 5 %, 0.3 s. They hold
/// back what the recording does not tell.
const USUAL: Parameters = [3.0, 3.0, 3.0, 5.0 / DEGREES, 5.0 / DEGREES, 5.0 / DEGREES, 0.05, 0.3];
/// What is told has a standard error below this share of the usual error.
const TOLD: f64 = 1.0 / 3.0;
const MAX_ROUNDS: usize = 10;
/// Number of segments of the recording whose scatter says whether residuals have become smaller.
const SEGMENTS: usize = 32;
/// Frames before and after that smooth the course of the probe, and how near they lie, in lumen radii.
const SMOOTHED_FRAMES: usize = 5;
const NEAR_RADII: f64 = 0.5;
/// Rounds end when all steps are shorter than this share of their standard errors.
const ENOUGH_ERRORS: f64 = 0.3;
/// Points of a contour that are used; more take longer and tell little.
const MAX_RAYS: usize = 64;
/// Velocities are slopes over this time before and after. Over a shorter one they are so noisy that in a straight pullback the
/// noise, which is different from frame to frame, seems to tell that there is no offset in time.
const MOTION_WINDOW_S: f64 = 1.0;
/// λ, as a share of that of the fit, where a wall only follows what is asked of it.
const BENDING_SHARE: f64 = 1e-3;
/// What the model gets wrong of all echoes alike, as a share of the noise. However many echoes there are, changes of the
/// residuals that are smaller tell nothing: with half of it, a single pass along an arch whose tracker had noise seemed to tell a
/// rotation by -20°.
const MODEL_ERROR: f64 = 0.01;
/// What is corrected is beyond this many standard errors. For independent noise they are two to three times the errors; of
/// errors that neighbours share, a tenth is beyond two of them, and 3 % are beyond 2.5.
const CORRECTED_ERRORS: f64 = 2.5;
/// Beyond so many standard deviations an echo says that it is off the wall, not how far.
const MOST_SDS: f64 = 3.0;

/// What a calibration lacks.
#[derive(Clone, Copy)]
struct Correction {
    mirror: Mirror,
    /// The true probe in the axes of the calibrated one, whose image may have been turned over.
    probe: Pose,
    /// The true speed of sound by the assumed one.
    sound_speed: f64,
    seconds: f64,
}

impl Correction {
    fn of(mirror: Mirror) -> Self {
        Self { mirror, probe: Pose::IDENTITY, sound_speed: 1.0, seconds: 0.0 }
    }

    /// Its values, in units of the [usual errors](USUAL).
    fn in_usual(&self) -> Parameters {
        let [x, y, z] = self.probe.translation_mm.to_array();
        let turn = self.probe.quaternion().normalize();
        let [a, b, c] = (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis().to_array();
        let values = [x, y, z, a, b, c, self.sound_speed - 1.0, self.seconds];
        std::array::from_fn(|i| values[i] / USUAL[i])
    }

    /// With a step from here, in units of the usual errors and in the axes of the corrected probe.
    fn stepped(&self, step: &Parameters) -> Self {
        let [x, y, z, a, b, c, sound_speed, seconds] = std::array::from_fn(|i| step[i] * USUAL[i]);
        let turn = DQuat::from_scaled_axis(DVec3::new(a, b, c));
        let step = Pose { rotation: DMat3::from_quat(turn), translation_mm: DVec3::new(x, y, z) };
        Self {
            probe: self.probe * step,
            sound_speed: self.sound_speed * (1.0 + sound_speed),
            seconds: self.seconds + seconds,
            ..*self
        }
    }

    /// The recording and the settings with the correction.
    fn applied(
        &self,
        recording: &Recording,
        settings: &Settings,
        velocities: &[Velocity],
    ) -> (Recording, Settings) {
        let mut recording = recording.clone();
        let sensors: Vec<Pose> = recording.frames.iter().map(|frame| frame.world_from_sensor).collect();
        for (frame, pose) in recording.frames.iter_mut().zip(moved(&sensors, velocities, self.seconds)) {
            frame.cylinder = None;
            frame.world_from_sensor = pose;
            frame.contour_mm.iter_mut().for_each(|p| *p *= self.sound_speed);
        }
        let probe = settings.calibration.sensor_from_probe() * self.mirror.turned_over() * self.probe;
        let calibration = Calibration::default()
            .with_position_mm(probe.translation_mm.to_array())
            .with_quaternion(probe.quaternion().normalize().to_array());
        (recording, settings.clone().with_calibration(calibration))
    }
}

/// The recording with at most [`MAX_RAYS`] points in a contour.
fn thinned(recording: &Recording) -> Recording {
    let mut recording = recording.clone();
    for frame in &mut recording.frames {
        let contour_mm = &mut frame.contour_mm;
        let points = contour_mm.len();
        if points > MAX_RAYS {
            *contour_mm = (0..MAX_RAYS).map(|i| contour_mm[i * points / MAX_RAYS]).collect();
        }
    }
    recording
}

/// The velocities of the poses; all 0 without times that increase, which then tell nothing of an offset.
fn velocities_of(recording: &Recording) -> Vec<Velocity> {
    velocities(&recording.frames, MOTION_WINDOW_S)
        .unwrap_or_else(|_| vec![Velocity::default(); recording.frames.len()])
}

/// A recording to be calibrated.
struct Calibrator<'a> {
    recording: &'a Recording,
    settings: Settings,
    velocities: Vec<Velocity>,
    checkpoint: &'a Checkpoint<'a>,
}

/// Where probes lie in their planes on a smooth course: means over up to [`SMOOTHED_FRAMES`] frames before and as many after,
/// as long as they lie within `near_mm`.
///
/// An error of a pose that is part of a derivative as well as of the residual biases the estimate: the vessel would shrink, or
/// grow, without end. Across the plane a probe lies where its echoes do.
fn smoothed_mm(probes: &[Pose], near_mm: f64) -> Vec<DVec3> {
    let of_frame = |k: usize| {
        let here_mm = probes[k].translation_mm;
        let (mut shift_mm, mut count) = (DVec3::ZERO, 1.0);
        for j in 1..=SMOOTHED_FRAMES.min(k).min(probes.len() - 1 - k) {
            let shifts_mm = [k - j, k + j].map(|other| probes[other].translation_mm - here_mm);
            if shifts_mm.iter().any(|shift| shift.length() > near_mm) {
                break;
            }
            shift_mm += shifts_mm[0] + shifts_mm[1];
            count += 2.0;
        }
        let normal = probes[k].rotation.z_axis;
        let shift_mm = shift_mm / count;
        here_mm + shift_mm - normal * normal.dot(shift_mm)
    };
    (0..probes.len()).map(of_frame).collect()
}

/// The points of a wall at the nodes of its grid, and its normals there by their share along the rays from the axis.
fn wall_nodes(axis: &Axis, grid: &WallGrid, radii_mm: &[f64]) -> Vec<(DVec3, DVec3)> {
    let at = |ring: usize, node: usize| {
        let theta_rad = node as f64 * TAU / grid.nodes as f64;
        axis.at(ring as f64, theta_rad, radii_mm[ring * grid.nodes + node])
    };
    let of_node = |i: usize| {
        let (ring, node) = (i / grid.nodes, i % grid.nodes);
        let (point, directions) = at(ring, node);
        let along = at((ring + 1).min(grid.rings - 1), node).0 - at(ring.saturating_sub(1), node).0;
        let around = at(ring, (node + 1) % grid.nodes).0 - at(ring, (node + grid.nodes - 1) % grid.nodes).0;
        let normal = around.cross(along);
        (point, normal / normal.dot(directions.x_axis))
    };
    (0..grid.node_count()).into_par_iter().map(of_node).collect()
}

/// How far the echoes lie from the wall that was fitted under a correction.
struct Residuals {
    /// Standard deviation of an echo about the wall, in mm as recorded.
    noise_mm: f64,
    /// Frame and standardised residual of each echo, in mm as recorded.
    of_echoes: Vec<(usize, f64)>,
}

impl Residuals {
    fn of(echoes: &[Echo], wall: &Wall, correction: &Correction) -> Self {
        let of_echo = |echo: &Echo| (echo.frame as usize, echo.residual_mm / correction.sound_speed);
        Self {
            noise_mm: wall.noise_mm / correction.sound_speed,
            of_echoes: echoes.iter().map(of_echo).collect(),
        }
    }
}

/// The model about the wall that was fitted under a correction.
struct Linearised {
    residuals: Residuals,
    /// The information on the parameters, in units of their [usual errors](USUAL).
    information: Matrix<PARAMETERS>,
    /// What each stretch of the vessel adds to the gradient.
    scores: [Parameters; STRETCHES],
}

impl Calibrator<'_> {
    /// How far the echoes lie from a wall that is fitted to them.
    fn residuals(&self, correction: &Correction) -> Result<Residuals> {
        let (recording, settings) = correction.applied(self.recording, &self.settings, &self.velocities);
        let prepared = Prepared::of(&recording, Outlines::of(&recording.frames), &settings)?;
        let (echoes, wall) = self.fitted(&prepared, &settings)?;
        Ok(Residuals::of(&echoes, &wall, correction))
    }

    fn fitted(&self, prepared: &Prepared, settings: &Settings) -> Result<(Vec<Echo>, Wall)> {
        let mut echoes = prepared.echoes(&prepared.sensors());
        // Its settings ask for the CPU.
        let (aim, device) = (Aim::alone(settings.sweep.roughness), WallDevice::default());
        let (wall, _) = engine::fit(&prepared.grid, &mut echoes, settings, aim, &device, self.checkpoint)?;
        Ok((echoes, wall))
    }

    fn linearised(&self, correction: &Correction) -> Result<Linearised> {
        let (recording, settings) = correction.applied(self.recording, &self.settings, &self.velocities);
        let prepared = Prepared::of(&recording, Outlines::of(&recording.frames), &settings)?;
        let Prepared { grid, axis, .. } = &prepared;
        let (echoes, wall) = self.fitted(&prepared, &settings)?;
        let residuals = Residuals::of(&echoes, &wall, correction);
        let roughness = settings.sweep.roughness;
        let sensors = prepared.sensors();
        let found = Estimator { prepared: &prepared, roughness }.estimate(&sensors, None, echoes, wall)?;
        let Estimate { errors, echoes, mut wall, .. } = found;
        let radius_mm = grid.radius_mm();
        let right: Vec<Pose> =
            sensors.iter().zip(&errors).map(|(pose, error)| corrected(pose, error, radius_mm)).collect();
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let probes: Vec<Pose> = right.iter().map(|&sensor| sensor * sensor_from_probe).collect();
        let origins_mm = smoothed_mm(&probes, NEAR_RADII * radius_mm);
        // By how much the parameters move a point of the wall that a frame shows.
        let displacements = |frame: usize, on_wall: DVec3| {
            let arm = on_wall - origins_mm[frame];
            let DMat3 { x_axis: x, y_axis: y, z_axis: z } = probes[frame].rotation;
            let Velocity { shift_mm, turn_rad } = self.velocities[frame];
            let later = shift_mm + turn_rad.cross(on_wall - right[frame].translation_mm);
            [x, y, z, x.cross(arm), y.cross(arm), z.cross(arm), arm, later]
        };
        // Between the nodes of the grid effects are linear, as the wall is: what it can follow it then follows exactly. The
        // rest of a curve between two nodes would be taken for what the recording tells.
        let nodes = wall_nodes(axis, grid, &wall.radii_mm);
        let effects_mm = |frame: usize, corners: &Corners| {
            let mut sums = [0.0; PARAMETERS];
            for (&node, weight) in corners.nodes.iter().zip(corners.weights) {
                let (on_wall, normal) = nodes[node];
                let moved = displacements(frame, on_wall);
                sums.iter_mut().zip(moved).for_each(|(sum, moved)| *sum += weight * normal.dot(moved));
            }
            sums
        };
        let joint = Joint::about(grid, axis, &echoes, &wall, &right, &errors, |_, _| Default::default())
            .with_effects_mm(effects_mm);
        let levels = NoiseLevels { noise_mm: wall.noise_mm, shift_mm: found.shift_sd_mm };
        let mut prior = BendingPrior::default();
        let levels = joint.fit(levels, FITS, roughness, &mut prior, &mut wall.radii_mm)?.levels;
        // How the wall may bend says nothing of a calibration: only wall that is seen more than once does.
        let mut weak = prior.weakened(grid.rings, BENDING_SHARE);
        joint.fit(levels, 1, roughness, &mut weak, &mut wall.radii_mm)?;
        let GlobalEquations { information, scores } =
            joint.global_equations(levels, roughness, &weak, &wall.radii_mm)?;
        let shared = 1.0 + MODEL_ERROR.powi(2) * echoes.len() as f64;
        let per_mm2 = 1.0 / (levels.noise_mm.powi(2) * shared);
        // Symmetric but for the tolerance of the solver.
        let between = |i: usize, j: usize| 0.5 * (information[i][j] + information[j][i]);
        let in_usual = |i: usize, j: usize| between(i, j) * per_mm2 * USUAL[i] * USUAL[j];
        Ok(Linearised {
            residuals,
            information: std::array::from_fn(|i| std::array::from_fn(|j| in_usual(i, j))),
            scores: scores.map(|score| std::array::from_fn(|i| score[i] * per_mm2 * USUAL[i])),
        })
    }

    /// By how much mean squares of the residuals of `b` are larger than those of `a`, in standard errors, from the scatter over
    /// segments of the recording.
    fn excess(&self, a: &Residuals, b: &Residuals) -> f64 {
        let most_mm2 = (MOST_SDS * a.noise_mm.min(b.noise_mm)).powi(2);
        let frames = &self.recording.frames;
        let segment = frames.len().div_ceil(SEGMENTS);
        let losses = |residuals: &Residuals| {
            // Echoes beyond the ends of the axis are as bad as those off the wall.
            let mut sums = vec![0.0; frames.len().div_ceil(segment)];
            for (k, frame) in frames.iter().enumerate() {
                sums[k / segment] += most_mm2 * frame.echoes_mm().count() as f64;
            }
            for &(frame, residual_mm) in &residuals.of_echoes {
                sums[frame / segment] += (residual_mm * residual_mm).min(most_mm2) - most_mm2;
            }
            sums
        };
        let differences: Vec<f64> = losses(a).iter().zip(losses(b)).map(|(a, b)| b - a).collect();
        let count = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let square = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (count - 1.0) / count;
        if square > 0.0 { mean / square.sqrt() } else { 0.0 }
    }

    /// Whether images are mirrored: residuals tell it, or not.
    fn mirror(&self, as_recorded: &Residuals) -> Option<Mirror> {
        // A wall that cannot be fitted is none.
        let excess = |mirror: Mirror| {
            let mirrored = self.residuals(&Correction::of(mirror));
            mirrored.map_or(f64::INFINITY, |mirrored| self.excess(as_recorded, &mirrored))
        };
        let [y, x] = [Mirror::Y, Mirror::X].map(excess);
        let (least, mirror) = if x < y { (x, Mirror::X) } else { (y, Mirror::Y) };
        match least {
            _ if least < -SIGNIFICANT => Some(mirror),
            _ if least > SIGNIFICANT => Some(Mirror::No),
            _ => None,
        }
    }
}

/// The posterior of the parameters in one round, in units of their usual errors.
struct Posterior {
    /// The inverse of the covariance matrix: usual errors have the information 1.
    precision: Matrix<PARAMETERS>,
    step: Parameters,
    standard_errors: Parameters,
}

impl Posterior {
    /// From the values that a correction has.
    fn of(linearised: &Linearised, values: &Parameters) -> Result<Self> {
        let Linearised { information, scores, .. } = linearised;
        let mut precision = *information;
        (0..PARAMETERS).for_each(|i| precision[i][i] += 1.0);
        let factor = factored(&precision)?;
        let total = std::array::from_fn(|i| scores.iter().map(|s| s[i]).sum::<f64>() - values[i]);
        // Model errors are alike in neighbouring frames, so the scatter of whole stretches counts as well.
        let moved = scores.map(|score| cholesky::solve(&factor, score));
        let error = |i: usize| {
            let column = inverse_column(&factor, i);
            let scatter: f64 = moved.iter().map(|m| m[i] * m[i]).sum();
            column[i].max(dot(&column, &column) + scatter).sqrt()
        };
        Ok(Self {
            precision,
            step: cholesky::solve(&factor, total),
            standard_errors: std::array::from_fn(error),
        })
    }

    /// Those of these values that are told and significant, as they are likeliest when the other ones are 0.
    fn significant(&self, values: &Parameters) -> Result<Parameters> {
        let errors = &self.standard_errors;
        let kept: [bool; PARAMETERS] =
            std::array::from_fn(|i| errors[i] < TOLD && values[i].abs() > CORRECTED_ERRORS * errors[i]);
        let among = |i: usize, j: usize| match kept[i] && kept[j] {
            true => self.precision[i][j],
            false => f64::from(u8::from(i == j)),
        };
        let factor = factored(&std::array::from_fn(|i| std::array::from_fn(|j| among(i, j))))?;
        let pull = |i: usize| if kept[i] { dot(&self.precision[i], values) } else { 0.0 };
        Ok(cholesky::solve(&factor, std::array::from_fn(pull)))
    }
}

fn factored(precision: &Matrix<PARAMETERS>) -> Result<Matrix<PARAMETERS>> {
    cholesky(precision).ok_or_else(|| Error::Recording {
        field: "calibration",
        found: "equations of its errors that are not positive definite".into(),
        expected: "finite echoes and a finite noise above 0".into(),
    })
}

impl SelfCalibration {
    /// Estimates the errors of the settings' calibration, on the CPU, from the longest path through the vessel. `progress` is
    /// called as by [`Sweep::run`](crate::sweep::Sweep::run).
    ///
    /// # Errors
    /// As [`Sweep::of`](crate::sweep::Sweep::of), and where the equations of the errors are not positive definite.
    pub fn of(recording: &Recording, settings: &Settings, progress: &StageProgress) -> Result<Self> {
        settings.validate()?;
        recording.check()?;
        let rounds = Cell::new(0);
        let checkpoint = || unless_cancelled(progress("calibrating", rounds.get(), MAX_ROUNDS));
        let recording = &thinned(recording);
        let calibrator = Calibrator {
            recording,
            settings: settings.clone().with_backend(Backend::Cpu),
            velocities: velocities_of(recording),
            checkpoint: &checkpoint,
        };
        let as_recorded = calibrator.linearised(&Correction::of(Mirror::No))?;
        let mirror = calibrator.mirror(&as_recorded.residuals);
        let turned_over = mirror.filter(|mirror| *mirror != Mirror::No);
        let start = Correction::of(turned_over.unwrap_or(Mirror::No));
        let before = if turned_over.is_some() { calibrator.linearised(&start)? } else { as_recorded };
        let mut correction = start;
        let mut posterior = Posterior::of(&before, &start.in_usual())?;
        let converged = loop {
            rounds.set(rounds.get() + 1);
            // Beyond the usual errors a step is not linear.
            let longest = posterior.step.iter().fold(1.0, |most: f64, step| most.max(step.abs()));
            correction = correction.stepped(&posterior.step.map(|step| step / longest));
            let mut steps = posterior.step.iter().zip(&posterior.standard_errors);
            let converged = steps.all(|(step, error)| step.abs() <= ENOUGH_ERRORS * error);
            if converged || rounds.get() == MAX_ROUNDS {
                break converged;
            }
            posterior = Posterior::of(&calibrator.linearised(&correction)?, &correction.in_usual())?;
        };
        let estimate = correction.in_usual();
        let mut significant = posterior.significant(&estimate)?;
        if significant != [0.0; PARAMETERS] {
            let after = calibrator.residuals(&start.stepped(&significant))?;
            if !converged || calibrator.excess(&before.residuals, &after) >= 0.0 {
                significant = [0.0; PARAMETERS];
            }
        }
        let parameter = |i: usize| {
            let (name, unit, factor) = NAMES[i];
            let [estimate, standard_error, correction] =
                [estimate[i], posterior.standard_errors[i], significant[i]].map(|x| x * USUAL[i] * factor);
            let told = converged && posterior.standard_errors[i] < TOLD;
            CalibrationParameter { name, unit, estimate, standard_error, told, correction }
        };
        Ok(Self { parameters: std::array::from_fn(parameter), mirror, converged, rounds: rounds.get() })
    }

    /// A recording and its settings with the correction; as they are where there is nothing to correct.
    pub fn corrected(&self, recording: &Recording, settings: &Settings) -> (Recording, Settings) {
        let start = Correction::of(self.mirror.unwrap_or(Mirror::No));
        let step = std::array::from_fn(|i| self.parameters[i].correction / NAMES[i].2 / USUAL[i]);
        if start.mirror == Mirror::No && step == [0.0; PARAMETERS] {
            return (recording.clone(), settings.clone());
        }
        start.stepped(&step).applied(recording, settings, &velocities_of(recording))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Insertion, Noise, Phantom, Probe, Shape, Simulation, SimulationSettings};

    /// What errors of poses explain is left out once, so a tracker with noise makes no step shorter.
    #[test]
    fn steps_lead_to_the_same_place_from_wherever_they_start() {
        let settings = SimulationSettings::default()
            .with_insertion(Insertion::default().with_frame_rate_hz(6.0))
            .with_probe(Probe::default().with_rays(48))
            .with_noise(Noise::default().with_seed(3).with_position_sd_mm(0.5));
        let vessel = Phantom::from("stenosis".parse::<Shape>().unwrap()).vessel().unwrap();
        let recording = Simulation::run(vessel, &settings).unwrap().recording;
        let calibrator = Calibrator {
            recording: &recording,
            settings: Settings::default().with_backend(Backend::Cpu),
            velocities: velocities_of(&recording),
            checkpoint: &|| Ok(()),
        };
        let goal = |off: &Parameters| {
            let start = Correction::of(Mirror::No).stepped(off);
            let found = Posterior::of(&calibrator.linearised(&start).unwrap(), &start.in_usual()).unwrap();
            start.stepped(&found.step).in_usual()
        };
        let mut off = [0.0; PARAMETERS];
        let from_right = goal(&off);
        (off[0], off[1]) = (0.3, -0.3);
        let from_wrong = goal(&off);
        for i in [0, 1] {
            let left = (from_wrong[i] - from_right[i]) / off[i];
            assert!(left.abs() < 0.3, "{}: {left} of the error is left", NAMES[i].0);
        }
    }
}
