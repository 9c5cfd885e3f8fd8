//! The pass `project` against its twin.

use crate::compare::{Tolerance, integers, numbers};
use crate::device::{Device, device};
use crate::nudge::{Nudge, nudges};
use crate::sections::recording;
use lumenmesh::cylinders::{FitRequest, Track};
use lumenmesh::low_level::cylinders::passes::{Gate, Section, TubeTransform, project};
use lumenmesh::recording::Recording;
use lumenmesh::settings::Settings;

/// The owner of a point that did not pass the gate.
const NONE: u32 = u32::MAX;

/// The twin's result for each slot: its cylinder and tube coordinates, or none where it does not pass.
struct Expected {
    owners: Vec<u32>,
    passed: Vec<usize>,
    coordinates: [Vec<f32>; 3],
    gated: Vec<u32>,
}

/// The twin's result; with transforms and points that are moved by some roundings, where asked.
fn twin(request: &FitRequest, nudge: Option<&mut Nudge>) -> Expected {
    let mut nudge = nudge;
    let mut moved = |x: f32, size: f64| nudge.as_mut().map_or(x, |nudge| nudge.of(x, size));
    let mut expected = Expected {
        owners: Vec::new(),
        passed: Vec::new(),
        coordinates: Default::default(),
        gated: vec![0; request.frames.len()],
    };
    for (cylinder, &frame) in request.frames.iter().enumerate() {
        let gate = Gate::<f32>::new(request.settings, request.track.cylinder(frame).unwrap().radius_mm);
        for near in request.track.near(frame, request.settings).unwrap() {
            let mut transform = TubeTransform::new(&near.cylinder_from_probe);
            for point in &request.track.echoes_mm()[near.echoes] {
                let mut one = Section::default();
                // What rounding may add to each coordinate, whose summands are as large as the distance of the echo.
                let size = point.length() + near.cylinder_from_probe.translation_mm.length();
                let origin = transform.origin;
                transform.origin = origin.map(|x| moved(x, size));
                project(std::slice::from_ref(point), &transform, &gate, &mut one);
                transform.origin = origin;
                expected.gated[cylinder] += one.gated as u32;
                if one.is_empty() {
                    expected.owners.push(NONE);
                    continue;
                }
                expected.passed.push(expected.owners.len());
                expected.owners.push(cylinder as u32);
                let [r, theta, z] = &mut expected.coordinates;
                r.push(one.r[0]);
                theta.push(one.theta[0]);
                z.push(one.z[0]);
            }
        }
    }
    expected
}

fn agrees(
    device: &Device,
    recording: &Recording,
    settings: &Settings,
    frames: &[usize],
    pairs: std::ops::Range<u32>,
) {
    let track = Track::of(recording, settings).unwrap();
    let request = FitRequest::new(&track, frames, settings);
    let [workspace] = &device.engine.prepare_request(&request).unwrap()[..] else { panic!("one batch") };
    assert!(pairs.contains(&workspace.parameters().pairs), "{} pairs", workspace.parameters().pairs);
    let none = vec![0_u32; frames.len()];
    let [section, owners, gated] = device.run(
        workspace,
        "project",
        &[("gated", bytemuck::cast_slice(&none))],
        ["section", "owners", "gated"],
    );
    let expected = twin(&request, None);
    assert_eq!(expected.owners.len(), workspace.parameters().slots as usize);
    // A point on the gate's edge may fall on either side where a device rounds in its own way.
    if device.exact {
        integers(&owners, &expected.owners).unwrap();
        assert_eq!(gated.words[..frames.len()], expected.gated);
    } else {
        let moved: Vec<Expected> = nudges().map(|mut nudge| twin(&request, Some(&mut nudge))).collect();
        on_either_side(&owners.words, &expected.owners, &moved).unwrap();
        for (cylinder, (&found, &expected)) in gated.words.iter().zip(&expected.gated).enumerate() {
            let reach = moved.iter().map(|moved| moved.gated[cylinder].abs_diff(expected)).max().unwrap();
            assert!(found.abs_diff(expected) <= 2 * reach, "{found} gated, expected {expected}");
        }
    }
    let greatest = settings.gate[1] * 13.0;
    // Four roundings in x and y, of operands as large as the farthest point of a frame near by; the root and
    // the division inside the angle add up to 2.5 each, its polynomial 8. Angles are those of r at least.
    let scale = 4.0 * greatest;
    for (component, roundings, scale) in [
        (0, 16.0, scale),
        (1, 32.0, scale / (settings.gate[0] * 12.0) + std::f64::consts::TAU),
        (2, 8.0, scale),
    ] {
        let places: Vec<usize> = expected
            .passed
            .iter()
            .filter(|&&slot| owners.words[slot] == expected.owners[slot])
            .map(|slot| component * expected.owners.len() + slot)
            .collect();
        let agreed: Vec<f32> = expected
            .passed
            .iter()
            .zip(&expected.coordinates[component])
            .filter(|(slot, _)| owners.words[**slot] == expected.owners[**slot])
            .map(|(_, x)| *x)
            .collect();
        assert!(!agreed.is_empty());
        numbers(&section.at(&places), &agreed, Tolerance::of(device.exact, roundings, scale)).unwrap();
    }
}

