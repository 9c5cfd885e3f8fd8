//! Values that stand for "no echo" in contours.

use crate::recording::Frame;
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Points of contours that stand for a missing echo and are taken for one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct NoEcho {
    /// The value, mm; `None`: numbers that are infinite.
    pub value_mm: Option<[f64; 2]>,
    /// How many points have it.
    pub points: usize,
}

impl fmt::Display for NoEcho {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} ", self.points, if self.points == 1 { "point" } else { "points" })?;
        match self.value_mm {
            Some([x, y]) => write!(f, "at ({x}, {y})")?,
            None => write!(f, "at infinity")?,
        }
        write!(f, ", taken for missing echoes")
    }
}

/// A value stands for "no echo" where at least this many points of a frame have it …
const MIN_POINTS: usize = 3;
/// … in at least this many frames.
const MIN_FRAMES: usize = 3;

/// How often the values occur that stand for "no echo": (0, 0), which is the probe itself;
/// infinities; and any pair of numbers that several points of several frames share to the last bit.
///
/// Two echoes never agree in all digits, but a value that a program fills in does. Points that were repeated when a contour
/// was resampled agree within a frame, but not with those of other frames.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Counts {
    infinite: usize,
    at_probe: usize,
    /// Frames in which a pair of numbers occurs often, and its points there.
    repeated: BTreeMap<[u64; 2], (usize, usize)>,
}

/// Pairs that are remembered; beyond, those of one frame are forgotten.
const MAX_PAIRS: usize = 1 << 14;

/// What a frame has of such values.
struct FoundIn {
    infinite: usize,
    at_probe: usize,
    /// Pairs of numbers, each with how often it occurs.
    repeated: Vec<([u64; 2], usize)>,
}

impl FoundIn {
    fn of(frame: &Frame) -> Self {
        let (mut infinite, mut at_probe) = (0, 0);
        let mut keys: Vec<[u64; 2]> = Vec::with_capacity(frame.contour_mm.len());
        for &p in &frame.contour_mm {
            if is_infinite(p) {
                infinite += 1;
            } else if p == DVec2::ZERO {
                at_probe += 1;
            } else if p.is_finite() {
                keys.push([p.x.to_bits(), p.y.to_bits()]);
            }
        }
        // Hardly any contour has equal points: first coordinates alone are sorted sooner.
        let mut first: Vec<u64> = keys.iter().map(|key| key[0]).collect();
        first.sort_unstable();
        if !first.windows(MIN_POINTS).any(|some| some.iter().all(|x| *x == some[0])) {
            return Self { infinite, at_probe, repeated: Vec::new() };
        }
        keys.sort_unstable();
        let same = keys.chunk_by(|a, b| a == b).filter(|same| same.len() >= MIN_POINTS);
        Self { infinite, at_probe, repeated: same.map(|same| (same[0], same.len())).collect() }
    }
}

impl Counts {
    /// Counts the points of a frame.
    pub fn add(&mut self, frame: &Frame) {
        self.add_found(FoundIn::of(frame));
    }

    fn add_found(&mut self, found: FoundIn) {
        self.infinite += found.infinite;
        self.at_probe += found.at_probe;
        for (value, count) in found.repeated {
            let (frames, points) = self.repeated.entry(value).or_default();
            *frames += 1;
            *points += count;
        }
        if self.repeated.len() > MAX_PAIRS {
            self.repeated.retain(|_, (frames, _)| *frames > 1);
        }
    }

    /// The values that stand for "no echo".
    pub fn found(&self) -> Vec<NoEcho> {
        let mut found = Vec::new();
        if self.infinite > 0 {
            found.push(NoEcho { value_mm: None, points: self.infinite });
        }
        if self.at_probe > 0 {
            found.push(NoEcho { value_mm: Some([0.0, 0.0]), points: self.at_probe });
        }
        let mut repeated: Vec<([u64; 2], usize)> = self
            .repeated
            .iter()
            .filter(|(_, (frames, _))| *frames >= MIN_FRAMES)
            .map(|(&value, &(_, points))| (value, points))
            .collect();
        repeated.sort_unstable();
        found.extend(repeated.into_iter().map(|([x, y], points)| NoEcho {
            value_mm: Some([f64::from_bits(x), f64::from_bits(y)]),
            points,
        }));
        found
    }
}

/// The values that stand for "no echo" in the frames of a recording, with how often they occur.
pub(super) fn no_echo(frames: &[Frame]) -> Vec<NoEcho> {
    let mut counts = Counts::default();
    let found: Vec<FoundIn> = frames.par_iter().map(FoundIn::of).collect();
    found.into_iter().for_each(|found| counts.add_found(found));
    counts.found()
}

/// Whether a point stands for "no echo".
pub(super) fn is_no_echo(found: &[NoEcho], p: DVec2) -> bool {
    found.iter().any(|one| one.value_mm.map_or_else(|| is_infinite(p), |value| DVec2::from_array(value) == p))
}

/// Infinite where it is not NaN.
fn is_infinite(p: DVec2) -> bool {
    !p.is_nan() && !p.is_finite()
        || (p.x.is_infinite() && p.y.is_nan())
        || (p.y.is_infinite() && p.x.is_nan())
}
