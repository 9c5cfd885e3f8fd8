//! Which frames lie on the path that the sensor takes from frame to frame.

use super::{LeftOut, Reason};
use crate::geometry::Pose;
use crate::numerics::robust::median;
use crate::recording::Frame;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Steps that are longer than these are jumps.
///
/// A step is the way of a contour's points, at most: the shift, and the turn at the contours' median radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Median of the contours' radii, mm.
    radius_mm: f64,
    /// The usual step, mm.
    usual_mm: f64,
    /// Longer steps are jumps, mm.
    jump_mm: f64,
}

/// A step is a jump where it is longer than this many of the usual ones …
const JUMP_STEPS: f64 = 10.0;
/// … and than this share of the contours' median radius.
const JUMP_RADII: f64 = 0.5;
/// The usual step is this quantile of the frames' steps: as many may be rests, and the others jumps …
const USUAL_QUANTILE: f64 = 0.7;
/// … where a frame's step is the shortest to so many frames after it. The frames before a single one that is off then have
/// a step past it, so that [`Screening::MAX_SHARE`](super::Screening::MAX_SHARE) of the frames may be off, scattered or not.
const STEPS_AHEAD: usize = 3;
/// The price of a jump, in frames: runs at the ends of a recording that are shorter, and runs within it that are shorter than
/// twice that, are left out …
pub(super) const JUMP_PRICE: f64 = 40.0;
/// … but in short recordings the price is at most this share of the frames.
const JUMP_PRICE_SHARE: f64 = 0.25;
/// With fewer frames nothing tells a jump from a step.
const MIN_FRAMES: usize = 5;
/// Runs that a path may pass over at a time.
const MAX_RUNS_BACK: usize = 512;
/// Runs whose jumps are looked at side by side.
const RUNS_AT_ONCE: usize = 256;

/// Where a frame was taken.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Place {
    pose: Pose,
    /// Median distance of the echoes from the contour's centroid, mm.
    radius_mm: Option<f64>,
}

impl Place {
    pub fn of(frame: &Frame) -> Self {
        let distance = |centre: DVec2| frame.echoes_mm().map(|p| p.distance(centre)).collect::<Vec<f64>>();
        let radius_mm = frame.centroid_mm().map(|centre| median(&mut distance(centre)));
        Self { pose: frame.world_from_sensor, radius_mm }
    }

    pub fn pose(&self) -> Pose {
        self.pose
    }

    pub fn radius_mm(&self) -> Option<f64> {
        self.radius_mm
    }
}

/// The way of a contour's points between two poses, mm: at most the shift, and the turn at the contour's radius.
pub(super) fn step_mm(a: &Pose, b: &Pose, radius_mm: f64) -> f64 {
    a.translation_mm.distance(b.translation_mm) + radius_mm * a.turn_rad(b)
}

