//! What is done to the points of contours before anything else looks at them.

use super::artefacts::{self, RingDown};
use super::chords::Chords;
use super::no_echo::{self, NoEcho};
use crate::recording::Frame;
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// What is done to the points of contours before they are used: those that are no echoes of the wall become missing echoes
/// (NaN), and those without an order are sorted.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Cleaning {
    /// Values that stand for a missing echo.
    pub no_echo: Vec<NoEcho>,
    /// Frames whose contours had no order: their points are sorted about their centre.
    pub sorted_frames: usize,
    /// Echoes of the catheter itself.
    pub ring_down: Option<RingDown>,
    /// Straight lines across shadows.
    pub chords: Option<Chords>,
}

impl Cleaning {
    /// What the contours of a recording need, and the frames with their contours cleaned.
    pub(super) fn of(frames: &[Frame]) -> (Self, Cow<'_, [Frame]>) {
        let mut found = Self { no_echo: no_echo::no_echo(frames), ..Self::default() };
        let mut cleaned = Cow::Borrowed(frames);
        found.remove_no_echo(&mut cleaned);
        found.sort(&mut cleaned);
        found.ring_down = RingDown::of(&cleaned);
        found.remove_ring_down(&mut cleaned);
        found.chords = Chords::fixed_in(&cleaned);
        found.remove_chords(&mut cleaned);
        (found, cleaned)
    }

    /// Cleans the contours of further frames, and counts what is done to them. How often values stand for a missing echo is
    /// not counted.
    pub(super) fn add<'a>(&mut self, frames: &'a [Frame]) -> Cow<'a, [Frame]> {
        let mut cleaned = Cow::Borrowed(frames);
        self.remove_no_echo(&mut cleaned);
        self.sort(&mut cleaned);
        self.remove_ring_down(&mut cleaned);
        self.remove_chords(&mut cleaned);
        cleaned
    }

    /// The same for other frames, none of which has come yet.
    pub(super) fn without_counts(&self) -> Self {
        let none = |ring_down: RingDown| RingDown { points: 0, frames: 0, ..ring_down };
        Self {
            no_echo: self.no_echo.clone(),
            sorted_frames: 0,
            ring_down: self.ring_down.map(none),
            chords: self.chords.map(|chords| Chords { points: 0, frames: 0, ..chords }),
        }
    }

    /// Each thing that is done, with its name.
    pub(crate) fn lines(&self) -> Vec<(&'static str, String)> {
        let mut lines: Vec<_> = self.no_echo.iter().map(|one| ("no echo", one.to_string())).collect();
        lines.extend(self.ring_down.map(|ring_down| ("ring-down", ring_down.to_string())));
        lines.extend(self.chords.map(|chords| ("chords", chords.to_string())));
        if self.sorted_frames > 0 {
            let count = self.sorted_frames;
            lines.push((
                "order",
                format!("points of {count} contours without one, sorted about their centres"),
            ));
        }
        lines
    }

    fn remove_no_echo(&self, frames: &mut Cow<'_, [Frame]>) {
        if !self.no_echo.is_empty() {
            let is_no_echo = |p: &DVec2| no_echo::is_no_echo(&self.no_echo, *p);
            remove(frames, |frame| {
                let points = frame.contour_mm.iter().enumerate();
                points.filter(|(_, p)| is_no_echo(p)).map(|(place, _)| place).collect()
            });
        }
    }

    fn sort(&mut self, frames: &mut Cow<'_, [Frame]>) {
        let sorted = |(k, frame)| Some((k, artefacts::sorted(frame)?));
        let sorted: Vec<(usize, Vec<DVec2>)> = frames.par_iter().enumerate().filter_map(sorted).collect();
        self.sorted_frames += sorted.len();
        for (k, contour_mm) in sorted {
            frames.to_mut()[k].contour_mm = contour_mm;
        }
    }

    fn remove_ring_down(&mut self, frames: &mut Cow<'_, [Frame]>) {
        if let Some(ring_down) = &mut self.ring_down {
            let removed = remove(frames, |frame| ring_down.places(frame));
            ring_down.points += removed.points;
            ring_down.frames += removed.frames;
        }
    }

    fn remove_chords(&mut self, frames: &mut Cow<'_, [Frame]>) {
        let mut chords = self.chords.unwrap_or_default();
        let removed = remove(frames, |frame| chords.places(frame));
        chords.points += removed.points;
        chords.frames += removed.frames;
        self.chords = (chords != Chords::default()).then_some(chords);
    }
}

/// Points that were removed, and the frames that had them.
struct Removed {
    points: usize,
    frames: usize,
}

/// Puts NaN at some places of each contour.
fn remove(frames: &mut Cow<'_, [Frame]>, places: impl Fn(&Frame) -> Vec<usize> + Sync) -> Removed {
    let places = |(k, frame)| Some((k, places(frame))).filter(|(_, places)| !places.is_empty());
    let found: Vec<(usize, Vec<usize>)> = frames.par_iter().enumerate().filter_map(places).collect();
    let removed = Removed { points: found.iter().map(|(_, places)| places.len()).sum(), frames: found.len() };
    for (k, places) in found {
        let contour_mm = &mut frames.to_mut()[k].contour_mm;
        places.into_iter().for_each(|place| contour_mm[place] = DVec2::NAN);
    }
    removed
}
