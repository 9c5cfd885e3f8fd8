//! Frames one by one: what is told of one at once, and what only later ones can tell.

use super::Judged;
use super::jump::{Jump, Look, Steps};
use crate::numerics::robust::median;
use crate::recording::Frame;
use crate::recording::screening::path::{JUMP_PRICE, LOST_STEPS, is_lost_value, lost_frame};
use crate::recording::screening::{LeftOut, Reason, Screening, probe, repeats};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Steps and radii that tell what is usual, the newest ones.
const MEMORY: usize = 256;
/// Frames that wait for a decision, at most; beyond, the oldest run of them is left out.
const MAX_WAITING: usize = 4 * JUMP_PRICE as usize;
/// A lost pose is told after so many good ones.
const MIN_ACCEPTED: usize = 5;

/// The frames on the path of the catheter so far, and those that wait beside it.
///
/// A frame that jumps off the path waits. Where the path goes on as before, it was off; where its own run of frames becomes
/// as long as [`Screening`] asks of a path, the sensor was moved, and the run is used. Where that run is longer than all
/// that was used before, the recording began with a lost sensor: what was used is left out.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct LivePath {
    /// Frames that have come.
    frames: usize,
    /// The last frame on the path and its number, how many frames are on it, and the numbers of the first of them.
    last: Option<(usize, Look)>,
    accepted: usize,
    head: Vec<usize>,
    /// Jumping runs, in the order of their first frames.
    runs: Vec<Run>,
    /// Decided frames that are still to be handed over, in order.
    ready: VecDeque<(usize, Option<Frame>)>,
    /// What is usual.
    pose_steps_mm: VecDeque<f64>,
    shape_steps: VecDeque<f64>,
    radii_mm: VecDeque<f64>,
    positions_mm: VecDeque<DVec3>,
    /// Contours that do not contain the probe.
    outside: usize,
    /// The frame before, and whether it is used.
    before: Option<(usize, Frame)>,
    is_before_used: bool,
    poses: Poses,
}

/// How often poses come in a row.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Poses {
    /// The first frame with the newest one, and how often that came.
    first: usize,
    run: usize,
    /// The most that one came.
    longest: usize,
    /// Poses that came, and those that came more than once.
    values: usize,
    repeated: usize,
}

impl Poses {
    fn add(&mut self, number: usize, is_same: bool) {
        (self.first, self.run) = if is_same { (self.first, self.run + 1) } else { (number, 1) };
        self.longest = self.longest.max(self.run);
        self.values += usize::from(self.run == 1);
        self.repeated += usize::from(self.run == 2);
    }

    /// Whether the tracker is slower than the recorder: most poses before the newest one came more than once, none of them often.
    fn is_slow(&self) -> bool {
        let repeated = self.repeated.saturating_sub(usize::from(self.run > 1));
        let values = self.values.saturating_sub(1);
        values >= repeats::MIN_SLOW_RUNS && 2 * repeated > values && self.longest <= repeats::MAX_SLOW_RUN
    }
}

/// Frames that wait, without a jump in between.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Run {
    frames: Vec<(usize, Frame)>,
    last: Look,
    /// The [price](Jump::price) of the jump to it.
    price: f64,
}

impl Run {
    /// Its first frame with a contour.
    fn first(&self) -> Option<Look> {
        self.frames.iter().find(|(_, frame)| !frame.contour_mm.is_empty()).map(|(_, frame)| Look::of(frame))
    }
}

impl LivePath {
    /// Whether it can go on after it was read from a file, where so many frames have come.
    pub fn is_sound(&self, frames: usize) -> bool {
        let came = |number: &usize| *number < self.frames;
        let of_runs = self.runs.iter().flat_map(|run| run.frames.iter().map(|(number, _)| number));
        let known =
            self.last.iter().map(|(number, _)| number).chain(self.before.iter().map(|(number, _)| number));
        let ready = self.ready.iter().map(|(number, _)| number);
        known.chain(of_runs).chain(ready).chain(&self.head).all(came)
            && self.frames == frames
            && self.waiting() <= MAX_WAITING
            && self.accepted <= self.frames
            && self.poses.first <= self.frames
            && self.poses.values <= self.frames
            && self.poses.repeated <= self.poses.values
            && self.poses.run <= self.poses.longest
            && self.poses.longest <= self.frames
            && self.outside <= self.frames
    }

    /// Frames that wait for a decision.
    pub fn waiting(&self) -> usize {
        self.runs.iter().map(|run| run.frames.len()).sum()
    }

    /// Takes the next frame, its contour cleaned.
    pub fn push(&mut self, number: usize, frame: &Frame, judged: &mut Judged) {
        self.frames += 1;
        let left_out = self.alone(number, frame, judged);
        self.is_before_used = left_out.is_none();
        match left_out {
            Some(left_out) => {
                judged.left_out.push(left_out);
                // Numbers stay in order: behind frames that wait, its turn comes with theirs.
                match self.runs.last_mut() {
                    Some(run) => run.frames.push((number, Frame::new(frame.world_from_sensor, Vec::new()))),
                    None => self.ready.push_back((number, None)),
                }
            }
            None => self.place(number, frame.clone(), judged),
        }
        // Also where frames without a pose or an image follow one that jumps, and nothing ever decides.
        while self.waiting() > MAX_WAITING {
            let oldest = self.runs.remove(0);
            self.leave_out_beside_the_path(vec![oldest], judged);
        }
    }

