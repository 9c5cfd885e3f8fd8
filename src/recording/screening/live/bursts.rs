//! Bursts of wrong contours among frames that were used: they show once they are over.

use super::Judged;
use crate::numerics::robust::median;
use crate::recording::Frame;
use crate::recording::screening::bursts::{
    APART, Change, LONGEST, Large, Seen, Sequence, Sizes, WIDTHS, roll_rad,
};
use crate::recording::screening::path::Place;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Frames that a burst may be found among: the longest one, and what lies beside it.
const WINDOW: usize = LONGEST + 8 * WIDEST;
const WIDEST: usize = WIDTHS[WIDTHS.len() - 1];
/// Radii and changes that tell what is usual, the newest ones; with fewer changes nothing does.
const MEMORY: usize = 256;
const LEAST_KNOWN: usize = 32;
/// What is usual is found again after so many changes.
const EVERY: usize = 8;

/// The newest frames that were used.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct LiveBursts {
    window: VecDeque<Seen>,
    /// Whether frames before those in the window were seen.
    has_more: bool,
    radii_mm: VecDeque<f64>,
    changes: VecDeque<Sizes>,
    /// Changes that came, and what was large by the newest of them when their number was last a multiple of [`EVERY`].
    came: usize,
    large: Option<Large>,
}

impl LiveBursts {
    /// Whether it can go on after it was read from a file, where so many frames have come.
    pub fn is_sound(&self, frames: usize) -> bool {
        self.window.len() <= WINDOW
            && self.window.iter().all(|seen| seen.number < frames)
            && self.radii_mm.len() <= MEMORY
            && self.changes.len() <= MEMORY
    }

    /// Takes a frame that is used, and names those of a burst that is over.
    pub fn push(&mut self, number: usize, frame: &Frame, judged: &mut Judged) {
        let roll_rad = self
            .window
            .back()
            .map_or(0.0, |last| last.roll_rad + roll_rad(&last.pose, &frame.world_from_sensor));
        let Some(seen) = Seen::of(number, frame, roll_rad) else { return };
        self.radii_mm.extend(Place::of(frame).radius_mm());
        self.window.push_back(seen);
        if self.window.len() > WINDOW {
            self.window.pop_front();
            self.has_more = true;
        }
        let excess = self.radii_mm.len().saturating_sub(MEMORY);
        self.radii_mm.drain(..excess);
        self.search(false, judged);
    }

    /// After the last frame.
    pub fn flush(&mut self, judged: &mut Judged) {
        self.search(true, judged);
    }

    fn search(&mut self, is_last: bool, judged: &mut Judged) {
        let radius_mm = median(&mut self.radii_mm.iter().copied().collect::<Vec<_>>());
        let sequence = Sequence { seen: self.window.make_contiguous(), radius_mm };
        let Some(stretch) = sequence.stretches().pop() else { return };
        if !is_last {
            // The newest change that later frames no longer alter.
            let Some(at) = stretch.end.checked_sub(WIDEST).filter(|at| *at > stretch.start) else { return };
            self.changes.push_back(sequence.change_at(&stretch, at).sizes);
            let excess = self.changes.len().saturating_sub(MEMORY);
            self.changes.drain(..excess);
            self.came += 1;
            if self.came >= LEAST_KNOWN && self.came.is_multiple_of(EVERY) {
                self.large = Some(Large::among(self.changes.iter()));
            }
        }
        let Some(large) = &self.large else { return };
        // A change counts once those are known that lie within APART frames of it, and larger ones take its place. All that came
        // before anything was usual are looked at at once.
        let settling = self.changes.iter().rev().nth(APART);
        let is_first = self.came == LEAST_KNOWN;
        if !is_last && !is_first && !settling.is_some_and(|sizes| large.may_be_end(sizes)) {
            return;
        }
        let settled = if is_last { stretch.end } else { stretch.end.saturating_sub(WIDEST + APART) };
        let changes: Vec<Change> = (stretch.start + 1..stretch.end.min(settled + APART + 1))
            .map(|at| sequence.change_at(&stretch, at))
            .collect();
        let are_ends = [stretch.start > 0 || !self.has_more, is_last];
        let bursts = sequence.bursts(&stretch, are_ends, &changes, large);
        let mut wrong: Vec<usize> = Vec::new();
        for burst in bursts.iter().filter(|burst| burst.frames.end <= settled) {
            let number = |i: usize| sequence.seen[i].number;
            judged.left_out.extend(burst.frames.clone().map(|i| burst.why(number(i), large)));
            judged.taken_back.extend(burst.frames.clone().map(number));
            wrong.extend(burst.frames.clone());
        }
        let mut place = 0..;
        self.window.retain(|_| place.next().is_none_or(|i| wrong.binary_search(&i).is_err()));
    }
}
