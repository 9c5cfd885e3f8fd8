//! Straight lines that a segmentation draws across a shadow, from the last echo before it to the first behind it.

use crate::numerics::robust::median;
use crate::recording::Frame;
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Points on straight lines across shadows, which are drawn and not measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Chords {
    /// Points that are taken for missing echoes: those between the ends of the lines.
    pub points: usize,
    /// Frames with such points.
    pub frames: usize,
    /// A line that stands at the same place of the image in all frames, where noise was added to it.
    pub fixed: Option<FixedChord>,
}

/// A chord at the same places of all contours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct FixedChord {
    /// Points of the contours that it was found in.
    pub of: usize,
    /// The place of its first point, and how many there are; behind the last point of a contour comes the first.
    pub first: usize,
    /// Number of its points.
    pub points: usize,
}

impl FixedChord {
    /// Whether it lies within its contours, as one that was read from a file may not.
    pub(super) fn is_sound(self) -> bool {
        self.first < self.of && self.points <= self.of
    }
}

impl fmt::Display for Chords {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { points, frames, fixed } = self;
        let place = if fixed.is_some() { ", at one place of the image" } else { "" };
        write!(
            f,
            "{points} points of {frames} frames on straight lines across shadows{place}, taken for missing echoes"
        )
    }
}

/// Points lie on a line where they are off it by less than this share of what is usual in their contour: no noise, and no
/// curvature of a wall, is so even.
const MAX_OFF: f64 = 0.02;
/// Contours whose points are usually off by less than this share of their size consist of lines.
const MIN_USUAL: f64 = 1e-6;
/// Fewest points of a chord, its ends not counted, and its least angle about the contour's middle, rad: 20°.
const MIN_POINTS: usize = 4;
const MIN_SPAN_RAD: f64 = 0.35;
/// Largest share of a contour's points on chords: with more, the contour as a whole is drawn by straight lines.
const MAX_SHARE: f64 = 0.5;

/// A fixed chord shows in the mean shape of all contours: its points lie off the line through its ends by less than this
/// share of what those of a circle would, …
const MAX_FLAT: f64 = 0.1;
/// … and in the mean shape of each quarter of the recording by less than this: a wall that is flat for a while is none.
const MAX_FLAT_QUARTER: f64 = 0.25;
const QUARTERS: usize = 4;
/// It has this angle about the middle at least, rad: 30°. At most one such line is a shadow's: a slit has two flat sides.
const MIN_FIXED_RAD: f64 = 0.52;
/// Fewest frames whose mean shape says something, share of the contours that have as many points, and of the points of a
/// contour that are there.
const MIN_FRAMES: usize = 40;
const MIN_ALIKE: f64 = 0.9;
/// Points that mean shapes are compared at; of more, every so many.
const MAX_COMPARED: usize = 128;

impl Chords {
    /// The chord at one place of the image that a recording has, if any. Others are found contour by contour.
    pub(super) fn fixed_in(frames: &[Frame]) -> Option<Self> {
        let exact = frames.par_iter().filter(|frame| !straight(frame).is_empty()).count();
        let fixed = if 2 * exact > frames.len() { None } else { fixed(frames) };
        fixed.map(|fixed| Self { fixed: Some(fixed), ..Self::default() })
    }

    /// The places of a contour's points on chords, without the ends of these.
    pub(super) fn places(&self, frame: &Frame) -> Vec<usize> {
        let mut places = straight(frame);
        if let Some(FixedChord { of, first, points }) = self.fixed
            && frame.contour_mm.len() == of
        {
            let is_there = |place: &usize| !frame.contour_mm[*place].is_nan();
            places.extend((first..first + points).map(|place| place % of).filter(is_there));
            places.sort_unstable();
            places.dedup();
        }
        places
    }
}

