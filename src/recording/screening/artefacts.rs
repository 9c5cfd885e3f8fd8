//! What imaging and segmentation add to contours: echoes of the catheter itself, and points without an order.

use crate::numerics::robust::{SD_PER_MAD, median};
use crate::recording::Frame;
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::fmt;

/// Arcs at a constant distance from the probe, which are reverberations of the catheter (ring-down), not wall.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct RingDown {
    /// Their distance from the probe, mm.
    pub radius_mm: f64,
    /// How far points of theirs lie from it at most, mm.
    pub tolerance_mm: f64,
    /// Points that are taken for missing echoes, and the frames that have them.
    pub points: usize,
    /// Frames with such points.
    pub frames: usize,
}

impl fmt::Display for RingDown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { radius_mm, points, frames, .. } = self;
        write!(
            f,
            "{points} points of {frames} frames in arcs {radius_mm:.2} mm from the probe (ring-down), taken for missing \
             echoes"
        )
    }
}

/// Bins per factor e of the distance, and bins of the widest peak: 2 % and 10 %.
const BINS_PER_E: f64 = 50.0;
const PEAK_BINS: usize = 5;
/// Distances that are counted, mm.
const NEAREST_MM: f64 = 0.01;
const BINS: usize = 800;
/// Share of all points in the peak at least, before it at most, and beyond it at least: ring-down lies within the lumen.
const MIN_IN: f64 = 0.03;
const MAX_NEARER: f64 = 0.2;
const MIN_BEYOND: f64 = 0.4;
/// The peak has so many times the points of the equally wide bands on either side.
const MIN_CONTRAST: f64 = 4.0;
/// Narrowest arc, rad, in this share of all frames at least.
const MIN_ARC_RAD: f64 = 0.3;
const MIN_FRAMES: f64 = 0.2;
/// Beside an arc the wall is farther from the probe by this factor: at both ends, in most frames, for a recording to have
/// ring-down; at one end for an arc to be left out.
const MIN_STEP: f64 = 1.25;
/// Points beside an arc that are compared.
const BESIDE: usize = 3;
/// Tolerance in standard deviations of the peak.
const TOLERANCE_SDS: f64 = 4.0;

/// A run of a contour's points: their places, the angle that they span, and by which factor the wall beside it is farther.
struct Arc {
    places: Vec<usize>,
    span_rad: f64,
    steps: [f64; 2],
}

/// Runs of points within a tolerance of a distance from the probe, at most one other point in between.
fn arcs(frame: &Frame, radius_mm: f64, tolerance_mm: f64) -> Vec<Arc> {
    let points: Vec<(usize, DVec2)> =
        frame.contour_mm.iter().copied().enumerate().filter(|(_, p)| !p.is_nan()).collect();
    let count = points.len();
    let is_in: Vec<bool> =
        points.iter().map(|(_, p)| (p.length() - radius_mm).abs() <= tolerance_mm).collect();
    // From a place with two points outside on, no run goes across the end.
    let Some(start) = (0..count).find(|&i| !is_in[i] && !is_in[(i + count - 1) % count]) else {
        return Vec::new();
    };
    let mut runs: Vec<Vec<usize>> = Vec::new();
    for i in (start..start + count).filter(|i| is_in[i % count]) {
        match runs.last_mut() {
            Some(run) if run.last().is_some_and(|last| i - last <= 2) => run.push(i),
            _ => runs.push(vec![i]),
        }
    }
    let at = |i: usize| points[i % count].1;
    let beside = |of: [usize; BESIDE]| median(&mut of.map(|i| at(i).length())) / radius_mm;
    runs.into_iter()
        .map(|run| {
            let (first, last) = (run[0], run[run.len() - 1]);
            let turn = |i: usize| (at(i).angle_to(at(i + 1))).abs();
            Arc {
                span_rad: (first..last).map(turn).sum(),
                steps: [
                    beside(std::array::from_fn(|k| first + count - 1 - k)),
                    beside(std::array::from_fn(|k| last + 1 + k)),
                ],
                places: run.into_iter().map(|i| points[i % count].0).collect(),
            }
        })
        .collect()
}

