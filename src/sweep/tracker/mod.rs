//! The tracker's errors, as far as the echoes show them: an offset in time, and a small error of every pose.
//!
//! They start from a wall that is fitted to the recorded poses. Wall and errors about it form one model ([`joint`]); its
//! errors are subtracted from the poses, the echoes are placed again, and the fit of the wall continues.

mod calibration;
mod joint;

use crate::geometry::Pose;
use crate::recording::Frame;
use crate::recording::echo_error::CONTOUR_OUT_OF_PLANE;
use crate::settings::SweepSettings;
use crate::sweep::prepare::Prepared;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::wall::engine::refit;
use crate::sweep::wall::fit::{Checkpoint, Wall};
use crate::{Error, Result};
pub use calibration::{CalibrationParameter, Mirror, SelfCalibration};
use glam::{DMat3, DQuat, DVec2, DVec3};
use joint::{BendingPrior, Joint, NoiseLevels, Offset, Twist, Velocity, corrected, split};
use serde::Serialize;

/// The estimated errors of the tracker, and the part of them that was corrected.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct Tracker {
    /// Standard deviation of a pose's shift along each axis, mm; a rotation of as many degrees belongs to it.
    pub noise_mm: f64,
    /// Root mean square length of the estimated shifts, mm; shifts along the vessel are not observable and remain.
    pub shift_mm: f64,
    /// Root mean square angle of the estimated rotations, degrees.
    pub turn_deg: f64,
    /// Whether shifts and rotations were corrected: not where they are larger than a tracker's errors, do not lower the
    /// noise of the echoes about the wall, or do not bring rays nearer to the wall that had no part in the estimate.
    pub poses_corrected: bool,
    /// How much older than its contour a pose is, s; `None` where it was not estimated.
    pub offset_s: Option<f64>,
    /// Standard error of that, s.
    pub offset_standard_error_s: Option<f64>,
    /// Whether the offset was corrected: within three standard errors it counts as 0, and beyond 5 s it has run away.
    pub offset_corrected: bool,
    /// Steps of the solver.
    pub solver_steps: usize,
}

/// Rounds of linearisation; with an offset they go on until a step is below this share of its standard error.
const MIN_ROUNDS: usize = 2;
const MAX_ROUNDS: usize = 6;
const ENOUGH_ERRORS: f64 = 0.3;
/// Steps for the offset are taken to be too short by at most this factor.
const MIN_FACTOR: f64 = 0.2;
/// Fits in a round, each with the noise levels of the one before.
const FITS: usize = 4;
/// The initial noise of the poses, as a share of the echoes'.
const START_SHARE: f64 = 0.3;
/// Larger corrections than this many lumen radii or degrees, as root mean squares, are no errors of a tracker: the estimate
/// has run away, as it does where the poses have no errors that it could find.
const MAX_SHIFT_RADII: f64 = 0.25;
const MAX_TURN_DEG: f64 = 15.0;
/// An offset beyond this many standard errors is significant.
const SIGNIFICANT: f64 = 3.0;
/// An offset beyond this is no delay of a tracker or a recorder: the estimate has run away.
const MAX_OFFSET_S: f64 = 5.0;
/// Velocities are slopes over the frames within this time before and after, and over at least one frame on each side.
/// Noise of 0.3 mm at 12 frames per second then makes 0.15 mm/s; from one frame to the next it would make 2.5 mm/s. Such
/// noise makes offsets too small; slopes over a longer time make them too large where the motion changes.
const VELOCITY_WINDOW_S: f64 = 0.75;

