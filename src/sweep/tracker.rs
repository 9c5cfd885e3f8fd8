//! What the tracker got wrong, as far as the echoes show it: an offset in time, and a small error of every pose.
//!
//! A wall fitted to the recorded poses comes first. About it wall and errors are one model ([`super::joint`]), whose
//! errors are taken off the poses; echoes are placed anew and the wall is fitted on, as ever.

use super::axis::Axis;
use super::echo::Echo;
use super::grid::{Grid, Solver};
use super::joint::{Fit, Joint, Levels, Motion, Offset, Twist, corrected, split};
use super::wall::{self, Wall};
use crate::geometry::Pose;
use crate::recording::Frame;
use crate::{Error, Result, settings};
use glam::{DMat3, DQuat, DVec3};
use serde::Serialize;

/// The tracker's errors, as estimated, and what of them was taken off the poses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tracker {
    /// Standard deviation of a pose's shift along each axis, mm; a turn of so many degrees goes with it.
    pub noise_mm: f64,
    /// Root mean square length of the shifts that were taken off, mm; those along the vessel do not show and stay.
    pub shift_mm: f64,
    /// Root mean square angle of the turns that were taken off, degrees.
    pub turn_deg: f64,
    /// How much older than its contour a pose is, s; `None` where it was not asked for.
    pub offset_s: Option<f64>,
    /// Standard error of that, s.
    pub offset_standard_error_s: Option<f64>,
    /// Whether the offset was corrected: it is left at nought within three standard errors.
    pub offset_corrected: bool,
    /// Steps of the solver.
    pub solver_steps: usize,
}

/// Rounds of linearisation for the errors, and fits in each.
const ROUNDS: usize = 2;
const FITS: usize = 4;
/// Most rounds for the offset, which ends earlier when a step is below a tenth of the standard error.
const OFFSET_ROUNDS: usize = 6;
/// An offset counts where it is beyond so many standard errors.
const SIGNIFICANT: f64 = 3.0;
/// Velocities are slopes over the frames that are at most so long before and after, and over one frame each way at
/// the least. Noise of 0.3 mm at 12 frames a second makes 0.3 mm/s over that time, a tenth of a catheter's speed; from
/// one frame to the next it would make 2.5.
const VELOCITY_WINDOW_S: f64 = 0.5;
/// Share of the noise's variance across the image plane when errors of the pose are not part of it. The contours' own
/// noise lies within the plane; the share keeps a wall that runs along the plane from getting all the weight.
const OUT_OF_PLANE: f64 = 0.02;
/// Feet settle on a wall within so many steps.
const FOOT_STEPS: usize = 3;

/// A recording about its axis, whose poses can be moved.
pub(super) struct Scene<'a> {
    pub grid: &'a Grid,
    pub axis: &'a Axis,
    pub frames: &'a [Frame],
    /// The echoes about the axis for other poses of the sensor.
    pub place: &'a dyn Fn(&[Pose]) -> Vec<Echo>,
}

impl Tracker {
    /// Estimates the errors that `settings` ask for, and moves echoes and wall to where they are without them.
    pub(super) fn correct(
        scene: &Scene,
        settings: &settings::Sweep,
        echoes: &mut Vec<Echo>,
        wall: &mut Wall,
    ) -> Result<Self> {
        let recorded: Vec<Pose> = scene.frames.iter().map(|f| f.world_from_sensor).collect();
        let noise_mm = wall.noise_mm;
        let start = Levels { noise_mm, shift_mm: 0.3 * noise_mm };
        let mut work = Work {
            scene,
            solver: Solver::new(*scene.grid),
            roughness: settings.roughness,
            still: vec![Motion::default(); recorded.len()],
            none: vec![Twist::default(); recorded.len()],
            fit: Fit { errors: Vec::new(), levels: start, solver_steps: 0 },
            solver_steps: 0,
        };
        let before = wall.clone();
        let offset = match settings.estimate_offset {
            true => Some(work.offset(&recorded, echoes, wall)?),
            false => None,
        };
        let is_significant =
            |o: &Offset| o.seconds.is_finite() && o.seconds.abs() > SIGNIFICANT * o.standard_error_s;
        let seconds = offset.filter(is_significant).map(|o| o.seconds);
        let sensors = match seconds {
            Some(seconds) => moved(&recorded, &motions(scene.frames)?, seconds),
            None => recorded,
        };
        if offset.is_some() {
            // Only what counts is kept of the search for the offset.
            *wall = before;
            *echoes = (scene.place)(&sensors);
            if seconds.is_some() {
                *wall = wall::refit(scene.grid, echoes, settings.roughness, wall.clone());
            } else {
                work.settle(echoes, wall);
            }
        }
        let errors = match settings.correct_poses {
            true => work.errors(&sensors, echoes, wall),
            false => work.none.clone(),
        };
        if settings.correct_poses {
            *wall = wall::refit(scene.grid, echoes, settings.roughness, wall.clone());
        }
        let parts: Vec<_> = errors.iter().map(|e| split(e, scene.grid.radius_mm())).collect();
        let rms = |of: &dyn Fn(&(DVec3, DVec3)) -> f64| {
            (parts.iter().map(of).sum::<f64>() / parts.len().max(1) as f64).sqrt()
        };
        Ok(Self {
            noise_mm: work.fit.levels.shift_mm,
            shift_mm: rms(&|(shift, _)| shift.length_squared()),
            turn_deg: rms(&|(_, turn)| turn.length_squared()).to_degrees(),
            offset_s: offset.map(|o| o.seconds),
            offset_standard_error_s: offset.map(|o| o.standard_error_s),
            offset_corrected: seconds.is_some(),
            solver_steps: work.solver_steps,
        })
    }
}

