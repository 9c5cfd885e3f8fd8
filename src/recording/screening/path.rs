//! Which frames lie on the path that the sensor and the contours take from frame to frame.

use super::{LeftOut, Reason};
use crate::geometry::Pose;
use crate::numerics::robust::median;
use crate::recording::Frame;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Steps that are longer than these are jumps.
///
/// A pose step is the way of a contour's points, at most: the shift, and the turn at the contours' median radius. A shape
/// step is the median change of the logarithm of the distances from the contour's centroid, quantile by quantile, so
/// that neither a turn of the probe nor a branch in a few rays counts. It says something only where the frames lie so
/// near to each other that the wall cannot have changed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Median of the contours' radii, mm.
    radius_mm: f64,
    /// The usual pose step, mm.
    usual_mm: f64,
    /// Longer pose steps are jumps, mm.
    jump_mm: f64,
    /// The usual shape step.
    usual_shape: f64,
    /// Larger shape steps are jumps.
    jump_shape: f64,
}

/// A pose step is a jump where it is longer than this many of the usual ones …
const JUMP_STEPS: f64 = 10.0;
/// … and than this share of the contours' median radius.
const JUMP_RADII: f64 = 0.5;
/// A shape step is a jump where it is larger than this many usual ones and than this: 13 % of the radius. A segmentation that
/// follows the media instead of the lumen is off by some 15 %.
const SHAPE_JUMP_STEPS: f64 = 5.0;
const JUMP_SHAPE: f64 = 0.12;
/// Contours that lie farther apart than this share of the median radius may differ as they like.
const SHAPE_WITHIN_RADII: f64 = 0.5;
/// The usual step is this quantile of the frames' steps: as many may be rests, and the others jumps …
const USUAL_QUANTILE: f64 = 0.7;
/// … where a frame's step is the shortest to so many frames after it. The frames before a single one that is off then have
/// a step past it, so that [`Screening::MAX_SHARE`](super::Screening::MAX_SHARE) of the frames may be off, scattered or not.
const STEPS_AHEAD: usize = 3;
/// The shape does not jump between two runs where the mean shapes of so many frames at their ends differ by less than this share
/// of a jump.
const AVERAGED: usize = 5;
const AVERAGE_SHARE: f64 = 0.5;
/// The price of a jump of the pose, in frames: runs at the ends of a recording that are shorter, and runs within it that
/// are shorter than twice that, are left out …
pub(super) const JUMP_PRICE: f64 = 40.0;
/// … of a jump of the shape, which anatomy may have too …
const SHAPE_JUMP_PRICE: f64 = 12.0;
/// … but in short recordings the price is at most this share of the frames.
const JUMP_PRICE_SHARE: f64 = 0.25;
/// With fewer frames nothing tells a jump from a step.
const MIN_FRAMES: usize = 5;
/// Other passes confirm a shape where so many times as many saw it as saw another.
const LEAST_ALIKE: usize = 3;
/// Largest number of a cell of frames.
const MAX_CELL: f64 = 1e15;
/// Frames near a place are of different passes of the catheter where so many others lie between them.
const PASS_GAP: usize = 80;
/// Runs that a path may pass over at a time.
const MAX_RUNS_BACK: usize = 512;
/// Runs whose jumps are looked at side by side.
const RUNS_AT_ONCE: usize = 256;

/// What a frame is compared by.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Place {
    pose: Pose,
    /// Median distance of the echoes from the contour's centroid, mm.
    radius_mm: Option<f64>,
    /// Logarithms of eight quantiles of these distances.
    shape: Option<[f64; 8]>,
}

impl Place {
    pub fn of(frame: &Frame) -> Self {
        let pose = frame.world_from_sensor;
        let Some(centre) = frame.centroid_mm() else { return Self { pose, radius_mm: None, shape: None } };
        let mut distances: Vec<f64> = frame.echoes_mm().map(|p| p.distance(centre)).collect();
        distances.sort_unstable_by(f64::total_cmp);
        let count = distances.len();
        let shape: [f64; 8] = std::array::from_fn(|i| distances[(2 * i + 1) * count / 16].ln());
        let enough = count >= 8 && shape.iter().all(|s| s.is_finite());
        Self { pose, radius_mm: Some(median(&mut distances)), shape: enough.then_some(shape) }
    }