/// The usual one of some steps or changes: [`USUAL_QUANTILE`] of them all; 0 where there are none.
pub(super) fn usual(mut steps: Vec<f64>) -> f64 {
    steps.sort_unstable_by(f64::total_cmp);
    steps.get((USUAL_QUANTILE * steps.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(0.0)
}

impl Limits {
    /// The limits that a sequence of frames shows; `None` without contours.
    pub fn of<'a>(places: impl Iterator<Item = &'a Place>) -> Option<Self> {
        let places: Vec<&Place> = places.collect();
        let mut radii: Vec<f64> = places.iter().filter_map(|place| place.radius_mm).collect();
        if radii.is_empty() {
            return None;
        }
        let radius_mm = median(&mut radii);
        let shortest_mm = |i: usize| {
            let ahead = places[i + 1..].iter().take(STEPS_AHEAD);
            ahead.map(|after| step_mm(&places[i].pose, &after.pose, radius_mm)).min_by(f64::total_cmp)
        };
        Some(Self::new(radius_mm, (0..places.len()).into_par_iter().filter_map(shortest_mm).collect()))
    }

    /// The limits that a median radius and steps show.
    pub fn new(radius_mm: f64, steps_mm: Vec<f64>) -> Self {
        let usual_mm = usual(steps_mm);
        Self { radius_mm, usual_mm, jump_mm: (JUMP_STEPS * usual_mm).max(JUMP_RADII * radius_mm) }
    }

    pub fn radius_mm(&self) -> f64 {
        self.radius_mm
    }

    pub fn usual_mm(&self) -> f64 {
        self.usual_mm
    }

    pub fn step_mm(&self, a: &Place, b: &Place) -> f64 {
        step_mm(&a.pose, &b.pose, self.radius_mm)
    }

    /// Whether it is a jump from a frame to one that was taken `gap` frames later: the sensor goes on meanwhile, one usual step
    /// for each frame.
    pub fn is_jump(&self, a: &Place, b: &Place, gap: usize) -> bool {
        self.step_mm(a, b) > self.jump_mm + self.usual_mm * gap.saturating_sub(1) as f64
    }

    /// Whether a frame is off the nearest frames on the path.
    pub fn is_away(&self, place: &Place, on_path: &[&Place]) -> bool {
        self.away_mm(place, on_path) > self.jump_mm
    }

    fn away_mm(&self, place: &Place, on_path: &[&Place]) -> f64 {
        on_path.iter().map(|near| self.step_mm(near, place)).fold(f64::INFINITY, f64::min)
    }

    /// Why a frame is left out whose pose is off the nearest frames on the path.
    pub fn why(&self, frame: usize, place: &Place, on_path: &[&Place]) -> LeftOut {
        let away_mm = self.away_mm(place, on_path);
        LeftOut {
            place: frame,
            frame,
            reason: Reason::OffPath,
            field: "pose",
            found: format!("{away_mm:.1} mm off the path of the other frames{}", known(&place.pose)),
            expected: format!(
                "steps of at most {:.1} mm, turns at the contour's radius included",
                self.jump_mm
            ),
        }
    }
}

/// The price of a jump, in frames of a path through so many.
pub(super) fn jump_price(frames: usize) -> f64 {
    JUMP_PRICE.min(JUMP_PRICE_SHARE * frames as f64)
}

/// Frames without a jump in between.
struct Run {
    /// Indices of its first and last frame in the list of places.
    first: usize,
    last: usize,
}

/// The frames, of those at `numbers`, that lie off the path of the others.
///
/// The path is the sequence of frames that maximises the number of its frames less the price of its jumps; it is found by
/// dynamic programming over the runs between jumps.
pub(super) fn off_the_path(numbers: &[usize], places: &[Place]) -> Vec<LeftOut> {
    if places.len() < MIN_FRAMES {
        return Vec::new();
    }
    let Some(limits) = Limits::of(places.iter()) else { return Vec::new() };
    let is_jump = |a: usize, b: usize| limits.is_jump(&places[a], &places[b], numbers[b] - numbers[a]);
    let jumps: Vec<bool> = (1..places.len()).into_par_iter().map(|i| is_jump(i - 1, i)).collect();
    let mut runs = vec![Run { first: 0, last: 0 }];
    for (i, jumps) in (1..).zip(jumps) {
        match runs.last_mut() {
            Some(run) if !jumps => run.last = i,
            _ => runs.push(Run { first: i, last: i }),
        }
    }
    if runs.len() < 2 {
        return Vec::new();
    }
    let kept = best_path(&runs, |a, b| if is_jump(a.last, b.first) { jump_price(places.len()) } else { 0.0 });
    let mut left_out = Vec::new();
    for (r, run) in runs.iter().enumerate().filter(|(r, _)| kept.binary_search(r).is_err()) {
        let next = kept.partition_point(|&k| k < r);
        let before = next.checked_sub(1).map(|n| &places[runs[kept[n]].last]);
        let after = kept.get(next).map(|&n| &places[runs[n].first]);
        let beside: Vec<&Place> = before.into_iter().chain(after).collect();
        left_out.extend((run.first..=run.last).map(|i| limits.why(numbers[i], &places[i], &beside)));
    }
    left_out
}

/// The best path through some of the runs, where it costs a price to go from one to another.
fn best_path(runs: &[Run], price: impl Fn(&Run, &Run) -> f64 + Sync) -> Vec<usize> {
    let count = runs.len();
    // The best path that ends with each of them: its worth, and the one before.
    let mut best: Vec<(f64, Option<usize>)> = Vec::with_capacity(count);
    for first in (0..count).step_by(RUNS_AT_ONCE) {
        let last = count.min(first + RUNS_AT_ONCE);
        let prices = |b: usize| (0..b).rev().take(MAX_RUNS_BACK).map(|a| price(&runs[a], &runs[b])).collect();
        let prices: Vec<Vec<f64>> = (first..last).into_par_iter().map(prices).collect();
        for (b, prices) in (first..last).zip(prices) {
            let mut before = (0.0, None);
            for (a, price) in (0..b).rev().zip(prices) {
                let worth = best[a].0 - price;
                if worth > before.0 {
                    before = (worth, Some(a));
                }
            }
            let frames = runs[b].last - runs[b].first + 1;
            best.push((frames as f64 + before.0, before.1));
        }
    }
    let mut path = Vec::new();
    let mut at = (0..count).max_by(|&a, &b| best[a].0.total_cmp(&best[b].0).then(b.cmp(&a)));
    while let Some(run) = at {
        path.push(run);
        at = best[run].1;
    }
    path.reverse();
    path
}

/// What a pose that trackers send for a lost sensor looks like.
fn known(pose: &Pose) -> &'static str {
    match (pose.translation_mm == DVec3::ZERO, pose.rotation == DMat3::IDENTITY) {
        (true, true) => " (the identity: a lost sensor)",
        (true, false) => " (at the origin: a lost sensor)",
        _ => "",
    }
}

