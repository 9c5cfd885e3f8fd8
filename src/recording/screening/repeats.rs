//! Poses and contours that a recorder repeats because no new ones came.

use super::{LeftOut, Reason};
use crate::geometry::Pose;
use crate::numerics::robust::median;
use crate::recording::Frame;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// A source that is slower than the recorder repeats each value at most so many times …
pub(super) const MAX_SLOW_RUN: usize = 12;
/// … and that shows after this many values.
pub(super) const MIN_SLOW_RUNS: usize = 10;
/// Poses of a noisy tracker that agree in all digits at least so often in a row are repeated.
pub(super) const MIN_FROZEN: usize = 3;
/// A frozen pose is followed by a step of at least this share of the way that the sensor usually makes in that time …
const CATCH_UP_SHARE: f64 = 0.5;
/// … and of at least so many usual steps.
const CATCH_UP_STEPS: f64 = 3.0;
/// Second differences of a path show noise where they are larger than this share of its steps: a smooth path's are not.
const NOISE_SHARE: f64 = 0.3;
/// Third differences of a contour's points show noise where they are larger than this share of the points' distances: those
/// of an ellipse of sixteen points are 0.15 of them.
const CONTOUR_NOISE_SHARE: f64 = 0.5;
/// Contours of fewer points do not tell noise from shape.
const MIN_POINTS: usize = 16;

/// The frames, of those at `numbers`, whose pose or contour repeats the frame before to the last bit although it was not
/// measured anew.
///
/// Measured values have noise and never agree in all digits; computed ones may. So a repeated value is left out where its
/// source has noise, where it is slower than the recorder throughout, or where the sensor catches up afterwards. The first
/// of equal values is kept.
pub(super) fn repeats(frames: &[Frame], numbers: &[usize]) -> Vec<LeftOut> {
    let frames: Vec<&Frame> = numbers.iter().map(|&k| &frames[k]).collect();
    let poses = runs(&frames, |a, b| same_pose(&a.world_from_sensor, &b.world_from_sensor));
    let contours = runs(&frames, |a, b| same_contour(&a.contour_mm, &b.contour_mm));
    let mut left_out: Vec<Option<LeftOut>> = vec![None; frames.len()];
    let mut leave_out = |run: &Run, reason, field, found: &str, expected: &str| {
        for i in run.first + 1..run.first + run.length {
            left_out[i].get_or_insert_with(|| LeftOut {
                place: numbers[i],
                frame: numbers[i],
                reason,
                field,
                found: format!("{found} {}", numbers[run.first]),
                expected: expected.into(),
            });
        }
    };
    let slow_contours = is_slow(&contours);
    if slow_contours || has_contour_noise(&frames) {
        for run in contours.iter().filter(|run| !frames[run.first].contour_mm.is_empty()) {
            leave_out(run, Reason::Repeated, "contour", "the same as in frame", "a new image");
        }
    }
    let motion = Motion::of(&frames, &poses);
    let slow_poses = is_slow(&poses);
    for (r, run) in poses.iter().enumerate() {
        // A recorder that repeats whole frames repeats their contours too: that is told above.
        let stands =
            run.length >= MIN_FROZEN && !super::path::is_lost_value(&frames[run.first].world_from_sensor);
        let after = poses.get(r + 1).map(|next| frames[next.first]);
        if stands && after.is_some_and(|after| motion.catches_up(frames[run.first], after, run.length)) {
            leave_out(
                run,
                Reason::Frozen,
                "pose",
                "the same as in frame",
                "a new measurement: the sensor moved on",
            );
        } else if slow_poses || stands && motion.has_noise {
            leave_out(run, Reason::Repeated, "pose", "the same as in frame", "a new measurement");
        }
    }
    left_out.into_iter().flatten().collect()
}

/// Frames in a row with the same value.
struct Run {
    first: usize,
    length: usize,
}

fn runs(frames: &[&Frame], same: impl Fn(&Frame, &Frame) -> bool) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for i in 0..frames.len() {
        match runs.last_mut() {
            Some(run) if same(frames[i - 1], frames[i]) => run.length += 1,
            _ => runs.push(Run { first: i, length: 1 }),
        }
    }
    runs
}

/// Whether most values come more than once, and none of them often.
fn is_slow(runs: &[Run]) -> bool {
    let repeated = runs.iter().filter(|run| run.length > 1).count();
    runs.len() >= MIN_SLOW_RUNS
        && 2 * repeated > runs.len()
        && runs.iter().all(|run| run.length <= MAX_SLOW_RUN)
}

pub(super) fn same_pose(a: &Pose, b: &Pose) -> bool {
    a.translation_mm == b.translation_mm && a.rotation == b.rotation
}

/// Equal to the last bit, missing echoes included.
pub(super) fn same_contour(a: &[DVec2], b: &[DVec2]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
}

pub(super) fn has_contour_noise(frames: &[&Frame]) -> bool {
    let share = |frame: &&Frame| {
        let points: Vec<DVec2> = frame.echoes_mm().collect();
        let mut steps: Vec<f64> = points.windows(2).map(|p| p[0].distance(p[1])).collect();
        let third = |p: &[DVec2]| (p[3] - 3.0 * (p[2] - p[1]) - p[0]).length();
        let mut changes: Vec<f64> = points.windows(4).map(third).collect();
        (points.len() >= MIN_POINTS).then(|| median(&mut changes) / median(&mut steps))
    };
    let mut shares: Vec<f64> = frames.par_iter().filter_map(share).collect();
    !shares.is_empty() && median(&mut shares) > CONTOUR_NOISE_SHARE
}

/// How the sensor moves from one new pose to the next.
pub(super) struct Motion {
    /// Median step, mm.
    step_mm: f64,
    /// Whether the steps show noise.
    pub has_noise: bool,
}

impl Motion {
    fn of(frames: &[&Frame], poses: &[Run]) -> Self {
        Self::along(poses.iter().map(|run| frames[run.first].world_from_sensor.translation_mm))
    }

    /// Along these positions, mm; equal ones in a row count once.
    pub fn along(positions: impl Iterator<Item = DVec3>) -> Self {
        let mut positions: Vec<DVec3> = positions.collect();
        positions.dedup();
        let steps = || positions.windows(2).map(|p| p[1] - p[0]);
        let mut lengths: Vec<f64> = steps().map(DVec3::length).collect();
        let mut changes: Vec<f64> = steps().zip(steps().skip(1)).map(|(a, b)| a.distance(b)).collect();
        if changes.is_empty() {
            return Self { step_mm: 0.0, has_noise: false };
        }
        let step_mm = median(&mut lengths);
        Self { step_mm, has_noise: median(&mut changes) > NOISE_SHARE * step_mm }
    }

    /// Whether the sensor has moved on while its pose stood still for `length` frames.
    fn catches_up(&self, frozen: &Frame, after: &Frame, length: usize) -> bool {
        let step_mm =
            frozen.world_from_sensor.translation_mm.distance(after.world_from_sensor.translation_mm);
        let way_mm = (CATCH_UP_SHARE * length as f64).max(CATCH_UP_STEPS) * self.step_mm;
        self.step_mm > 0.0 && step_mm >= way_mm
    }
}