    pub fn pose(&self) -> Pose {
        self.pose
    }

    pub fn radius_mm(&self) -> Option<f64> {
        self.radius_mm
    }

    pub fn shape_step(&self, other: &Self) -> Option<f64> {
        let (a, b) = self.shape.as_ref().zip(other.shape.as_ref())?;
        Some(shape_step(a, b))
    }
}

fn shape_step(a: &[f64; 8], b: &[f64; 8]) -> f64 {
    median(&mut std::array::from_fn::<f64, 8, _>(|i| (a[i] - b[i]).abs()))
}

/// The mean shape of some frames, of those that have one.
fn mean_shape(places: &[Place]) -> Option<[f64; 8]> {
    let shapes: Vec<&[f64; 8]> = places.iter().filter_map(|place| place.shape.as_ref()).collect();
    let mean = |i: usize| shapes.iter().map(|shape| shape[i]).sum::<f64>() / shapes.len() as f64;
    (!shapes.is_empty()).then(|| std::array::from_fn(mean))
}

/// The way of a contour's points between two poses, mm: at most the shift, and the turn at the contour's radius.
pub(super) fn step_mm(a: &Pose, b: &Pose, radius_mm: f64) -> f64 {
    a.translation_mm.distance(b.translation_mm) + radius_mm * a.turn_rad(b)
}

/// The usual step: [`USUAL_QUANTILE`] of them all; 0 where there are none.
fn usual(mut steps: Vec<f64>) -> f64 {
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
        let ahead = |i: usize| places[i + 1..].iter().take(STEPS_AHEAD);
        let shortest = |steps: &mut dyn Iterator<Item = f64>| steps.min_by(f64::total_cmp);
        let pose_step_mm =
            |i: usize| shortest(&mut ahead(i).map(|after| step_mm(&places[i].pose, &after.pose, radius_mm)));
        let shape_step = |i: usize| shortest(&mut ahead(i).filter_map(|after| places[i].shape_step(after)));
        let frames = (0..places.len()).into_par_iter();
        Some(Self::new(
            radius_mm,
            frames.clone().filter_map(pose_step_mm).collect(),
            frames.filter_map(shape_step).collect(),
        ))
    }

    /// The limits that a median radius and steps show.
    pub fn new(radius_mm: f64, pose_steps_mm: Vec<f64>, shape_steps: Vec<f64>) -> Self {
        let (usual_mm, usual_shape) = (usual(pose_steps_mm), usual(shape_steps));
        Self {
            radius_mm,
            usual_mm,
            jump_mm: (JUMP_STEPS * usual_mm).max(JUMP_RADII * radius_mm),
            usual_shape,
            jump_shape: (SHAPE_JUMP_STEPS * usual_shape).max(JUMP_SHAPE),
        }
    }

    pub fn radius_mm(&self) -> f64 {
        self.radius_mm
    }

    pub fn usual_mm(&self) -> f64 {
        self.usual_mm
    }

    /// The kind of jump, if any, from a frame to one that was taken `gap` frames later: sensor and wall go on meanwhile,
    /// one usual step for each frame.
    pub fn jump(&self, a: &Place, b: &Place, gap: usize) -> Option<Jump> {
        let meanwhile = gap.saturating_sub(1) as f64;
        let step = step_mm(&a.pose, &b.pose, self.radius_mm);
        if step > self.jump_mm + self.usual_mm * meanwhile {
            return Some(Jump::Pose);
        }
        let near = step <= SHAPE_WITHIN_RADII * self.radius_mm;
        let shape = a.shape_step(b).filter(|_| near);
        shape.is_some_and(|s| s > self.jump_shape + self.usual_shape * meanwhile).then_some(Jump::Shape)
    }

    /// How far a frame is off the nearest frames on the path, mm.
    fn away_mm(&self, place: &Place, on_path: &[&Place]) -> f64 {
        let steps_mm = on_path.iter().map(|n| step_mm(&n.pose, &place.pose, self.radius_mm));
        steps_mm.fold(f64::INFINITY, f64::min)
    }

    /// What of a run, from its first frame to its last, is off the path beside it: its shape, where either end is near enough.
    pub fn jump_of(&self, ends: [&Place; 2], on_path: &[&Place]) -> Jump {
        let is_near = |end: &&Place| self.away_mm(end, on_path) <= self.jump_mm;
        if ends.iter().any(is_near) { Jump::Shape } else { Jump::Pose }
    }

    /// Why a frame of a run that jumps so is left out, told by the nearest frames on the path.
    pub fn why(&self, frame: usize, place: &Place, jump: Jump, on_path: &[&Place]) -> LeftOut {
        if jump == Jump::Pose || place.shape.is_none() {
            let away_mm = self.away_mm(place, on_path);
            return LeftOut {
                place: frame,
                frame,
                reason: Reason::OffPath,
                field: "pose",
                found: format!("{away_mm:.1} mm off the path of the other frames{}", known(&place.pose)),
                expected: format!(
                    "steps of at most {:.1} mm, turns at the contour's radius included",
                    self.jump_mm
                ),
            };
        }
        let radius = |place: &Place| place.radius_mm.unwrap_or(0.0);
        let beside = on_path.first().map_or(0.0, |place| radius(place));
        LeftOut {
            place: frame,
            frame,
            reason: Reason::OffShape,
            field: "contour",
            found: format!(
                "a median radius of {:.2} mm, {beside:.2} mm in the frames beside it",
                radius(place)
            ),
            expected: format!(
                "radii that change by less than {:.0} % from frame to frame",
                100.0 * self.jump_shape.exp_m1()
            ),
        }
    }
}