impl Tracker {
    /// Estimates the errors that `settings` ask for, and corrects poses of the sensor, echoes and wall; `None` where they ask for
    /// none.
    ///
    /// # Errors
    /// Where an offset is to be estimated and times are missing or do not increase, or the equations of a frame's error
    /// are not positive definite.
    pub(in crate::sweep) fn correct(
        prepared: &Prepared,
        settings: &SweepSettings,
        sensors: &mut Vec<Pose>,
        echoes: &mut Vec<Echo>,
        wall: &mut Wall,
        checkpoint: &Checkpoint,
    ) -> Result<Option<Self>> {
        if !settings.correct_poses && !settings.estimate_offset {
            return Ok(None);
        }
        let Prepared { grid, frames, .. } = prepared;
        let estimator = Estimator { prepared, roughness: settings.roughness };
        let mut report = Self::default();
        if settings.estimate_offset {
            let velocities = velocities(frames, VELOCITY_WINDOW_S)?;
            let found = estimator.estimate(sensors, Some(&velocities), echoes.clone(), wall.clone())?;
            let Offset { seconds, standard_error_s } = found.offset;
            report.noise_mm = found.shift_sd_mm;
            report.solver_steps += found.solver_steps;
            report.offset_s = Some(seconds);
            report.offset_standard_error_s = Some(standard_error_s);
            report.offset_corrected =
                seconds.abs() > SIGNIFICANT * standard_error_s && seconds.abs() <= MAX_OFFSET_S;
            if report.offset_corrected {
                *sensors = moved(sensors, &velocities, seconds);
                *echoes = prepared.echoes(sensors);
                estimator.project(echoes, wall);
                *wall = refit(grid, echoes, settings.roughness, wall.clone(), checkpoint)?;
            }
        }
        if settings.correct_poses {
            let mut found = estimator.estimate(sensors, None, echoes.clone(), wall.clone())?;
            let refitted = refit(grid, &mut found.echoes, settings.roughness, found.wall, checkpoint)?;
            let parts: Vec<_> = found.errors.iter().map(|e| split(e, grid.radius_mm())).collect();
            let rms = |of: fn(&(DVec3, DVec3)) -> f64| {
                (parts.iter().map(of).sum::<f64>() / parts.len().max(1) as f64).sqrt()
            };
            report.noise_mm = found.shift_sd_mm;
            report.solver_steps += found.solver_steps;
            report.shift_mm = rms(|(shift, _)| shift.length_squared());
            report.turn_deg = rms(|(_, turn)| turn.length_squared()).to_degrees();
            report.poses_corrected = report.shift_mm <= MAX_SHIFT_RADII * grid.radius_mm()
                && report.turn_deg <= MAX_TURN_DEG
                && refitted.noise_mm <= wall.noise_mm
                && improves_held_out(prepared, settings.roughness, sensors, wall, checkpoint)?;
            if report.poses_corrected {
                let without =
                    |(pose, error): (&mut Pose, &Twist)| *pose = corrected(pose, error, grid.radius_mm());
                sensors.iter_mut().zip(&found.errors).for_each(without);
                (*echoes, *wall) = (found.echoes, refitted);
            }
        }
        Ok(Some(report))
    }
}

/// Whether corrections that every second ray of each contour asks for bring the other rays nearer to the wall of the former:
/// where poses have no errors, corrections fit the rays' noise, and the others then lie farther off.
fn improves_held_out(
    prepared: &Prepared,
    roughness: f64,
    sensors: &[Pose],
    wall: &Wall,
    checkpoint: &Checkpoint,
) -> Result<bool> {
    let every_second = |first: usize| -> Vec<Frame> {
        let half = |frame: &Frame| {
            let mut frame = frame.clone();
            frame.contour_mm.iter_mut().skip(1 - first).step_by(2).for_each(|p| *p = DVec2::NAN);
            frame
        };
        prepared.frames.iter().map(half).collect()
    };
    let (used, others) = (every_second(0), every_second(1));
    let (used, others) = (prepared.with_contours(&used), prepared.with_contours(&others));
    let estimator = Estimator { prepared: &used, roughness };
    let mut echoes = used.echoes(sensors);
    estimator.project(&mut echoes, wall);
    let as_recorded = refit(&used.grid, &mut echoes, roughness, wall.clone(), checkpoint)?;
    let mut found = estimator.estimate(sensors, None, echoes, as_recorded.clone())?;
    let with_corrections = refit(&used.grid, &mut found.echoes, roughness, found.wall, checkpoint)?;
    // Beyond three standard deviations an echo says that it is off the wall, not how far.
    let most_mm2 = (3.0 * as_recorded.noise_mm).powi(2);
    let error_mm2 = |sensors: &[Pose], wall: &Wall| -> f64 {
        let mut echoes = others.echoes(sensors);
        estimator.project(&mut echoes, wall);
        let count = echoes.len().max(1) as f64;
        echoes.iter().map(|echo| (echo.residual_mm * echo.residual_mm).min(most_mm2)).sum::<f64>() / count
    };
    let radius_mm = used.grid.radius_mm();
    let now: Vec<Pose> = sensors.iter().zip(&found.errors).map(|(p, e)| corrected(p, e, radius_mm)).collect();
    Ok(error_mm2(&now, &with_corrections) < error_mm2(sensors, &as_recorded))
}

