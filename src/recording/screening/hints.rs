//! Conventions under which neighbouring contours agree better than as the recording is read.

use super::probe::outside_by_mm;
use crate::numerics::robust::median;
use crate::recording::finding::{Finding, Findings};
use crate::recording::{Conventions, Frame, QuaternionOrder};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Contours are suspected of another origin where more than this share of them does not contain the probe.
const OUTSIDE_SHARE: f64 = 0.5;
/// So many pairs of frames are compared.
const MAX_PAIRS: usize = 256;
/// With fewer, nothing is said.
const MIN_PAIRS: usize = 20;
/// Pairs lie so many contour radii apart.
const PAIR_RADII: f64 = 0.5;
/// Points of a contour are compared with another where they lie at most so many radii off its plane.
const PLANE_RADII: f64 = 0.75;
/// Directions in which a contour's radius is known, and in how many of them it must be.
const DIRECTIONS: usize = 32;
const LEAST_KNOWN: usize = DIRECTIONS / 4;
/// Another convention is named where neighbouring contours then differ by at most this share of what they do …
const BETTER: f64 = 0.9;
/// … and less in at least this share of the pairs.
const BETTER_PAIRS: f64 = 0.72;

/// A finding where most contours do not contain the probe, but have a common centre elsewhere.
pub(super) fn contour_centre(frames: &[&Frame]) -> Option<Finding> {
    let centres: Vec<DVec2> = frames.par_iter().filter_map(|frame| frame.centroid_mm()).collect();
    let outside = frames.par_iter().filter(|frame| outside_by_mm(frame).is_some()).count();
    if outside as f64 <= OUTSIDE_SHARE * centres.len() as f64 || centres.is_empty() {
        return None;
    }
    let centre = |of: fn(&DVec2) -> f64| median(&mut centres.iter().map(of).collect::<Vec<_>>());
    let (x, y) = (centre(|c| c.x), centre(|c| c.y));
    let mut findings = Findings::new(frames.len());
    findings.add_whole(
        "contours",
        "contours about the probe, which is their origin",
        false,
        format!(
            "{outside} of {} do not contain the probe; their centres are about ({x:.2}, {y:.2}) mm: are they given from \
             the image's corner?",
            centres.len()
        ),
        Some(format!("--contour-centre X,Y, with the probe's place in the image in mm, near {x:.2},{y:.2}")),
    );
    findings.list.pop()
}

/// A finding where neighbouring contours agree better under another convention.
pub(super) fn convention(frames: &[&Frame]) -> Option<Finding> {
    let here = Conventions::default();
    let wxyz = here.with_quaternion(QuaternionOrder::Wxyz);
    let alternatives = [
        (wxyz, "quaternions that begin with w", "--quaternion wxyz"),
        (here.with_inverse(true), "inverse poses", "--inverse"),
        (here.with_flip_y(true), "contours whose y runs down", "--flip-y"),
        (
            wxyz.with_inverse(true),
            "inverse poses whose quaternions begin with w",
            "--quaternion wxyz --inverse",
        ),
    ];
    let radius = |(k, frame): (usize, &&Frame)| Some((k, Profile::radius_mm(frame)?));
    let (usable, mut radii): (Vec<usize>, Vec<f64>) =
        frames.par_iter().enumerate().filter_map(radius).unzip();
    let radius_mm = median(&mut radii);
    let pairs = pairs(frames, &usable, radius_mm);
    if pairs.len() < MIN_PAIRS {
        return None;
    }
    let differences = |conventions: &Conventions| -> Vec<f64> {
        let difference = |&(a, b): &(usize, usize)| {
            difference(&conventions.apply_to(frames[a]), &conventions.apply_to(frames[b]), radius_mm)
        };
        pairs.par_iter().map(difference).collect()
    };
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let as_read = differences(&here);
    let best = alternatives
        .iter()
        .map(|alternative| (alternative, differences(&alternative.0)))
        .min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)))?;
    let ((_, what, remedy), changed) = best;
    let better = changed.iter().zip(&as_read).filter(|(changed, as_read)| changed < as_read).count();
    let is_better =
        mean(&changed) <= BETTER * mean(&as_read) && better as f64 >= BETTER_PAIRS * pairs.len() as f64;
    if !is_better {
        return None;
    }
    let mut findings = Findings::new(frames.len());
    findings.add_whole(
        "conventions",
        "neighbouring contours that agree",
        false,
        format!(
            "contours {PAIR_RADII} radii apart differ by {:.1} % of their radius, by {:.1} % with {what}",
            100.0 * mean(&as_read),
            100.0 * mean(&changed)
        ),
        Some((*remedy).into()),
    );
    findings.list.pop()
}