/// What jumps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Jump {
    Pose,
    Shape,
}

impl Jump {
    /// In frames, of a path through `frames` of them.
    pub fn price(self, frames: usize) -> f64 {
        let price = match self {
            Jump::Pose => JUMP_PRICE,
            Jump::Shape => SHAPE_JUMP_PRICE,
        };
        price.min(JUMP_PRICE_SHARE * frames as f64)
    }
}

/// A run of frames without a jump in between.
struct Run {
    /// Indices of its first and last frame in the list of places.
    first: usize,
    last: usize,
}

impl Run {
    fn frames(&self) -> usize {
        self.last - self.first + 1
    }

    /// Its first few frames, whose mean shape counts.
    fn first_of<'a>(&self, places: &'a [Place]) -> &'a [Place] {
        &places[self.first..=self.last.min(self.first + AVERAGED - 1)]
    }

    /// Its last few.
    fn last_of<'a>(&self, places: &'a [Place]) -> &'a [Place] {
        &places[self.first.max((self.last + 1).saturating_sub(AVERAGED))..=self.last]
    }
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
    let jump = |a: usize, b: usize| limits.jump(&places[a], &places[b], numbers[b] - numbers[a]);
    let goes_on: Vec<bool> = (1..places.len()).into_par_iter().map(|i| jump(i - 1, i).is_none()).collect();
    let mut runs = vec![Run { first: 0, last: 0 }];
    for (i, goes_on) in (1..).zip(goes_on) {
        match runs.last_mut() {
            Some(run) if goes_on => run.last = i,
            _ => runs.push(Run { first: i, last: i }),
        }
    }
    if runs.len() < 2 {
        return Vec::new();
    }
    // A single noisy contour may stand at the end of a run: then shapes hardly differ on average.
    let hardly_differ = |a: &Run, b: &Run| {
        let shapes = mean_shape(a.last_of(places)).zip(mean_shape(b.first_of(places)));
        shapes.is_some_and(|(a, b)| shape_step(&a, &b) <= AVERAGE_SHARE * limits.jump_shape)
    };
    let between =
        |a: &Run, b: &Run| jump(a.last, b.first).filter(|kind| *kind == Jump::Pose || !hardly_differ(a, b));
    // The best path through some of the runs.
    let best_path = |candidates: &[usize]| -> Vec<usize> {
        let count = candidates.len();
        let run = |c: usize| &runs[candidates[c]];
        // The best path that ends with each of them: its worth, and the one before.
        let mut best: Vec<(f64, Option<usize>)> = Vec::with_capacity(count);
        for first in (0..count).step_by(RUNS_AT_ONCE) {
            let last = count.min(first + RUNS_AT_ONCE);
            let price =
                |a: usize, b: usize| between(run(a), run(b)).map_or(0.0, |jump| jump.price(places.len()));
            let prices = |b: usize| (0..b).rev().take(MAX_RUNS_BACK).map(|a| price(a, b)).collect();
            let prices: Vec<Vec<f64>> = (first..last).into_par_iter().map(prices).collect();
            for (b, prices) in (first..last).zip(prices) {
                let mut before = (0.0, None);
                for (a, price) in (0..b).rev().zip(prices) {
                    let worth = best[a].0 - price;
                    if worth > before.0 {
                        before = (worth, Some(a));
                    }
                }
                best.push((run(b).frames() as f64 + before.0, before.1));
            }
        }
        let mut path = Vec::new();
        let mut at = (0..count).max_by(|&a, &b| best[a].0.total_cmp(&best[b].0).then(b.cmp(&a)));
        while let Some(c) = at {
            path.push(candidates[c]);
            at = best[c].1;
        }
        path.reverse();
        path
    };
    let frames_of = |of: &[usize]| of.iter().map(|&run| runs[run].frames()).sum::<usize>();
    let mut candidates: Vec<usize> = (0..runs.len()).collect();
    let mut kept = best_path(&candidates);
    // A burst of wrong contours at an end of the path has another jump, which nobody saw. It may consist of several runs, with
    // right contours in between.
    for is_start in [true, false] {
        let inwards: Vec<usize> = if is_start { kept.clone() } else { kept.iter().rev().copied().collect() };
        let jump = |pair: &[usize]| between(&runs[pair[0].min(pair[1])], &runs[pair[0].max(pair[1])]);
        let Some(last) = inwards.windows(2).position(|pair| jump(pair).is_some()) else { continue };
        let (end, rest) = inwards.split_at(last + 1);
        if jump(&inwards[last..last + 2]) == Some(Jump::Shape)
            && frames_of(end) as f64 <= 2.0 * Jump::Shape.price(places.len())
            && frames_of(end) < frames_of(rest)
        {
            candidates.retain(|run| !end.contains(run));
            kept = best_path(&candidates);
        }
    }
    // Between two bursts of wrong contours that are alike, the few right ones look like a burst themselves. But they have the
    // shape of the frames before and behind the bursts: it hardly changed, changed back, and did so again.
    loop {
        let shape_jumps = |k: &usize| between(&runs[kept[k - 1]], &runs[kept[*k]]) == Some(Jump::Shape);
        let jumps: Vec<usize> = (1..kept.len()).filter(shape_jumps).collect();
        let returns = |from: usize, to: usize| {
            let (before, after) = (&runs[kept[from - 1]], &runs[kept[to]]);
            let left_out = (kept[from]..kept[to]).filter(|run| kept.binary_search(run).is_err());
            let alike = left_out.map(|run| &runs[run]);
            let alike = alike.filter(|run| hardly_differ(before, run) && hardly_differ(run, after));
            alike.map(Run::frames).sum::<usize>() >= AVERAGED
        };
        let are_few = |of: &[usize]| {
            let frames = frames_of(of);
            frames as f64 <= 4.0 * Jump::Shape.price(places.len()) && 2 * frames < frames_of(&kept)
        };
        let bursts = jumps
            .windows(2)
            .find(|pair| are_few(&kept[pair[0]..pair[1]]) && returns(pair[0], pair[1]))
            .map(|pair| kept[pair[0]..pair[1]].to_vec());
        let Some(bursts) = bursts else { break };
        candidates.retain(|run| !bursts.contains(run));
        kept = best_path(&candidates);
    }
    let passes = Passes::of(numbers, places, &limits);
    let mut left_out = Vec::new();
    for (r, run) in runs.iter().enumerate().filter(|(r, _)| kept.binary_search(r).is_err()) {
        let next = kept.partition_point(|&k| k < r);
        let before = next.checked_sub(1).map(|n| &places[runs[kept[n]].last]);
        let after = kept.get(next).map(|&n| &places[runs[n].first]);
        let beside: Vec<&Place> = before.into_iter().chain(after).collect();
        let jump = limits.jump_of([&places[run.first], &places[run.last]], &beside);
        let why: Vec<LeftOut> =
            (run.first..=run.last).map(|i| limits.why(numbers[i], &places[i], jump, &beside)).collect();
        if why.iter().any(|one| one.reason != Reason::OffShape) || !passes.confirm(run) {
            left_out.extend(why);
        }
    }
    left_out
}