/// The chord that stands at the same place of the image in all frames. Its noise averages out over these.
fn fixed(frames: &[Frame]) -> Option<FixedChord> {
    let mut sizes: Vec<f64> = frames.iter().map(|frame| frame.contour_mm.len() as f64).collect();
    let of = median(&mut sizes) as usize;
    let step = of.div_ceil(MAX_COMPARED).max(1);
    let is_used = |frame: &&Frame| {
        frame.contour_mm.len() == of && frame.echoes_mm().count() as f64 >= MIN_ALIKE * of as f64
    };
    let used: Vec<&Frame> = frames.iter().filter(is_used).collect();
    let compared = of / step;
    if used.len() < MIN_FRAMES || (used.len() as f64) < MIN_ALIKE * frames.len() as f64 || compared < 12 {
        return None;
    }
    // Sums of the points about their middle, in units of their median distance from it, by quarters.
    let of_quarter = |quarter: usize| {
        let ends = [quarter, quarter + 1].map(|q| (q * used.len()).div_ceil(QUARTERS));
        let mut sums = vec![(DVec2::ZERO, 0.0); compared];
        for frame in &used[ends[0]..ends[1]] {
            let count = frame.echoes_mm().count() as f64;
            let middle = frame.echoes_mm().sum::<DVec2>() / count;
            let size = median(&mut frame.echoes_mm().map(|p| p.distance(middle)).collect::<Vec<_>>());
            let points = frame.contour_mm.iter().step_by(step);
            for ((sum, count), p) in sums.iter_mut().zip(points) {
                if p.is_finite() && size > 0.0 {
                    *sum += (*p - middle) / size;
                    *count += 1.0;
                }
            }
        }
        sums
    };
    let sums: Vec<Vec<(DVec2, f64)>> = (0..QUARTERS).into_par_iter().map(of_quarter).collect();
    let shape = |quarters: &[Vec<(DVec2, f64)>]| -> Vec<DVec2> {
        let total = |i: usize| quarters.iter().fold((DVec2::ZERO, 0.0), |(a, n), q| (a + q[i].0, n + q[i].1));
        (0..compared).map(total).map(|(sum, count)| sum / count).collect()
    };
    let whole = shape(&sums);
    let quarters: Vec<Vec<DVec2>> = sums.chunks(1).map(shape).collect();
    let is_chord = |first: usize, points: usize| {
        let ends = [first + compared - 1, first + points].map(|i| whole[i % compared]);
        ends[0].angle_to(ends[1]).abs() >= MIN_FIXED_RAD
            && flatness(&whole, first, points) < MAX_FLAT
            && quarters.iter().all(|quarter| flatness(quarter, first, points) < MAX_FLAT_QUARTER)
    };
    let arcs = |points: usize| (0..compared).map(move |first| (first, points));
    let mut found =
        (MIN_POINTS..=compared / 2).rev().flat_map(arcs).filter(|&(first, points)| is_chord(first, points));
    let (first, points) = found.next()?;
    let is_apart = |(other, more): (usize, usize)| {
        let after = (other + compared - first) % compared;
        after >= points && after + more <= compared
    };
    if found.any(is_apart) {
        return None;
    }
    Some(FixedChord { of, first: first * step, points: (points - 1) * step + 1 })
}

/// How far some points lie off the line through the two beside them, as a root mean square, by what those of a circle of
/// radius one would.
fn flatness(shape: &[DVec2], first: usize, points: usize) -> f64 {
    let at = |i: usize| shape[i % shape.len()];
    let (from, to) = (at(first + shape.len() - 1), at(first + points));
    let along = to - from;
    let off = |i: usize| along.perp_dot(at(i) - from) / along.length();
    let square = (first..first + points).map(|i| off(i).powi(2)).sum::<f64>() / points as f64;
    square.sqrt() * 8.0 / along.length_squared()
}