    /// Ends the waiting: frames that are undecided are left out.
    pub fn flush(&mut self, judged: &mut Judged) {
        let runs = std::mem::take(&mut self.runs);
        self.leave_out_beside_the_path(runs, judged);
        self.hand_over(usize::MAX, judged);
    }

    fn leave_out_beside_the_path(&mut self, runs: Vec<Run>, judged: &mut Judged) {
        let last = self.last.as_ref().map(|(_, look)| look.clone());
        let steps = self.steps();
        for run in runs {
            self.leave_out(run, &steps, &last.iter().collect::<Vec<_>>(), judged);
        }
    }

    /// Hands over decided frames, at most so many that are used.
    pub fn hand_over(&mut self, most: usize, judged: &mut Judged) {
        let mut used = 0;
        while used < most
            && let Some(next) = self.ready.pop_front()
        {
            used += usize::from(next.1.is_some());
            judged.frames.push(next);
        }
    }

    /// Why a frame is left out, as far as it and those before tell.
    fn alone(&mut self, number: usize, frame: &Frame, judged: &mut Judged) -> Option<LeftOut> {
        if let Some(defect) = frame.defects().into_iter().next() {
            return Some(LeftOut {
                place: number,
                frame: number,
                reason: Reason::Defect,
                field: defect.field,
                found: defect.found,
                expected: defect.expected.into(),
            });
        }
        let before = self.before.replace((number, frame.clone()));
        let is_same =
            |before: &Frame| repeats::same_pose(&before.world_from_sensor, &frame.world_from_sensor);
        self.poses.add(number, before.as_ref().is_some_and(|(_, before)| is_same(before)));
        if let Some((before_number, before)) = before {
            let repeated = |number: usize, first: usize, field, expected: &str| LeftOut {
                place: number,
                frame: number,
                reason: Reason::Repeated,
                field,
                found: format!("the same as in frame {first}"),
                expected: expected.into(),
            };
            if repeats::same_contour(&before.contour_mm, &frame.contour_mm)
                && repeats::has_contour_noise(&[frame])
            {
                return Some(repeated(number, before_number, "contour", "a new image"));
            }
            let is_frozen = self.poses.run >= repeats::MIN_FROZEN
                && !is_lost_value(&frame.world_from_sensor)
                && self.has_tracker_noise();
            if is_frozen || self.poses.run > 1 && self.poses.is_slow() {
                let first = self.poses.first;
                let of_pose = |number| repeated(number, first, "pose", "a new measurement");
                if self.poses.run == repeats::MIN_FROZEN && self.is_before_used {
                    // Its second frame did not tell yet.
                    self.take_back(of_pose(before_number), judged);
                }
                return Some(of_pose(number));
            }
        }
        if let Some(by_mm) = probe::outside_by_mm(frame) {
            self.outside += 1;
            if self.outside as f64 <= Screening::MAX_SHARE * self.frames as f64 {
                return Some(probe::left_out(number, by_mm));
            }
        }
        None
    }

    /// Leaves out a frame that was taken for good.
    fn take_back(&mut self, left_out: LeftOut, judged: &mut Judged) {
        let number = left_out.place;
        let waiting = self.runs.iter_mut().flat_map(|run| &mut run.frames).find(|(k, _)| *k == number);
        if let Some((_, frame)) = waiting {
            *frame = Frame::new(frame.world_from_sensor, Vec::new());
        } else if let Some((_, frame)) = self.ready.iter_mut().find(|(k, _)| *k == number) {
            *frame = None;
        } else {
            judged.taken_back.push(number);
        }
        judged.left_out.push(left_out);
    }

    fn has_tracker_noise(&self) -> bool {
        self.accepted >= MIN_ACCEPTED && repeats::Motion::along(self.positions_mm.iter().copied()).has_noise
    }