/// The frames by place, to compare passes of the catheter.
struct Passes<'a> {
    numbers: &'a [usize],
    places: &'a [Place],
    limits: &'a Limits,
    /// Indices of the frames in each cell of a cubic grid, in order.
    cells: BTreeMap<[i64; 3], Vec<usize>>,
}

impl<'a> Passes<'a> {
    fn of(numbers: &'a [usize], places: &'a [Place], limits: &'a Limits) -> Self {
        let mut passes = Self { numbers, places, limits, cells: BTreeMap::new() };
        for i in 0..places.len() {
            passes.cells.entry(passes.cell(i)).or_default().push(i);
        }
        passes
    }

    /// Half of the lumen's radius wide.
    fn cell(&self, i: usize) -> [i64; 3] {
        let within_mm = (SHAPE_WITHIN_RADII * self.limits.radius_mm).max(f64::MIN_POSITIVE);
        let cell = (self.places[i].pose.translation_mm / within_mm).floor();
        // So that neighbours have numbers too, however small the lumen.
        cell.clamp(DVec3::splat(-MAX_CELL), DVec3::splat(MAX_CELL)).as_i64vec3().to_array()
    }

    /// Whether nearly all other passes through the places of a run saw its shapes there, for most of its frames. Anatomy repeats
    /// itself so, a wrong segmentation does not.
    fn confirm(&self, run: &Run) -> bool {
        let frames = run.first..=run.last;
        let [alike, other] = frames
            .clone()
            .map(|i| self.votes(i))
            .fold([0, 0], |[a, b], [alike, other]| [a + alike, b + other]);
        alike >= LEAST_ALIKE * other && 2 * alike >= frames.count()
    }