/// The places of a contour's points on lines without any noise, without the ends of these.
fn straight(frame: &Frame) -> Vec<usize> {
    let points: Vec<(usize, DVec2)> =
        frame.contour_mm.iter().copied().enumerate().filter(|(_, p)| p.is_finite()).collect();
    let count = points.len();
    if count <= MIN_POINTS + 2 {
        return Vec::new();
    }
    let at = |i: usize| points[i % count].1;
    // How far a point lies off the line through the two beside it.
    let off_mm = |i: usize| {
        let (before, here, after) = (at(i + count - 1), at(i), at(i + 1));
        let along = after - before;
        along.perp_dot(here - before).abs() / along.length()
    };
    let off_mm: Vec<f64> = (0..count).map(off_mm).collect();
    let usual_mm = median(&mut off_mm.clone());
    // Equal points have no line: the comparison with what is no number fails.
    let is_straight: Vec<bool> = off_mm.iter().map(|off| *off < MAX_OFF * usual_mm).collect();
    // Most contours have no line.
    let mut is_long = is_straight.iter().cycle().take(count + MIN_POINTS).scan(0, |run, is| {
        *run = if *is { *run + 1 } else { 0 };
        Some(*run >= MIN_POINTS)
    });
    if !is_long.any(|is| is) {
        return Vec::new();
    }
    let Some(middle) = frame.centroid_mm() else { return Vec::new() };
    let size_mm = median(&mut points.iter().map(|(_, p)| p.distance(middle)).collect::<Vec<_>>());
    if usual_mm < MIN_USUAL * size_mm {
        return Vec::new();
    }
    let Some(start) = is_straight.iter().position(|is| !is) else { return Vec::new() };
    let mut found = Vec::new();
    let mut run: Vec<usize> = Vec::new();
    for i in start..=start + count {
        if is_straight[i % count] {
            run.push(i);
            continue;
        }
        let chord = std::mem::take(&mut run);
        let (Some(first), Some(last)) = (chord.first(), chord.last()) else { continue };
        let [from, to] = [first + count - 1, last + 1].map(|i| at(i) - middle);
        let is_one_way = (first + count..=last + count).all(|i| (at(i) - at(i - 1)).dot(to - from) > 0.0);
        if chord.len() >= MIN_POINTS && from.angle_to(to).abs() >= MIN_SPAN_RAD && is_one_way {
            found.extend(chord.iter().map(|i| points[i % count].0));
        }
    }
    if found.len() as f64 > MAX_SHARE * count as f64 { Vec::new() } else { found }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use std::f64::consts::TAU;

    /// A contour of 72 points that waves by a share of its radius, as noise does.
    fn contour(wave: f64) -> Vec<DVec2> {
        let radius_mm = |j: i32| 5.0 * (1.0 + wave * (7.3 * f64::from(j * j)).sin());
        (0..72).map(|j| DVec2::from_angle(f64::from(j) / 72.0 * TAU) * radius_mm(j)).collect()
    }

    fn with_chord(mut contour: Vec<DVec2>, first: usize, points: usize) -> Vec<DVec2> {
        let count = contour.len();
        let (from, to) = (contour[first], contour[(first + points + 1) % count]);
        for k in 1..=points {
            contour[(first + k) % count] = from.lerp(to, k as f64 / (points + 1) as f64);
        }
        contour
    }

    fn found(contour_mm: Vec<DVec2>) -> Vec<usize> {
        let mut places = straight(&Frame::new(Pose::IDENTITY, contour_mm));
        places.sort_unstable();
        places
    }

    #[test]
    fn a_chord_is_found_wherever_the_contour_begins_with_noise_and_without() {
        for wave in [0.0, 0.001, 0.05] {
            assert_eq!(found(contour(wave)), Vec::<usize>::new(), "{wave}");
            assert_eq!(found(with_chord(contour(wave), 20, 12)), (21..33).collect::<Vec<_>>(), "{wave}");
            let across: Vec<usize> = (0..3).chain(63..72).collect();
            assert_eq!(found(with_chord(contour(wave), 62, 12)), across, "{wave}");
        }
    }

    #[test]
    fn short_lines_bent_lines_and_drawn_polygons_are_no_chords() {
        assert!(found(with_chord(contour(0.05), 20, 2)).is_empty());
        let mut bent = with_chord(contour(0.05), 20, 12);
        // Every point off by a tenth of the noise.
        bent.iter_mut().enumerate().for_each(|(k, p)| *p *= 1.0 + 0.01 * (1.7 * k as f64).sin());
        assert!(found(bent).is_empty());
        let corner = |k: usize| DVec2::from_angle(k as f64 / 6.0 * TAU) * 5.0;
        let polygon = (0..72).map(|j| corner(j / 12).lerp(corner(j / 12 + 1), (j % 12) as f64 / 12.0));
        assert!(found(polygon.collect()).is_empty());
        assert!(found(vec![DVec2::ONE; 30]).is_empty());
        assert!(found(vec![DVec2::NAN; 30]).is_empty());
    }

    /// Frames whose contours have noise of a tenth of their radius, on what `shape` makes of a circle's point.
    fn noisy(shape: impl Fn(usize, usize) -> DVec2) -> Vec<Frame> {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut noise = || rng.random::<f64>() + rng.random::<f64>() + rng.random::<f64>() - 1.5;
        let frame = |k: usize| {
            let contour = (0..72).map(|j| shape(k, j) + DVec2::new(noise(), noise())).collect();
            Frame::new(Pose::IDENTITY, contour)
        };
        (0..240).map(frame).collect()
    }

    fn on_circle(j: usize) -> DVec2 {
        DVec2::from_angle(j as f64 / 72.0 * TAU) * 5.0
    }

    fn behind_shadow(first: usize, j: usize) -> DVec2 {
        let after = (j + 72 - first) % 72;
        if after > 13 {
            return on_circle(j);
        }
        on_circle(first).lerp(on_circle(first + 13), after as f64 / 13.0)
    }

    #[test]
    fn a_fixed_chord_is_found_under_noise() {
        for first in [20, 65] {
            let chords = Chords::fixed_in(&noisy(|_, j| behind_shadow(first, j))).unwrap();
            let fixed = chords.fixed.unwrap();
            assert!(fixed.points.abs_diff(12) <= 2 && (fixed.first + 72 - first) % 72 <= 2, "{fixed:?}");
            let frame = &noisy(|_, j| behind_shadow(first, j))[7];
            assert_eq!(chords.places(frame).len(), fixed.points);
        }
    }

    #[test]
    fn circles_flat_stretches_and_slits_have_no_fixed_chord() {
        assert_eq!(Chords::fixed_in(&noisy(|_, j| on_circle(j))), None);
        // Flat in half of the frames.
        let stretch = |k: usize, j: usize| if k < 120 { behind_shadow(20, j) } else { on_circle(j) };
        assert_eq!(Chords::fixed_in(&noisy(stretch)), None);
        let slit = |_: usize, j: usize| {
            let p = on_circle(j);
            DVec2::new(2.0 * p.x, p.y.clamp(-1.5, 1.5))
        };
        assert_eq!(Chords::fixed_in(&noisy(slit)), None);
        assert_eq!(Chords::fixed_in(&noisy(|_, j| DVec2::new(2.0, 0.7) * on_circle(j))), None);
    }
}
