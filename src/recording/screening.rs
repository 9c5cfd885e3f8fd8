//! Which frames of a recording are fit to be used: poses are judged before they become anatomy.

use super::{Frame, Recording};
use crate::geometry::Pose;
use crate::numerics::robust::median;
use crate::{Error, Result};
use serde::Serialize;
use std::borrow::Cow;

/// The frames of a recording that a reconstruction leaves out, and why.
///
/// A tracker that loses its sensor repeats a fixed pose, sends zeros or jumps. A frame is left out where it has a
/// [defect](Frame::defects), or where its pose lies off the path of the others. The path is the sequence of frames that
/// maximises the number of its frames less a price for each of its jumps, a step that is longer than the sensor's usual
/// ones explain; it is found by dynamic programming. So a lost frame or a short run of them is left out, wherever it
/// stands, whereas a sensor that is moved elsewhere and stays there is not.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Screening {
    /// Frames of the recording.
    pub frames: usize,
    /// The frames that are left out, in their order.
    pub left_out: Vec<LeftOut>,
}

/// A frame that is left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LeftOut {
    /// The frame (0-based).
    pub frame: usize,
    /// The quantity that is to blame.
    pub field: &'static str,
    /// What was there.
    pub found: String,
    /// What should have been there.
    pub expected: String,
}

/// A step is a jump where it is longer than this many of the sensor's usual ones …
const JUMP_STEPS: f64 = 10.0;
/// … and than this share of the contours' median radius.
const JUMP_RADII: f64 = 0.5;
/// The usual step is this quantile of all steps: a quarter of them may be jumps, or three quarters of them rests.
const USUAL_QUANTILE: f64 = 0.75;
/// The price of a jump, in frames: runs at the ends of a recording that are shorter, and runs within it that are shorter
/// than twice that, are left out …
const JUMP_PRICE: f64 = 40.0;
/// … but in short recordings the price is this share of the frames.
const JUMP_PRICE_SHARE: f64 = 0.25;
/// With fewer frames nothing tells a jump from a step.
const MIN_FRAMES: usize = 5;

impl Screening {
    /// Largest share of a recording's frames that may be left out: with more, nothing tells which frames are right.
    pub const MAX_SHARE: f64 = 0.25;

    /// Leaves no frame out.
    pub fn none(recording: &Recording) -> Self {
        Self { frames: recording.frames.len(), left_out: Vec::new() }
    }

    /// Screens a recording.
    pub fn of(recording: &Recording) -> Self {
        let frames = &recording.frames;
        let mut left_out = Vec::new();
        let mut sound = Vec::with_capacity(frames.len());
        for (k, frame) in frames.iter().enumerate() {
            match frame.defects().into_iter().next() {
                None => sound.push(k),
                Some(defect) => left_out.push(LeftOut {
                    frame: k,
                    field: defect.field,
                    found: defect.found,
                    expected: defect.expected.into(),
                }),
            }
        }
        left_out.extend(off_the_path(frames, &sound));
        left_out.sort_by_key(|one| one.frame);
        Self { frames: frames.len(), left_out }
    }

    /// The recording with the contours of the frames that are left out emptied, and with their poses taken from the
    /// nearest frame that is kept: frames keep their numbers.
    ///
    /// # Errors
    /// [`Error::Frame`] with the first frame that is left out where these are more than [`Screening::MAX_SHARE`] of all.
    pub fn apply<'a>(&self, recording: &'a Recording) -> Result<Cow<'a, Recording>> {
        let Some(first) = self.left_out.first() else { return Ok(Cow::Borrowed(recording)) };
        if self.left_out.len() as f64 > Self::MAX_SHARE * self.frames as f64 {
            let LeftOut { frame, field, found, expected } = first.clone();
            let count = self.left_out.len();
            return Err(Error::Frame {
                frame,
                field,
                found: format!("{found}; {count} of {} frames are unfit", self.frames),
                expected,
            });
        }
        let mut screened = recording.clone();
        let mut is_kept = vec![true; self.frames];
        self.left_out.iter().for_each(|one| is_kept[one.frame] = false);
        for LeftOut { frame, .. } in &self.left_out {
            let nearest = (1..self.frames).find_map(|away| {
                let before = frame.checked_sub(away).filter(|&k| is_kept[k]);
                before.or(Some(frame + away).filter(|&k| k < self.frames && is_kept[k]))
            });
            let pose = nearest.map_or(Pose::IDENTITY, |k| recording.frames[k].world_from_sensor);
            let time_s = recording.frames[*frame].time_s.filter(|t| t.is_finite());
            screened.frames[*frame] = Frame::new(pose, Vec::new()).with_time_s(time_s);
        }
        Ok(Cow::Owned(screened))
    }

    /// Refuses what would be left out.
    ///
    /// # Errors
    /// [`Error::Frame`] with the first frame that would be left out.
    pub fn refuse(&self) -> Result<()> {
        match self.left_out.first().cloned() {
            None => Ok(()),
            Some(LeftOut { frame, field, found, expected }) => {
                Err(Error::Frame { frame, field, found, expected })
            }
        }
    }
}