    /// How many other passes saw a frame's shape at its place, and how many another one.
    fn votes(&self, i: usize) -> [usize; 2] {
        let cell = self.cell(i);
        let beside = (0..27).map(|k| [cell[0] + k % 3 - 1, cell[1] + k / 3 % 3 - 1, cell[2] + k / 9 - 1]);
        let mut near: Vec<(usize, f64)> = beside
            .filter_map(|cell| self.cells.get(&cell))
            .flatten()
            .map(|&j| (j, self.apart_mm(i, j)))
            .filter(|(_, apart_mm)| *apart_mm <= SHAPE_WITHIN_RADII * self.limits.radius_mm)
            .collect();
        near.sort_unstable_by_key(|(j, _)| *j);
        let is_one_pass =
            |a: &(usize, f64), b: &(usize, f64)| self.numbers[b.0] - self.numbers[a.0] <= PASS_GAP;
        near.chunk_by(is_one_pass)
            .filter(|pass| pass.iter().all(|(j, _)| *j != i))
            .filter_map(|pass| pass.iter().min_by(|a, b| a.1.total_cmp(&b.1)))
            .filter_map(|&(j, _)| self.places[i].shape_step(&self.places[j]))
            .fold([0, 0], |[alike, other], step| match step <= self.limits.jump_shape {
                true => [alike + 1, other],
                false => [alike, other + 1],
            })
    }

    /// How far a contour's points are from where another one's are, mm, turns about the probe's own axis left aside: these do
    /// not change its shape.
    fn apart_mm(&self, i: usize, j: usize) -> f64 {
        let [a, b] = [i, j].map(|k| &self.places[k].pose);
        let tilt_rad = a.rotation.z_axis.angle_between(b.rotation.z_axis);
        a.translation_mm.distance(b.translation_mm) + self.limits.radius_mm * tilt_rad
    }
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
