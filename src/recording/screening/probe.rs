//! Contours that do not contain the probe.

use super::{LeftOut, Reason, Screening};
use crate::geometry::polygon::turns_about_origin;
use crate::numerics::robust::median;
use crate::recording::Frame;
use glam::DVec2;
use rayon::prelude::*;

/// A contour with more of its echoes missing may be open towards the probe.
const MAX_MISSING_SHARE: f64 = 0.25;
/// Noise may carry the wall past a probe that touches it, by less than this share of the contour's radius.
const NOISE_RADII: f64 = 0.25;

/// The frames, of those at `numbers`, whose contour does not contain the probe, at the origin of its plane. Where these are
/// too many to be left out, contours are given about another origin: then none is named here.
pub(super) fn outside(frames: &[Frame], numbers: &[usize]) -> Vec<LeftOut> {
    let outside: Vec<(usize, f64)> =
        numbers.par_iter().filter_map(|&k| Some((k, outside_by_mm(&frames[k])?))).collect();
    if outside.len() as f64 > Screening::MAX_SHARE * numbers.len() as f64 {
        return Vec::new();
    }
    outside.into_iter().map(|(frame, by_mm)| left_out(frame, by_mm)).collect()
}

pub(super) fn left_out(frame: usize, by_mm: f64) -> LeftOut {
    LeftOut {
        place: frame,
        frame,
        reason: Reason::ProbeOutside,
        field: "contour",
        found: format!("the probe {by_mm:.2} mm outside"),
        expected: "the probe inside".into(),
    }
}

/// How far outside a contour the probe lies, mm; `None` where it lies inside, or the contour does not tell.
pub(super) fn outside_by_mm(frame: &Frame) -> Option<f64> {
    let echoes: Vec<DVec2> = frame.echoes_mm().collect();
    if echoes.len() < 3 || frame.missing_echoes() as f64 > MAX_MISSING_SHARE * frame.contour_mm.len() as f64 {
        return None;
    }
    if turns_about_origin(&echoes) != 0 {
        return None;
    }
    let next = echoes.iter().cycle().skip(1);
    let distance = |(a, b): (&DVec2, &DVec2)| {
        let along = *b - *a;
        let share = (-a.dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (*a + along * share).length()
    };
    let by_mm = echoes.iter().zip(next).map(distance).fold(f64::INFINITY, f64::min);
    let centre = frame.centroid_mm()?;
    let radius_mm = median(&mut echoes.iter().map(|p| p.distance(centre)).collect::<Vec<_>>());
    (by_mm > NOISE_RADII * radius_mm).then_some(by_mm)
}
