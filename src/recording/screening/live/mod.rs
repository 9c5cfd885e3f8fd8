//! The screening while frames arrive.

mod bursts;
mod jump;
mod on_path;

use super::no_echo::Counts;
use super::path::Place;
use super::{Cleaning, LeftOut, NoEcho};
use crate::numerics::robust::median;
use crate::recording::Frame;
use bursts::LiveBursts;
use on_path::LivePath;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Frames that are handed over at a time, so that none of them takes long.
const FRAMES_AT_A_TIME: usize = 4;
/// Contours are looked at for what is no wall once so many frames have come, and then each time their number has doubled, …
const FIRST_LOOK: usize = 16;
/// … the last time after so many. Until then frames are kept.
const LAST_LOOK: usize = 1024;
/// Frames that are looked at, at most: of more, every so many.
const MAX_LOOKED_AT: usize = 256;
/// A line at one place of the image is a chord only if most frames are so many lumen radii away from the first: a catheter at
/// rest may look at a flat wall.
const MIN_MOVED_RADII: f64 = 1.0;
/// Points by which the ends of such a line may change from look to look, as a share of its own.
const CHORD_TOLERANCE: f64 = 0.25;

/// Screens frames one by one.
///
/// What is no wall in contours, such as ring-down, shows in many frames only. Where a look at those that have come finds
/// something else than the one before, all frames are screened again, from the first on.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct LiveScreening {
    /// Frames that have come.
    came: usize,
    /// Frames that are not screened yet, and until the last look all before them.
    kept: VecDeque<Frame>,
    /// Frames that are screened, since the vessel last began.
    screened: usize,
    /// Values of all frames that may stand for "no echo".
    counts: Counts,
    /// Those that did so in the frames before the vessel last began.
    known: Vec<NoEcho>,
    cleaning: Cleaning,
    path: LivePath,
    bursts: LiveBursts,
    /// Frames that are named as left out, of those kept.
    named: Vec<usize>,
}

/// What a frame decides.
#[derive(Debug, Default)]
pub(crate) struct Judged {
    /// Whether everything that was handed over before is wrong. Frames are then handed over from the first on.
    pub restart: bool,
    /// The next frames in their order, each once; `None` for one that is left out.
    pub frames: Vec<(usize, Option<Frame>)>,
    /// Frames that are found unfit now.
    pub left_out: Vec<LeftOut>,
    /// Those of them that were handed over, now or before: bursts of wrong contours, and poses that had frozen.
    pub taken_back: Vec<usize>,
}

impl LiveScreening {
    /// Whether it can go on after it was read from a file.
    pub fn is_sound(&self) -> bool {
        let kept = if self.came < LAST_LOOK { Some(self.came) } else { self.came.checked_sub(self.screened) };
        kept == Some(self.kept.len())
            && self.screened <= self.came
            && self.named.iter().all(|number| *number < self.came)
            && self.cleaning.chords.and_then(|chords| chords.fixed).is_none_or(|chord| chord.is_sound())
            && self.path.is_sound(self.screened)
            && self.bursts.is_sound(self.screened)
    }

    /// Frames that wait for a decision, or for their turn after the vessel began anew.
    pub fn waiting(&self) -> usize {
        self.path.waiting() + self.came - self.screened
    }

    /// What was done to the points of contours so far.
    pub fn cleaning(&self) -> &Cleaning {
        &self.cleaning
    }

    /// Takes the next frame.
    pub fn push(&mut self, frame: &Frame) -> Judged {
        let mut judged = Judged::default();
        self.came += 1;
        self.counts.add(frame);
        self.kept.push_back(frame.clone());
        let looks = self.came >= FIRST_LOOK && self.came.is_power_of_two() && self.came <= LAST_LOOK;
        if looks && self.look_again() {
            self.path = LivePath::default();
            self.bursts = LiveBursts::default();
            self.screened = 0;
            judged.restart = true;
        }
        self.screen(FRAMES_AT_A_TIME, &mut judged);
        self.path.hand_over(FRAMES_AT_A_TIME, &mut judged);
        self.find_bursts(&mut judged);
        self.name(&mut judged);
        judged
    }

    /// Ends the waiting: frames that are undecided are left out.
    pub fn flush(&mut self) -> Judged {
        let mut judged = Judged::default();
        self.screen(usize::MAX, &mut judged);
        self.path.flush(&mut judged);
        self.find_bursts(&mut judged);
        self.bursts.flush(&mut judged);
        self.name(&mut judged);
        judged
    }

    /// Screens the next frames, at most so many.
    fn screen(&mut self, most: usize, judged: &mut Judged) {
        for _ in 0..most.min(self.came - self.screened) {
            let first_kept = self.came - self.kept.len();
            let frame = &self.kept[self.screened - first_kept];
            self.cleaning.no_echo = self.counts.found();
            let cleaned = self.cleaning.add(std::slice::from_ref(frame));
            self.path.push(self.screened, &cleaned[0], judged);
            self.screened += 1;
        }
        if self.came >= LAST_LOOK {
            self.kept.drain(..self.kept.len() - (self.came - self.screened));
        }
    }