impl RingDown {
    /// The ring-down of a recording, if it has any. A distance counts at which many points lie and few nearby, in arcs with
    /// the wall farther away at either end. A probe that rests in the middle of a round vessel has all points at one
    /// distance, and no wall beyond.
    pub(super) fn of(frames: &[Frame]) -> Option<Self> {
        let bin = |d: f64| (((d / NEAREST_MM).ln() * BINS_PER_E).max(0.0) as usize).min(BINS - 1);
        let counts = frames
            .par_iter()
            .fold(
                || vec![0_u64; BINS],
                |mut counts, frame| {
                    distances(frame).filter(|d| d.is_finite()).for_each(|d| counts[bin(d)] += 1);
                    counts
                },
            )
            .reduce(
                || vec![0; BINS],
                |mut counts, others| {
                    counts.iter_mut().zip(others).for_each(|(count, other)| *count += other);
                    counts
                },
            );
        let counts: Vec<f64> = counts.into_iter().map(|count| count as f64).collect();
        let total: f64 = counts.iter().sum();
        let sum = |from: usize, to: usize| counts[from.min(BINS)..to.min(BINS)].iter().sum::<f64>();
        let is_peak = |from: &usize| {
            let to = from + PEAK_BINS;
            let inside = sum(*from, to);
            let beside = sum(from.saturating_sub(PEAK_BINS), *from).max(sum(to, to + PEAK_BINS));
            inside >= MIN_IN * total
                && inside >= MIN_CONTRAST * beside
                && sum(0, *from) <= MAX_NEARER * total
                && sum(to, BINS) >= MIN_BEYOND * total
        };
        let most = |a: &usize, b: &usize| sum(*a, a + PEAK_BINS).total_cmp(&sum(*b, b + PEAK_BINS));
        let from = (0..BINS - PEAK_BINS).filter(is_peak).max_by(most)?;
        let mut of_peak: Vec<f64> = frames
            .iter()
            .flat_map(distances)
            .filter(|d| (from..from + PEAK_BINS).contains(&bin(*d)))
            .collect();
        let radius_mm = median(&mut of_peak);
        let mut deviations: Vec<f64> = of_peak.iter().map(|d| (d - radius_mm).abs()).collect();
        let tolerance_mm = (TOLERANCE_SDS * SD_PER_MAD * median(&mut deviations)).max(1e-3 * radius_mm);
        let is_stepped =
            |arc: &Arc| arc.span_rad >= MIN_ARC_RAD && arc.steps.iter().all(|step| *step >= MIN_STEP);
        let stepped =
            frames.par_iter().filter(|frame| arcs(frame, radius_mm, tolerance_mm).iter().any(is_stepped));
        let is_usual = stepped.count() as f64 >= MIN_FRAMES * frames.len() as f64;
        is_usual.then_some(Self { radius_mm, tolerance_mm, points: 0, frames: 0 })
    }

    /// The places of a contour's points that are ring-down: an arc, or what noise has cut off from it, with the wall beyond
    /// at both ends, or a longer arc with the wall beyond at one.
    pub(super) fn places(&self, frame: &Frame) -> Vec<usize> {
        let arcs = arcs(frame, self.radius_mm, self.tolerance_mm);
        let is_left_out = |arc: &Arc| {
            let steps = arc.steps.iter().filter(|step| **step >= MIN_STEP).count();
            steps == 2 || steps == 1 && arc.span_rad >= MIN_ARC_RAD / 2.0
        };
        arcs.into_iter().filter(is_left_out).flat_map(|arc| arc.places).collect()
    }
}

/// In a contour with an order, a quarter of the points is a quarter of the way about the centre, in one direction: the mean
/// sine of that angle is near 1 or -1. It has no order where it is nearer to 0 than this, …
const MIN_MEAN_SINE: f64 = 0.3;
/// … and the median angle from point to point is larger than this many even ones: a lumen that bends round another place
/// turns back, but in small steps.
const MAX_EVEN_ANGLES: f64 = 2.0;
/// With fewer points nothing tells an order.
const MIN_POINTS: usize = 8;

/// Distances of a contour's points from the probe, mm.
fn distances(frame: &Frame) -> impl Iterator<Item = f64> + '_ {
    frame.echoes_mm().map(DVec2::length)
}

/// The points of a contour without an order, sorted about their centre; `None` for one that has an order.
pub(super) fn sorted(frame: &Frame) -> Option<Vec<DVec2>> {
    let points: Vec<DVec2> = frame.echoes_mm().collect();
    if points.len() < MIN_POINTS {
        return None;
    }
    let middle = |of: fn(&DVec2) -> f64| median(&mut points.iter().map(of).collect::<Vec<_>>());
    let centre = DVec2::new(middle(|p| p.x), middle(|p| p.y));
    let count = points.len();
    let directions: Vec<DVec2> = points.iter().map(|p| (p - centre).normalize_or(DVec2::X)).collect();
    let sine = |i: usize| directions[i].perp_dot(directions[(i + count / 4) % count]);
    let mean_sine = (0..count).map(sine).sum::<f64>() / count as f64;
    if mean_sine.abs() >= MIN_MEAN_SINE {
        return None;
    }
    let mut turns: Vec<f64> =
        (0..count).map(|i| directions[i].angle_to(directions[(i + 1) % count]).abs()).collect();
    if median(&mut turns) <= MAX_EVEN_ANGLES * TAU / count as f64 {
        return None;
    }
    let angles: Vec<f64> = directions.iter().map(|d| d.to_angle()).collect();
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| angles[a].total_cmp(&angles[b]));
    let mut sorted: Vec<DVec2> = order.into_iter().map(|i| points[i]).collect();
    sorted.resize(frame.contour_mm.len(), DVec2::NAN);
    Some(sorted)
}