/// The way of a contour's points between two poses, mm: at most the shift, and the turn at the contour's radius.
fn step_mm(a: &Pose, b: &Pose, radius_mm: f64) -> f64 {
    let turn = a.rotation.transpose() * b.rotation;
    let trace = turn.x_axis.x + turn.y_axis.y + turn.z_axis.z;
    let angle_rad = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos();
    a.translation_mm.distance(b.translation_mm) + radius_mm * angle_rad
}

/// A run of frames without a jump in between.
struct Run {
    /// Indices of its first and last frame in the list of sound frames.
    first: usize,
    last: usize,
}

/// The sound frames whose poses lie off the path of the others.
fn off_the_path(frames: &[Frame], sound: &[usize]) -> Vec<LeftOut> {
    if sound.len() < MIN_FRAMES {
        return Vec::new();
    }
    let pose = |i: usize| &frames[sound[i]].world_from_sensor;
    let mut radii: Vec<f64> = sound
        .iter()
        .filter_map(|&k| {
            let centre = frames[k].centroid_mm()?;
            Some(median(&mut frames[k].echoes_mm().map(|p| p.distance(centre)).collect::<Vec<_>>()))
        })
        .collect();
    if radii.is_empty() {
        return Vec::new();
    }
    let radius_mm = median(&mut radii);
    let steps: Vec<f64> = (1..sound.len()).map(|i| step_mm(pose(i - 1), pose(i), radius_mm)).collect();
    let mut sorted = steps.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let usual_mm = sorted[(USUAL_QUANTILE * (sorted.len() - 1) as f64) as usize];
    let jump_mm = (JUMP_STEPS * usual_mm).max(JUMP_RADII * radius_mm);
    let mut runs = vec![Run { first: 0, last: sound.len() - 1 }];
    for (i, &step) in steps.iter().enumerate() {
        if step > jump_mm {
            if let Some(run) = runs.last_mut() {
                run.last = i;
            }
            runs.push(Run { first: i + 1, last: sound.len() - 1 });
        }
    }
    if runs.len() < 2 {
        return Vec::new();
    }
    let price = JUMP_PRICE.min(JUMP_PRICE_SHARE * sound.len() as f64);
    // The sensor moves on during a gap: one usual step for each frame between the runs.
    let is_jump = |a: &Run, b: &Run| {
        let gap = (sound[b.first] - sound[a.last]) as f64;
        step_mm(pose(a.last), pose(b.first), radius_mm) > jump_mm + usual_mm * (gap - 1.0)
    };
    // The best path that ends with each run: its worth, and the run before.
    let mut best: Vec<(f64, Option<usize>)> = Vec::with_capacity(runs.len());
    for (b, run) in runs.iter().enumerate() {
        let length = (run.last - run.first + 1) as f64;
        let mut before = (0.0, None);
        for a in (0..b).rev().take(MAX_RUNS_BACK) {
            let worth = best[a].0 - if is_jump(&runs[a], run) { price } else { 0.0 };
            if worth > before.0 {
                before = (worth, Some(a));
            }
        }
        best.push((length + before.0, before.1));
    }
    let mut on_path = vec![false; runs.len()];
    let mut at = (0..runs.len()).max_by(|&a, &b| best[a].0.total_cmp(&best[b].0).then(b.cmp(&a)));
    while let Some(run) = at {
        on_path[run] = true;
        at = best[run].1;
    }
    let kept: Vec<usize> = (0..runs.len()).filter(|&run| on_path[run]).collect();
    let mut left_out = Vec::new();
    for (r, run) in runs.iter().enumerate().filter(|(r, _)| !on_path[*r]) {
        let next = kept.partition_point(|&k| k < r);
        let neighbours =
            [next.checked_sub(1).map(|n| runs[kept[n]].last), kept.get(next).map(|&n| runs[n].first)];
        for (i, &frame) in sound.iter().enumerate().take(run.last + 1).skip(run.first) {
            let away_mm = neighbours
                .iter()
                .flatten()
                .map(|&n| step_mm(pose(n), pose(i), radius_mm))
                .fold(f64::INFINITY, f64::min);
            left_out.push(LeftOut {
                frame,
                field: "pose",
                found: format!("{away_mm:.1} mm off the path of the other frames{}", known(pose(i))),
                expected: format!("steps of at most {jump_mm:.1} mm, turns at the contour's radius included"),
            });
        }
    }
    left_out
}

/// Runs that a path may pass over at a time.
const MAX_RUNS_BACK: usize = 512;

/// What a pose that trackers send for a lost sensor looks like.
fn known(pose: &Pose) -> &'static str {
    match (pose.translation_mm == glam::DVec3::ZERO, pose.rotation == glam::DMat3::IDENTITY) {
        (true, true) => " (the identity: a lost sensor)",
        (true, false) => " (at the origin: a lost sensor)",
        _ => "",
    }
}