/// Estimates the errors of a recording's poses.
struct Estimator<'a> {
    prepared: &'a Prepared<'a>,
    roughness: f64,
}

/// The estimated errors, and echoes and wall without them.
struct Estimate {
    errors: Vec<Twist>,
    shift_sd_mm: f64,
    offset: Offset,
    solver_steps: usize,
    echoes: Vec<Echo>,
    wall: Wall,
}

impl Estimator<'_> {
    /// Estimates the errors of the poses, and with `velocities` the offset along them: at the same time, since each could
    /// otherwise be mistaken for the other.
    fn estimate(
        &self,
        sensors: &[Pose],
        velocities: Option<&[Velocity]>,
        mut echoes: Vec<Echo>,
        mut wall: Wall,
    ) -> Result<Estimate> {
        let Prepared { grid, axis, .. } = self.prepared;
        let still = vec![Velocity::default(); sensors.len()];
        let along = velocities.unwrap_or(&still);
        let mut levels = NoiseLevels { noise_mm: wall.noise_mm, shift_mm: START_SHARE * wall.noise_mm };
        let mut errors = vec![Twist::default(); sensors.len()];
        let mut offset = Offset { seconds: 0.0, standard_error_s: f64::INFINITY };
        let mut search = Search::new();
        let mut prior = BendingPrior::default();
        let mut now = sensors.to_vec();
        let mut solver_steps = 0;
        wall.out_of_plane = CONTOUR_OUT_OF_PLANE;
        for round in 0..MAX_ROUNDS {
            let joint = Joint::about(grid, axis, &echoes, &wall, &now, &errors, |frame, point| {
                let Velocity { shift_mm, turn_rad } = along[frame];
                [shift_mm + turn_rad.cross(point - now[frame].translation_mm)]
            });
            let fit = joint.fit(levels, FITS, self.roughness, &mut prior, &mut wall.radii_mm)?;
            let mut is_offset_left = false;
            if velocities.is_some() {
                let step = joint.offset(fit.levels, self.roughness, &prior, &wall.radii_mm)?;
                // Not finite without any motion.
                if step.seconds.is_finite() {
                    let step = search.step(offset.seconds, step);
                    offset.seconds += step.seconds;
                    offset.standard_error_s = step.standard_error_s;
                    is_offset_left = step.seconds.abs() > ENOUGH_ERRORS * step.standard_error_s;
                }
            }
            levels = fit.levels;
            errors = fit.errors;
            solver_steps += fit.solver_steps;
            wall.noise_mm = levels.noise_mm;
            now = moved(sensors, along, offset.seconds);
            now.iter_mut()
                .zip(&errors)
                .for_each(|(pose, error)| *pose = corrected(pose, error, grid.radius_mm()));
            echoes = self.prepared.echoes(&now);
            self.project(&mut echoes, &wall);
            if round + 1 >= MIN_ROUNDS && !is_offset_left {
                break;
            }
        }
        Ok(Estimate { errors, shift_sd_mm: levels.shift_mm, offset, solver_steps, echoes, wall })
    }

    /// Moves the echoes' projections until they converge.
    fn project(&self, echoes: &mut [Echo], wall: &Wall) {
        wall.residual_model(&self.prepared.grid).project_all(echoes);
    }
}

/// The search for the offset at which Gauss-Newton steps are 0.
///
/// Steps are too short by about the same factor, mostly 0.7 to 1 in simulated recordings. Noise of the wall's slopes and of the
/// velocities, which makes the information about an offset too large, is one reason. Two steps determine the factor: they
/// decrease by as much as the offset explains of them.
struct Search {
    /// The offset before the last step and the step, s.
    before: Option<(f64, f64)>,
    factor: f64,
}

impl Search {
    fn new() -> Self {
        Self { before: None, factor: 1.0 }
    }