    /// Puts a frame on the path, or among those that wait.
    fn place(&mut self, number: usize, frame: Frame, judged: &mut Judged) {
        let look = Look::of(&frame);
        self.radii_mm.extend(look.place.radius_mm());
        bound(&mut self.radii_mm);
        let steps = self.steps();
        let Some((last_number, last)) = &self.last else {
            self.accept(number, frame, look, steps);
            return;
        };
        let away_mm = steps.pose.step_mm(&last.place, &look.place);
        let is_off = away_mm > (LOST_STEPS + (number - last_number) as f64 - 1.0) * steps.pose.usual_mm();
        if is_lost_value(&look.place.pose()) && self.accepted >= MIN_ACCEPTED && is_off {
            judged.left_out.push(lost_frame(number, away_mm, &look.place));
            match self.runs.last_mut() {
                Some(run) => run.frames.push((number, Frame::new(last.place.pose(), Vec::new()))),
                None => self.ready.push_back((number, None)),
            }
            return;
        }
        // A frame that goes on where the one before left off belongs with it, also where the path would take it: a wall that
        // changes abruptly and goes on from there is no wrong contour.
        let follows = |run: &Run| {
            run.frames.last().is_some_and(|(before, _)| before + 1 == number)
                && steps.jump(&run.last, &look, 1).is_none()
        };
        let newest = self.runs.len().checked_sub(1).filter(|&r| follows(&self.runs[r]));
        let jump = steps.jump(last, &look, number - last_number);
        if newest.is_none() && jump.is_none() {
            let last = last.clone();
            for run in std::mem::take(&mut self.runs) {
                self.leave_out(run, &steps, &[&last, &look], judged);
            }
            self.accept(number, frame, look, steps);
            return;
        }
        let goes_on =
            newest.or_else(|| self.runs.iter().rposition(|run| steps.jump(&run.last, &look, 1).is_none()));
        match goes_on {
            Some(r) => {
                let run = &mut self.runs[r];
                run.frames.push((number, frame));
                run.last = look;
                // All that came after the run's start and is not part of it is off its path.
                let used = run.frames.iter().filter(|(_, frame)| !frame.contour_mm.is_empty()).count();
                let enough = used as f64 > run.price.min(self.accepted as f64);
                if enough {
                    self.go_on_with(r, steps, judged);
                }
            }
            None => {
                let price = jump.map_or(0.0, Jump::price);
                self.runs.push(Run { frames: vec![(number, frame)], last: look, price });
            }
        }
    }

    /// Uses a run that waited; the others are left out, and so is what was used before where it is shorter.
    fn go_on_with(&mut self, r: usize, steps: Steps, judged: &mut Judged) {
        let run = self.runs.remove(r);
        let beside = [run.first().unwrap_or_else(|| run.last.clone()), run.last.clone()];
        let beside = beside.each_ref();
        for other in std::mem::take(&mut self.runs) {
            self.leave_out(other, &steps, &beside, judged);
        }
        if self.accepted as f64 <= run.price {
            judged.restart = true;
            let first = run.frames.first().map_or(self.frames, |(number, _)| *number);
            let on_path = self.last.take().map(|(_, look)| look);
            for number in std::mem::take(&mut self.head) {
                if let Some(on_path) = &on_path {
                    let jump = steps.jump_of([on_path, on_path], &beside);
                    judged.left_out.push(steps.why(number, on_path, jump, &beside));
                }
            }
            let later = std::mem::take(&mut self.ready).into_iter().filter(|(number, _)| *number >= first);
            self.ready = (0..first).map(|number| (number, None)).chain(later).collect();
            self.accepted = 0;
            self.pose_steps_mm.clear();
            self.shape_steps.clear();
            self.positions_mm.clear();
        }
        let mut decided: Vec<(usize, Option<Frame>)> = std::mem::take(&mut self.ready).into();
        self.last = None;
        for (number, frame) in run.frames {
            if frame.contour_mm.is_empty() {
                decided.push((number, None));
                continue;
            }
            let look = Look::of(&frame);
            self.accept(number, frame, look, steps);
            decided.extend(self.ready.drain(..));
        }
        decided.sort_by_key(|(number, _)| *number);
        self.ready = decided.into();
    }

    fn leave_out(&mut self, run: Run, steps: &Steps, beside: &[&Look], judged: &mut Judged) {
        let jump = run.first().map_or(Jump::Pose, |first| steps.jump_of([&first, &run.last], beside));
        for (number, frame) in run.frames {
            if !frame.contour_mm.is_empty() {
                judged.left_out.push(steps.why(number, &Look::of(&frame), jump, beside));
            }
            let at = self.ready.partition_point(|(other, _)| *other < number);
            self.ready.insert(at, (number, None));
        }
    }

    fn accept(&mut self, number: usize, frame: Frame, look: Look, steps: Steps) {
        if let Some((_, last)) = &self.last {
            self.pose_steps_mm.push_back(steps.pose.step_mm(&last.place, &look.place));
            self.shape_steps.extend(last.shape_step(&look));
        }
        self.positions_mm.push_back(look.place.pose().translation_mm);
        bound(&mut self.pose_steps_mm);
        bound(&mut self.shape_steps);
        bound(&mut self.positions_mm);
        self.last = Some((number, look));
        self.accepted += 1;
        if self.head.len() < JUMP_PRICE as usize {
            self.head.push(number);
        }
        self.ready.push_back((number, Some(frame)));
    }

    fn steps(&self) -> Steps {
        let radius_mm = median(&mut self.radii_mm.iter().copied().collect::<Vec<_>>());
        Steps::new(
            radius_mm,
            self.pose_steps_mm.iter().copied().collect(),
            self.shape_steps.iter().copied().collect(),
        )
    }
}

/// Forgets the oldest values.
fn bound<T>(values: &mut VecDeque<T>) {
    let excess = values.len().saturating_sub(MEMORY);
    values.drain(..excess);
}