/// Whether a pose is one that trackers send for a lost sensor. A sensor can also be there.
pub(super) fn is_lost_value(pose: &Pose) -> bool {
    pose.translation_mm == DVec3::ZERO
}

/// A pose that trackers send for a lost sensor is taken for one where it lies this many usual steps, and one for each frame
/// in between, off the nearest other poses before and after.
pub(super) const LOST_STEPS: f64 = 3.0;

/// The frames, of those at `numbers`, whose pose is one that trackers send for a lost sensor, unless the sensor may have
/// been there.
pub(super) fn lost(numbers: &[usize], places: &[Place]) -> Vec<LeftOut> {
    let is_lost: Vec<bool> = places.iter().map(|place| is_lost_value(&place.pose)).collect();
    let others = places.iter().zip(&is_lost).filter(|(_, lost)| !**lost).map(|(place, _)| place);
    let Some(limits) = Limits::of(others) else { return Vec::new() };
    let mut nearest_mm = vec![f64::INFINITY; places.len()];
    let mut is_off = vec![true; places.len()];
    let mut compare = |order: &mut dyn Iterator<Item = usize>| {
        let mut other: Option<usize> = None;
        for i in order {
            if !is_lost[i] {
                other = Some(i);
            } else if let Some(other) = other {
                let step_mm = step_mm(&places[other].pose, &places[i].pose, limits.radius_mm);
                nearest_mm[i] = nearest_mm[i].min(step_mm);
                is_off[i] &= step_mm > limits.usual_mm * (LOST_STEPS + i.abs_diff(other) as f64 - 1.0);
            }
        }
    };
    compare(&mut (0..places.len()));
    compare(&mut (0..places.len()).rev());
    (0..places.len())
        .filter(|&i| is_lost[i] && is_off[i] && nearest_mm[i].is_finite())
        .map(|i| lost_frame(numbers[i], nearest_mm[i], &places[i]))
        .collect()
}

pub(super) fn lost_frame(frame: usize, away_mm: f64, place: &Place) -> LeftOut {
    LeftOut {
        place: frame,
        frame,
        reason: Reason::Lost,
        field: "pose",
        found: format!("{away_mm:.1} mm off the path of the other frames{}", known(&place.pose)),
        expected: "a measured pose".into(),
    }
}
