//! Whole cylinders compared.

use crate::device::{Device, say};
use crate::nudge::{Nudge, nudges};
use crate::sections::{RADIUS_MM, recording, wall};
use lumenmesh::cylinders::{CpuEngine, DeformedTube, Engine, FitRequest, FittedCylinder, Track};
use lumenmesh::low_level::cylinders::passes::Section;
use lumenmesh::recording::Recording;
use lumenmesh::settings::Settings;

/// A tube's numbers in a form whose equality is that of bits: NaN equals itself, 0 is not -0.
fn bits(tube: &DeformedTube) -> Vec<Vec<u64>> {
    let of = |numbers: &[f64]| numbers.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
    let mut all = vec![of(&tube.radii_mm), of(&tube.travel_mm), of(&tube.residual_mm)];
    all.push(tube.support.iter().map(|&n| u64::from(n)).collect());
    all.push(vec![tube.points, tube.gated, tube.rejected]);
    all.extend(tube.history_mm.iter().map(|radii| of(radii)));
    all
}

/// Equal to the last bit.
pub fn assert_same(found: &DeformedTube, expected: &DeformedTube) {
    assert_eq!(found.tube, expected.tube);
    assert!(bits(found) == bits(expected), "found {found:?}\nexpected {expected:?}");
}

/// The points of one section, moved by some roundings.
pub fn nudged(section: &Section<f32>, nudge: &mut Nudge) -> Section<f32> {
    let mut of =
        |numbers: &[f32], size: f64| numbers.iter().map(|&x| nudge.of(x, size)).collect::<Vec<f32>>();
    let [r, z] = [&section.r, &section.z].map(|numbers| of(numbers, RADIUS_MM));
    let in_turn = |theta: f32| theta.max(0.0).min(std::f32::consts::TAU.next_down());
    let theta = of(&section.theta, std::f64::consts::TAU).into_iter().map(in_turn).collect();
    Section { r: r.into_iter().map(|r| r.max(0.0)).collect(), theta, z, gated: section.gated }
}

/// What the CPU fits to a section, moved or not.
pub fn fitted_section(section: &Section<f32>, settings: &Settings) -> DeformedTube {
    CpuEngine::<f32>::new().fit_section(section, RADIUS_MM, settings).unwrap().tube
}

/// What the CPU fits to a recording.
pub fn fitted(recording: &Recording, settings: &Settings, frames: &[usize]) -> Vec<FittedCylinder> {
    let track = Track::of(recording, settings).unwrap();
    let request = FitRequest::new(&track, frames, settings).with_history(true);
    CpuEngine::<f32>::new().fit(&request).unwrap().cylinders
}

/// A recording whose echoes are moved by some roundings of the tube's radius and length.
fn nudged_recording(recording: &Recording, nudge: &mut Nudge) -> Recording {
    let mut recording = recording.clone();
    for p in recording.frames.iter_mut().flat_map(|frame| &mut frame.contour_mm) {
        let mut by = || f64::from(nudge.of(0.0, RADIUS_MM));
        (p.x, p.y) = (p.x + by(), p.y + by());
    }
    recording
}

/// Numbers of an inexact device and of its twin are alike up to this, mm: some roundings of the radius.
const ALIKE_MM: f64 = 1e-4;
/// A difference is explained where it is at most so many times that of the twin with moved inputs.
const AS_FAR: f64 = 2.0;

/// A tube's numbers, with how far each may be from another device's.
fn numbers(tube: &DeformedTube) -> impl Iterator<Item = (&'static str, f64, f64)> {
    let mm = |name| move |&x: &f64| (name, x, ALIKE_MM);
    let support = tube.support.iter().map(|&n| ("support", f64::from(n), 0.0));
    let counts = [("points", tube.points), ("gated", tube.gated), ("rejected", tube.rejected)];
    tube.radii_mm
        .iter()
        .map(mm("radius"))
        .chain(tube.residual_mm.iter().map(mm("residual")))
        .chain(tube.travel_mm.iter().map(mm("travel")))
        .chain(tube.history_mm.iter().flatten().map(mm("radius of an iteration")))
        .chain(support)
        .chain(counts.map(|(name, count)| (name, count as f64, 0.0)))
}