/// The work on a scene, and how far it is.
struct Work<'a> {
    scene: &'a Scene<'a>,
    solver: Solver,
    roughness: f64,
    /// For each frame: no motion, and no error.
    still: Vec<Motion>,
    none: Vec<Twist>,
    fit: Fit,
    solver_steps: usize,
}

impl Work<'_> {
    /// Looks for the offset in time; errors of the poses are left free, so that its standard error holds.
    fn offset(&mut self, recorded: &[Pose], echoes: &mut Vec<Echo>, wall: &mut Wall) -> Result<Offset> {
        let motions = motions(self.scene.frames)?;
        let mut found = Offset { seconds: 0.0, standard_error_s: f64::INFINITY };
        wall.out_of_plane = OUT_OF_PLANE;
        for round in 0..OFFSET_ROUNDS {
            let sensors = moved(recorded, &motions, found.seconds);
            if round > 0 {
                *echoes = (self.scene.place)(&sensors);
                self.settle(echoes, wall);
            }
            let none = self.none.clone();
            let step = self.round(&sensors, &none, &motions, echoes, wall);
            if !step.seconds.is_finite() {
                break;
            }
            // Farther than that a step is no longer linear.
            let seconds = step.seconds.clamp(-VELOCITY_WINDOW_S, VELOCITY_WINDOW_S);
            found = Offset { seconds: found.seconds + seconds, standard_error_s: step.standard_error_s };
            if step.seconds.abs() < 0.1 * step.standard_error_s {
                break;
            }
        }
        Ok(found)
    }

    /// Estimates the errors of the poses and takes them off.
    fn errors(&mut self, sensors: &[Pose], echoes: &mut Vec<Echo>, wall: &mut Wall) -> Vec<Twist> {
        let radius_mm = self.scene.grid.radius_mm();
        wall.out_of_plane = OUT_OF_PLANE;
        let mut errors = self.none.clone();
        let mut now = sensors.to_vec();
        for _ in 0..ROUNDS {
            let still = std::mem::take(&mut self.still);
            self.round(&now, &errors, &still, echoes, wall);
            self.still = still;
            errors.clone_from(&self.fit.errors);
            now = sensors.iter().zip(&errors).map(|(pose, e)| corrected(pose, e, radius_mm)).collect();
            *echoes = (self.scene.place)(&now);
            self.settle(echoes, wall);
        }
        errors
    }

    /// One linearisation; gives the offset that is left, as far as there is motion.
    fn round(
        &mut self,
        sensors: &[Pose],
        errors: &[Twist],
        motions: &[Motion],
        echoes: &[Echo],
        wall: &mut Wall,
    ) -> Offset {
        let Scene { grid, axis, .. } = *self.scene;
        let joint = Joint::about((grid, &self.solver), axis, echoes, wall, sensors, errors, motions);
        self.fit = joint.fit(self.fit.levels, FITS, self.roughness, &mut wall.radii_mm);
        wall.noise_mm = self.fit.levels.noise_mm;
        self.solver_steps += self.fit.solver_steps;
        joint.offset(&self.fit, self.roughness, &wall.radii_mm)
    }

    /// Lets the echoes find their feet.
    fn settle(&self, echoes: &mut [Echo], wall: &Wall) {
        for _ in 0..FOOT_STEPS {
            wall::measure(self.scene.grid, echoes, wall, true);
        }
    }
}

/// Poses that are `seconds` later along their motion. Not interpolated between their neighbours: that would average
/// their noise away halfway between two frames, and the offset would be drawn there.
fn moved(sensors: &[Pose], motions: &[Motion], seconds: f64) -> Vec<Pose> {
    let moved = |(pose, motion): (&Pose, &Motion)| Pose {
        rotation: DMat3::from_quat(DQuat::from_scaled_axis(motion.turn_rad * seconds)) * pose.rotation,
        translation_mm: pose.translation_mm + motion.shift_mm * seconds,
    };
    sensors.iter().zip(motions).map(moved).collect()
}

/// How the poses move about each frame: slopes of position and of the rotation vector from that frame.
fn motions(frames: &[Frame]) -> Result<Vec<Motion>> {
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
        let first = times_s.partition_point(|t| *t < times_s[k] - VELOCITY_WINDOW_S).min(k.saturating_sub(1));
        let end = times_s.partition_point(|t| *t <= times_s[k] + VELOCITY_WINDOW_S).max(k + 2);
        let window = first..end.min(frames.len());
        let mean_s = times_s[window.clone()].iter().sum::<f64>() / window.len() as f64;
        let here = &frames[k].world_from_sensor;
        let (mut motion, mut square) = (Motion::default(), 0.0);
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