    /// Looks at the frames that have come for what is no wall; whether that changes what was handed over.
    fn look_again(&mut self) -> bool {
        let step = self.kept.len().div_ceil(MAX_LOOKED_AT);
        let frames: Vec<Frame> = self.kept.iter().step_by(step).cloned().collect();
        let (mut found, cleaned) = Cleaning::of(&frames);
        // Also where nothing tells the radius.
        let has_moved = moved_radii(&cleaned) > MIN_MOVED_RADII;
        found.chords = found.chords.filter(|_| has_moved);
        let found = found.without_counts();
        let values = self.counts.found();
        let is_other = !is_alike(&self.cleaning, &found) || repeated(&self.known).ne(repeated(&values));
        if is_other {
            self.cleaning = found;
            self.known = values;
        }
        is_other
    }

    /// Looks for bursts among the frames that are handed over.
    fn find_bursts(&mut self, judged: &mut Judged) {
        if judged.restart {
            self.bursts = LiveBursts::default();
        }
        let frames = std::mem::take(&mut judged.frames);
        for (number, frame) in frames.iter().filter_map(|(number, frame)| Some((*number, frame.as_ref()?))) {
            self.bursts.push(number, frame, judged);
        }
        judged.frames = frames;
    }

    /// Names each frame that is left out once, also where it is left out again.
    fn name(&mut self, judged: &mut Judged) {
        judged.left_out.retain(|one| !self.named.contains(&one.place));
        if self.came <= LAST_LOOK {
            self.named.extend(judged.left_out.iter().map(|one| one.place));
        }
    }
}

/// How far most frames are from the first one, in radii of the lumen: the median.
fn moved_radii(frames: &[Frame]) -> f64 {
    let places: Vec<Place> =
        frames.iter().filter(|frame| frame.defects().is_empty()).map(Place::of).collect();
    let Some(first) = places.first() else { return 0.0 };
    let position = |place: &Place| place.pose().translation_mm;
    let away_mm = |place| position(place).distance(position(first));
    let radius_mm = median(&mut places.iter().filter_map(Place::radius_mm).collect::<Vec<_>>());
    median(&mut places.iter().map(away_mm).collect::<Vec<_>>()) / radius_mm
}

/// The values that stand for "no echo" because they occur again and again; others are told wherever they occur.
fn repeated(found: &[NoEcho]) -> impl Iterator<Item = [u64; 2]> {
    found.iter().filter_map(|one| one.value_mm).filter(|xy| *xy != [0.0; 2]).map(|xy| xy.map(f64::to_bits))
}

/// Whether a look found the ring-down and the chord that the one before did, but for small differences.
fn is_alike(before: &Cleaning, now: &Cleaning) -> bool {
    let ring_downs = match (before.ring_down, now.ring_down) {
        (Some(a), Some(b)) => (a.radius_mm - b.radius_mm).abs() <= a.tolerance_mm.min(b.tolerance_mm),
        (a, b) => a.is_none() && b.is_none(),
    };
    let chords = [before, now].map(|cleaning| cleaning.chords.and_then(|chords| chords.fixed));
    let chords = match chords {
        [Some(a), Some(b)] if a.of == b.of => {
            let apart = a.first.abs_diff(b.first);
            let ends = [apart.min(a.of - apart), a.points.abs_diff(b.points)];
            let most = CHORD_TOLERANCE * a.points as f64;
            ends.iter().all(|points| *points as f64 <= most)
        }
        [a, b] => a.is_none() && b.is_none(),
    };
    ring_downs && chords
}

#[cfg(test)]
mod tests {
    use super::super::{Chords, FixedChord};
    use super::*;

    fn with_chord(of: usize, first: usize, points: usize) -> Cleaning {
        let fixed = Some(FixedChord { of, first, points });
        Cleaning { chords: Some(Chords { fixed, ..Chords::default() }), ..Cleaning::default() }
    }

    #[test]
    fn chords_are_alike_where_their_ends_nearly_are() {
        let chord = with_chord(72, 70, 12);
        // Behind the last point comes the first.
        assert!(is_alike(&chord, &with_chord(72, 1, 12)) && is_alike(&chord, &with_chord(72, 69, 10)));
        assert!(!is_alike(&chord, &with_chord(72, 60, 12)) && !is_alike(&chord, &with_chord(72, 70, 20)));
        // Of contours with another number of points, such as those of another probe.
        assert!(!is_alike(&chord, &with_chord(500, 480, 12)) && !is_alike(&chord, &Cleaning::default()));
    }

    #[test]
    fn a_chord_beyond_its_contour_is_not_sound() {
        for (of, first, points, is_sound) in
            [(72, 70, 12, true), (0, 0, 0, false), (72, 72, 1, false), (72, 0, 73, false)]
        {
            let cleaning = with_chord(of, first, points);
            assert_eq!(LiveScreening { cleaning, ..LiveScreening::default() }.is_sound(), is_sound);
        }
    }
}