/// Pairs of usable frames that lie about [`PAIR_RADII`] radii apart, spread over the recording.
fn pairs(frames: &[&Frame], usable: &[usize], radius_mm: f64) -> Vec<(usize, usize)> {
    let position = |i: usize| frames[usable[i]].world_from_sensor.translation_mm;
    let apart_mm = PAIR_RADII * radius_mm;
    let mut pairs = Vec::new();
    let mut b = 0;
    for a in 0..usable.len() {
        b = b.max(a + 1);
        while b < usable.len() && position(a).distance(position(b)) < apart_mm {
            b += 1;
        }
        if b < usable.len() && position(a).distance(position(b)) < 2.0 * apart_mm {
            pairs.push((usable[a], usable[b]));
        }
    }
    let every = pairs.len().div_ceil(MAX_PAIRS).max(1);
    pairs.into_iter().step_by(every).collect()
}

/// Median difference of the radii of one contour and of the points of another, in radii; 1 where they do not overlap.
fn difference(a: &Frame, b: &Frame, radius_mm: f64) -> f64 {
    let one_way = |a: &Frame, b: &Frame| -> Option<f64> {
        let profile = Profile::of(a)?;
        let a_from_b = a.world_from_sensor.inverse() * b.world_from_sensor;
        let mut differences: Vec<f64> = b
            .echoes_mm()
            .map(|p| a_from_b.transform_point(DVec3::new(p.x, p.y, 0.0)))
            .filter(|p| p.z.abs() <= PLANE_RADII * radius_mm)
            .filter_map(|p| profile.difference_mm(p.truncate()))
            .collect();
        (differences.len() >= 8).then(|| median(&mut differences) / radius_mm)
    };
    let both = one_way(a, b).unwrap_or(1.0) + one_way(b, a).unwrap_or(1.0);
    (both / 2.0).min(1.0)
}

/// The radius of a contour about its centroid, direction by direction.
struct Profile {
    centre_mm: DVec2,
    radii_mm: [Option<f64>; DIRECTIONS],
}

impl Profile {
    fn of(frame: &Frame) -> Option<Self> {
        let centre_mm = frame.centroid_mm()?;
        let mut radii: [Vec<f64>; DIRECTIONS] = Default::default();
        for p in frame.echoes_mm() {
            let from_centre = p - centre_mm;
            radii[direction(from_centre)].push(from_centre.length());
        }
        let radii_mm = radii.map(|mut radii| (!radii.is_empty()).then(|| median(&mut radii)));
        let known = radii_mm.iter().flatten().count();
        (known >= LEAST_KNOWN).then_some(Self { centre_mm, radii_mm })
    }

    /// Median radius of a contour that has a profile, mm.
    fn radius_mm(frame: &Frame) -> Option<f64> {
        let centre_mm = frame.centroid_mm()?;
        let mut is_known = [false; DIRECTIONS];
        let mut known = 0;
        let mut radii_mm = Vec::new();
        for p in frame.echoes_mm() {
            let from_centre = p - centre_mm;
            if known < LEAST_KNOWN {
                let is_known = &mut is_known[direction(from_centre)];
                known += usize::from(!std::mem::replace(is_known, true));
            }
            radii_mm.push(from_centre.length());
        }
        (known >= LEAST_KNOWN).then(|| median(&mut radii_mm))
    }

    fn difference_mm(&self, p: DVec2) -> Option<f64> {
        let from_centre = p - self.centre_mm;
        Some((from_centre.length() - self.radii_mm[direction(from_centre)]?).abs())
    }
}

fn direction(p: DVec2) -> usize {
    (((p.to_angle() + PI) / TAU * DIRECTIONS as f64) as usize).min(DIRECTIONS - 1)
}