    /// The step from an offset, and its standard error, at full length.
    fn step(&mut self, at_s: f64, step: Offset) -> Offset {
        if let Some((at_before_s, step_before_s)) = self.before {
            let moved_s = at_s - at_before_s;
            // Over a shorter interval the difference of two steps is mostly noise.
            if moved_s.abs() > step.standard_error_s {
                self.factor = ((step_before_s - step.seconds) / moved_s).clamp(MIN_FACTOR, 1.0);
            }
        }
        self.before = Some((at_s, step.seconds));
        Offset {
            // Beyond the window a step is not linear.
            seconds: (step.seconds / self.factor).clamp(-VELOCITY_WINDOW_S, VELOCITY_WINDOW_S),
            standard_error_s: step.standard_error_s / self.factor,
        }
    }
}

/// The poses `seconds` later along their motion. Interpolation between neighbours would average the noise away halfway
/// between two frames, and bias the offset towards there.
fn moved(sensors: &[Pose], velocities: &[Velocity], seconds: f64) -> Vec<Pose> {
    let moved = |(pose, motion): (&Pose, &Velocity)| Pose {
        rotation: DMat3::from_quat(DQuat::from_scaled_axis(motion.turn_rad * seconds)) * pose.rotation,
        translation_mm: pose.translation_mm + motion.shift_mm * seconds,
    };
    sensors.iter().zip(velocities).map(moved).collect()
}

/// The velocity of the pose at each frame: slopes of position and of the rotation vector from that frame, over the frames
/// within this time before and after.
fn velocities(frames: &[Frame], window_s: f64) -> Result<Vec<Velocity>> {
    let needed = |frame, found: String| Error::Frame {
        frame,
        field: "time",
        found,
        expected: "times that increase, for an offset in time to be estimated".into(),
    };
    let mut times_s = Vec::with_capacity(frames.len());
    for (k, frame) in frames.iter().enumerate() {
        let time_s = frame.time_s.ok_or_else(|| needed(k, "none".into()))?;
        if times_s.last().is_some_and(|last| time_s <= *last) {
            return Err(needed(k, format!("{time_s} s, not after the frame before")));
        }
        times_s.push(time_s);
    }
    let of_frame = |k: usize| {
        let first = times_s.partition_point(|t| *t < times_s[k] - window_s).min(k.saturating_sub(1));
        let end = times_s.partition_point(|t| *t <= times_s[k] + window_s).max(k + 2);
        let window = first..end.min(frames.len());
        let mean_s = times_s[window.clone()].iter().sum::<f64>() / window.len() as f64;
        let here = &frames[k].world_from_sensor;
        let (mut motion, mut square) = (Velocity::default(), 0.0);
        for j in window {
            let there = &frames[j].world_from_sensor;
            let turn = DQuat::from_mat3(&(there.rotation * here.rotation.transpose())).normalize();
            let turn = (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis();
            let lever = times_s[j] - mean_s;
            square += lever * lever;
            motion.shift_mm += (there.translation_mm - here.translation_mm) * lever;
            motion.turn_rad += turn * lever;
        }
        if square > 0.0 {
            motion.shift_mm /= square;
            motion.turn_rad /= square;
        }
        motion
    };
    Ok((0..frames.len()).map(of_frame).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_motion_is_found_and_followed() {
        let (speed, spin) = (DVec3::new(2.0, 0.0, -1.0), DVec3::new(0.0, 0.3, 0.0));
        let at = |time_s: f64| Pose {
            rotation: DMat3::from_quat(DQuat::from_scaled_axis(spin * time_s)) * DMat3::from_rotation_x(1.0),
            translation_mm: speed * time_s,
        };
        let frame = |k: u32| {
            let time_s = 0.08 * f64::from(k);
            Frame::new(at(time_s), Vec::new()).with_time_s(Some(time_s))
        };
        let frames: Vec<Frame> = (0..30).map(frame).collect();
        let sensors: Vec<Pose> = frames.iter().map(|f| f.world_from_sensor).collect();
        let later = moved(&sensors, &velocities(&frames, VELOCITY_WINDOW_S).unwrap(), 0.2);
        for (frame, pose) in frames.iter().zip(later) {
            let there = at(frame.time_s.unwrap() + 0.2);
            assert!(pose.translation_mm.distance(there.translation_mm) < 1e-9, "{pose:?}");
            assert!(pose.rotation.abs_diff_eq(there.rotation, 1e-9), "{pose:?}");
        }
    }
}