/// Points that are owned otherwise than the twin says are those that it owns otherwise too where rounding moves them.
fn on_either_side(found: &[u32], expected: &[u32], moved: &[Expected]) -> Result<(), String> {
    if found.len() < expected.len() {
        return Err(format!("{} points, expected {}", found.len(), expected.len()));
    }
    let is_explained = |slot: usize| moved.iter().any(|moved| moved.owners[slot] == found[slot]);
    match (0..expected.len()).find(|&slot| found[slot] != expected[slot] && !is_explained(slot)) {
        None => Ok(()),
        Some(slot) => {
            Err(format!("point {slot} belongs to {:#x}, expected {:#x}", found[slot], expected[slot]))
        }
    }
}

#[test]
fn a_point_far_from_the_gate_on_its_other_side_is_a_fault() {
    let settings = Settings::default();
    let pullback = recording(60, 100, 1);
    let track = Track::of(&pullback, &settings).unwrap();
    let request = FitRequest::new(&track, &[33, 59], &settings);
    let moved: Vec<Expected> = nudges().map(|mut nudge| twin(&request, Some(&mut nudge))).collect();
    let expected = twin(&request, None).owners;
    let other_rounding = twin(&request, Some(&mut Nudge::new(8000))).owners;
    on_either_side(&other_rounding, &expected, &moved).unwrap();
    let steady = |slot: &usize| moved.iter().all(|moved| moved.owners[*slot] == expected[*slot]);
    assert!((0..expected.len()).filter(steady).count() > expected.len() * 99 / 100);
    for slot in (0..expected.len()).filter(steady).step_by(97) {
        let mut off = expected.clone();
        off[slot] = if off[slot] == NONE { 0 } else { NONE };
        assert!(on_either_side(&off, &expected, &moved).is_err());
    }
    assert!(on_either_side(&expected[1..], &expected, &moved).is_err());
}

#[test]
fn project_is_its_twin() {
    let Some(device) = device() else { return };
    let settings = Settings::default();
    let pullback = recording(60, 100, 1);
    agrees(device, &pullback, &settings, &[5, 20, 33, 59], 40..240);
    let track = Track::of(&pullback, &settings).unwrap();
    assert!(twin(&FitRequest::new(&track, &[59], &settings), None).gated[0] > 0, "no point tries the gate");
    // One point per frame, and a number of points about the 64 invocations of a workgroup.
    for rays in [1, 2, 63, 64, 65, 257] {
        let found = recording(8, rays, u64::from(rays as u32));
        if found.frames.iter().any(|f| f.echoes_mm().count() > 0) {
            agrees(device, &found, &settings, &[7], 1..9);
        }
    }
}

#[test]
fn project_goes_past_65535_workgroups() {
    let Some(device) = device() else { return };
    // Every frame is near every later cylinder: n(n + 1)/2 pairs, two points each.
    let mut recording = recording(380, 2, 3);
    for frame in &mut recording.frames {
        frame.world_from_sensor.translation_mm *= 1e-2;
    }
    let frames: Vec<usize> = (0..380).collect();
    agrees(device, &recording, &Settings::default(), &frames, 65_536..100_000);
}
