//! What may be wrong with a recording as a whole, or with frames that are used all the same.

use super::LeftOut;
use super::hints::{contour_centre, convention};
use crate::numerics::robust::median_size;
use crate::recording::finding::{Finding, Findings};
use crate::recording::summary::{MinMedianMax, min_median_max};
use crate::recording::{Frame, Recording};
use rayon::prelude::*;

/// No step is a jump below this, mm …
const MIN_JUMP_MM: f64 = 5.0;
/// … and no turn below this, rad.
const MIN_JUMP_RAD: f64 = 0.35;
/// A step or turn is a jump above this multiple of the median one.
const JUMP_FACTOR: f64 = 10.0;
/// Wall points that enclose an area: with fewer no cylinder can be estimated. A frame with a model may have fewer,
/// because its cylinder uses earlier frames too, so that this is only suspicious.
const MIN_POINTS: usize = 3;
/// Median contour radii that a vessel may have, mm: below lies a vessel in metres, above one in micrometres.
const LUMEN_RADII_MM: std::ops::Range<f64> = 0.2..100.0;
/// Longest usual time from frame to frame, s: gated recordings have one frame in a heart beat.
const MAX_INTERVAL_S: f64 = 5.0;
/// A path shorter than this many contour radii, and longer than that in metres, is given in metres.
const METRES_PATH_RADII: f64 = 0.1;

/// Whatever is suspicious about the frames that are used, once their contours are cleaned.
pub(super) fn suspicions(recording: &Recording, cleaned: &[Frame], left_out: &[LeftOut]) -> Vec<Finding> {
    let is_left = |k: usize| left_out.binary_search_by_key(&k, |one| one.place).is_ok();
    let mut findings = Findings::new(cleaned.len());
    let frames: Vec<(usize, &Frame)> = cleaned.iter().enumerate().filter(|(k, _)| !is_left(*k)).collect();
    for &(k, frame) in &frames {
        let (points, missing) = (frame.echoes_mm().count(), frame.missing_echoes());
        if points < MIN_POINTS {
            let found = format!("{points} ({missing} missing echoes)");
            findings.add("wall points", format!("at least {MIN_POINTS}"), false, k, found);
        }
    }
    let steps = between(&frames, |a, b| {
        a.world_from_sensor.translation_mm.distance(b.world_from_sensor.translation_mm)
    });
    let turns = between(&frames, |a, b| a.world_from_sensor.turn_rad(&b.world_from_sensor));
    let limit = |least: f64, values: &[(usize, f64)]| {
        let median = min_median_max(values.iter().map(|v| v.1)).map_or(0.0, |s| s.median);
        least.max(JUMP_FACTOR * median)
    };
    let max_mm = limit(MIN_JUMP_MM, &steps);
    for &(k, step) in steps.iter().filter(|s| s.1 > max_mm) {
        let expected = format!("steps of at most {max_mm:.2} mm");
        findings.add("position jump", expected, false, k, format!("{step:.2} mm"));
    }
    let max_rad = limit(MIN_JUMP_RAD, &turns);
    for &(k, turn) in turns.iter().filter(|t| t.1 > max_rad) {
        let expected = format!("turns of at most {:.1} degrees", max_rad.to_degrees());
        findings.add("rotation jump", expected, false, k, format!("{:.1} degrees", turn.to_degrees()));
    }
    times(&frames, &mut findings);
    let path_mm: f64 = steps.iter().map(|s| s.1).sum();
    let frames: Vec<&Frame> = frames.iter().map(|(_, frame)| *frame).collect();
    let is_of_length = lengths(&frames, path_mm, &mut findings);
    let is_about_probe = match contour_centre(&frames) {
        None => true,
        Some(found) => {
            findings.list.push(found);
            false
        }
    };
    if is_of_length && is_about_probe {
        findings.list.extend(convention(&frames));
    }
    findings.named(recording)
}

/// A quantity of each two consecutive frames, with the second one's number.
fn between(frames: &[(usize, &Frame)], of: impl Fn(&Frame, &Frame) -> f64) -> Vec<(usize, f64)> {
    let pairs = frames.iter().zip(frames.iter().skip(1));
    pairs.map(|((_, a), (k, b))| (*k, of(a, b))).filter(|(_, value)| value.is_finite()).collect()
}

/// Times that fall, and units other than seconds.
fn times(frames: &[(usize, &Frame)], findings: &mut Findings) {
    let times: Vec<(usize, f64)> = frames.iter().filter_map(|&(k, f)| Some((k, f.time_s?))).collect();
    let mut intervals = Vec::new();
    for pair in times.windows(2) {
        let &[(j, earlier), (k, later)] = pair else { continue };
        if later <= earlier {
            let found = format!("{later} s after {earlier} s");
            findings.add("time", "times that rise".into(), false, k, found);
        }
        intervals.push((later - earlier) / (k - j) as f64);
    }
    let Some(MinMedianMax { median, .. }) = min_median_max(intervals) else { return };
    if median > MAX_INTERVAL_S {
        // Frames come once a heart beat at the slowest, 500 times a second at the fastest.
        let unit = match median {
            m if m < 5e3 => "ms",
            m if m < 5e6 => "us",
            _ => "ns",
        };
        findings.add_whole(
            "time",
            format!("at most {MAX_INTERVAL_S} s from frame to frame"),
            false,
            format!("median {median:.0} s: are the times in {unit}?"),
            Some(format!("--time-unit {unit}")),
        );
    }
}

/// Contours and paths of a size that no vessel has. Whether both have a vessel's.
fn lengths(frames: &[&Frame], path_mm: f64, findings: &mut Findings) -> bool {
    let radii = frames.par_iter().flat_map_iter(|frame| {
        let centre = frame.centroid_mm();
        frame.echoes_mm().filter_map(move |p| Some(p.distance(centre?)).filter(|d| d.is_finite()))
    });
    let radii: Vec<f64> = radii.collect();
    if radii.is_empty() {
        return true;
    }
    let radius_mm = median_size(&radii);
    if !LUMEN_RADII_MM.contains(&radius_mm) {
        let (guess, unit) =
            if radius_mm < LUMEN_RADII_MM.start { ("metres", "m") } else { ("micrometres or pixels", "um") };
        findings.add_whole(
            "contour radius",
            format!("{} to {} mm", LUMEN_RADII_MM.start, LUMEN_RADII_MM.end),
            false,
            format!("median {radius_mm:.4} mm: are the contours in {guess}?"),
            Some(format!("--contour-units {unit}, and --units {unit} where positions are too")),
        );
        return false;
    }
    if frames.len() > 1
        && 0.0 < path_mm
        && path_mm < METRES_PATH_RADII * radius_mm
        && path_mm * 1e3 > radius_mm
    {
        findings.add_whole(
            "path",
            format!("at least {METRES_PATH_RADII} of the contours' radius"),
            false,
            format!(
                "{path_mm:.4} mm long with contours of {radius_mm:.2} mm radius: are the positions in metres?"
            ),
            Some("--units m".into()),
        );
        return false;
    }
    true
}