/// The difference of two numbers; infinite where one of them is none, as the residual of a node without points.
fn apart(x: f64, y: f64) -> f64 {
    match (x.is_nan(), y.is_nan()) {
        (true, true) => 0.0,
        (false, false) => (x - y).abs(),
        _ => f64::INFINITY,
    }
}

/// Whether an inexact device computed what its twin did: every number is alike to some roundings, or else differs where
/// the twin does too when its inputs are moved by as much, and no farther than [`AS_FAR`] times that. The share of
/// numbers that need explaining is the result.
fn agree(
    found: &DeformedTube,
    expected: &DeformedTube,
    moved: &mut dyn FnMut() -> Vec<DeformedTube>,
) -> Result<f64, String> {
    if found.tube != expected.tube || numbers(found).count() != numbers(expected).count() {
        return Err("another tube".into());
    }
    let differs = |(_, x, alike): (&str, f64, f64), y: f64| apart(x, y) > alike;
    let unlike: Vec<usize> = numbers(found)
        .zip(numbers(expected))
        .enumerate()
        .filter(|(_, (found, expected))| differs(*found, expected.1))
        .map(|(i, _)| i)
        .collect();
    if unlike.is_empty() {
        return Ok(0.0);
    }
    let mut reach = vec![0.0_f64; numbers(expected).count()];
    for tube in moved() {
        for ((far, moved), expected) in reach.iter_mut().zip(numbers(&tube)).zip(numbers(expected)) {
            *far = far.max(apart(moved.1, expected.1));
        }
    }
    let (found, expected): (Vec<_>, Vec<_>) = (numbers(found).collect(), numbers(expected).collect());
    for &i in &unlike {
        let (name, alike) = (found[i].0, found[i].2);
        if differs((name, found[i].1, alike + AS_FAR * reach[i]), expected[i].1) {
            return Err(format!(
                "number {i}, a {name}: found {}, expected {}; with inputs that are off by rounding the twin differs by \
                 {:e}",
                found[i].1, expected[i].1, reach[i]
            ));
        }
    }
    Ok(unlike.len() as f64 / found.len() as f64)
}

/// A section's tube: equal to the bit on an exact device; elsewhere explained, number by number.
pub fn assert_agree(
    device: &Device,
    found: &DeformedTube,
    expected: &DeformedTube,
    section: &Section<f32>,
    settings: &Settings,
) {
    if device.exact {
        return assert_same(found, expected);
    }
    let mut moved =
        || nudges().map(|mut nudge| fitted_section(&nudged(section, &mut nudge), settings)).collect();
    let share = agree(found, expected, &mut moved).unwrap();
    say(&format!("{} points: {:.3} % decided by rounding", section.len(), 100.0 * share));
}

/// A recording's cylinders: equal to the bit on an exact device; elsewhere explained, number by number.
pub fn assert_all_agree(
    device: &Device,
    found: &[FittedCylinder],
    expected: &[FittedCylinder],
    recording: &Recording,
    settings: &Settings,
) {
    assert_eq!(found.len(), expected.len());
    let frames: Vec<usize> = expected.iter().map(|cylinder| cylinder.frame).collect();
    let mut moved: Option<Vec<Vec<FittedCylinder>>> = None;
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert_eq!((found.frame, found.world_from_cylinder), (expected.frame, expected.world_from_cylinder));
        if device.exact {
            assert_same(&found.tube, &expected.tube);
            continue;
        }
        let mut runs = || {
            let all = moved.get_or_insert_with(|| {
                let run = |mut nudge| fitted(&nudged_recording(recording, &mut nudge), settings, &frames);
                nudges().map(run).collect()
            });
            all.iter().map(|run| with_history(&run[i].tube, !expected.tube.history_mm.is_empty())).collect()
        };
        agree(&found.tube, &expected.tube, &mut runs).unwrap();
    }
}

/// A tube with its iterations, or without.
fn with_history(tube: &DeformedTube, history: bool) -> DeformedTube {
    let mut tube = tube.clone();
    if !history {
        tube.history_mm.clear();
    }
    tube
}

#[test]
fn one_ulp_in_one_radius_is_not_the_same() {
    let tube = lumenmesh::cylinders::Tube { nodes: 3, levels: 1, height_mm: 1.0 };
    let mut cylinder = DeformedTube::primitive(tube, 1.0);
    cylinder.travel_mm = vec![0.5];
    cylinder.support = vec![3; 6];
    (cylinder.points, cylinder.rejected) = (9, 1);
    assert_same(&cylinder, &cylinder);
    let mut off = cylinder.clone();
    off.radii_mm[2] = off.radii_mm[2].next_up();
    assert!(bits(&off) != bits(&cylinder));
    let mut off = cylinder.clone();
    off.support.swap(0, 1);
    off.support[0] += 1;
    assert!(bits(&off) != bits(&cylinder));
}

/// A device that rounds in its own way, played by the twin with inputs that are off by rounding, and faults of it.
#[test]
fn what_rounding_decides_is_told_from_a_fault() {
    let settings = Settings::default().with_nodes(64).with_levels(64);
    // Two points a triangle: a decision that falls the other way moves a node by millimetres.
    let section = wall(16_000, 79);
    let expected = fitted_section(&section, &settings);
    let runs: Vec<DeformedTube> =
        nudges().map(|mut nudge| fitted_section(&nudged(&section, &mut nudge), &settings)).collect();
    let agree = |found: &DeformedTube| agree(found, &expected, &mut || runs.clone());
    // Decisions are made so that few depend on rounding: one of some devices has such a one.
    let differs = |found: &DeformedTube| {
        found.radii_mm.iter().zip(&expected.radii_mm).any(|(found, expected)| (found - expected).abs() > 1e-3)
    };
    let found = (8000..8060)
        .map(|seed| fitted_section(&nudged(&section, &mut Nudge::new(seed)), &settings))
        .find(|found| differs(found) && agree(found).is_ok())
        .unwrap();
    let share = agree(&found).unwrap();
    assert!(share > 0.0 && share < 0.01, "{share}");

    let apart = |n: usize| (found.radii_mm[n] - expected.radii_mm[n]).abs();
    let steady = (0..found.radii_mm.len()).find(|&n| apart(n) < 1e-6).unwrap();
    let turned = (0..found.radii_mm.len()).find(|&n| apart(n) > 1e-3).unwrap();
    for (node, by_mm) in [(steady, 2e-4), (steady, 200.0), (turned, 200.0)] {
        let mut off = found.clone();
        off.radii_mm[node] += by_mm;
        let message = agree(&off).unwrap_err();
        assert!(message.contains("a radius: "), "{message}");
    }
    let mut swapped = found.clone();
    swapped.radii_mm.swap(steady, turned);
    agree(&swapped).unwrap_err();
    let mut off = found.clone();
    off.support[steady] += 1;
    agree(&off).unwrap_err();
    let mut off = found.clone();
    off.residual_mm[steady] = f64::NAN;
    agree(&off).unwrap_err();
    let mut off = found.clone();
    off.residual_mm[steady] += 1e-3;
    agree(&off).unwrap_err();
    let mut off = found.clone();
    off.travel_mm[1] += 1e-3;
    agree(&off).unwrap_err();
    let mut off = found.clone();
    off.points -= 1;
    agree(&off).unwrap_err();
    let mut off = found.clone();
    off.radii_mm[steady] = f64::NAN;
    agree(&off).unwrap_err();
    let mut fewer = found;
    fewer.support.pop();
    agree(&fewer).unwrap_err();
}

/// The same for whole recordings.
#[test]
fn a_cylinder_of_another_recording_does_not_agree() {
    let recording = recording(20, 150, 107);
    let settings = Settings::default().with_nodes(24).with_levels(8);
    let expected = fitted(&recording, &settings, &[19]);
    let runs: Vec<DeformedTube> = nudges()
        .map(|mut nudge| fitted(&nudged_recording(&recording, &mut nudge), &settings, &[19])[0].tube.clone())
        .collect();
    let agree = |found: &DeformedTube| agree(found, &expected[0].tube, &mut || runs.clone());
    let found = fitted(&nudged_recording(&recording, &mut Nudge::new(8001)), &settings, &[19]);
    agree(&found[0].tube).unwrap();
    let mut fewer = recording.clone();
    fewer.frames[18].contour_mm.pop();
    agree(&fitted(&fewer, &settings, &[19])[0].tube).unwrap_err();
}
