//! Frames of arbitrary numbers, given to whole reconstructions and one by one.

use crate::mutate::inputs;
use glam::{DMat3, DQuat, DVec2, DVec3};
use lumenmesh::geometry::Pose;
use lumenmesh::reconstruction::{Live, Reconstructor};
use lumenmesh::recording::{Frame, Recording};
use lumenmesh::settings::{Backend, Method, Settings, UnfitFrames};
use lumenmesh::surface::Surface;
use rand::seq::IndexedRandom;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::panic::{AssertUnwindSafe, catch_unwind};

const FRAMES: usize = 40;

/// Frames along a slightly bent tube, with what trackers, segmentations and programs do to some of them.
fn recording(number: u64) -> (Recording, ChaCha8Rng) {
    let mut random = ChaCha8Rng::seed_from_u64(number);
    let rays = random.random_range(3..24);
    let step = *[0.0, 1e-9, 0.3, 1.0, 30.0].choose(&mut random).unwrap();
    let frame = |k: usize| {
        let along = step * k as f64;
        let rotation = DMat3::from_quat(DQuat::from_rotation_y(0.01 * along));
        let contour = (0..rays)
            .map(|j| DVec2::from_angle(f64::from(j) / f64::from(rays) * std::f64::consts::TAU) * 4.0)
            .collect();
        Frame::new(
            Pose { rotation, translation_mm: DVec3::new(0.005 * along * along, 100.0, along) },
            contour,
        )
        .with_time_s(Some(k as f64 / 12.0))
    };
    let mut recording = Recording { frames: (0..FRAMES).map(frame).collect() };
    for _ in 0..random.random_range(0..12) {
        let k = random.random_range(0..FRAMES);
        let run = random.random_range(1..8).min(FRAMES - k);
        let kind = random.random_range(0..12);
        let value = number_of(&mut random);
        let other = recording.frames[random.random_range(0..FRAMES)].clone();
        for frame in &mut recording.frames[k..k + run] {
            spoil(frame, kind, value, &other, &mut random);
        }
    }
    (recording, random)
}

/// A number that programs write, or any other.
fn number_of(random: &mut impl Rng) -> f64 {
    const ODD: [f64; 13] = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        9999.0,
        1e6,
        -3.697_314e28,
        1e300,
        5e-324,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        1e-9,
    ];
    match random.random_range(0..3) {
        0 => *ODD.choose(random).unwrap(),
        1 => random.random_range(-20.0..20.0),
        _ => f64::from_bits(random.random()),
    }
}

fn spoil(frame: &mut Frame, kind: u32, value: f64, other: &Frame, random: &mut impl Rng) {
    match kind {
        0 => frame.world_from_sensor = Pose::IDENTITY,
        1 => frame.world_from_sensor.translation_mm = DVec3::splat(value),
        2 => frame.world_from_sensor.translation_mm[random.random_range(0..3)] += value,
        3 => frame.world_from_sensor.rotation = DMat3::from_diagonal(DVec3::splat(value)),
        4 => frame.world_from_sensor = other.world_from_sensor,
        5 => frame.contour_mm = other.contour_mm.clone(),
        6 => frame.contour_mm.iter_mut().for_each(|p| *p *= value),
        7 => frame.contour_mm.iter_mut().for_each(|p| *p += DVec2::new(value, 1.0)),
        8 => frame.contour_mm.iter_mut().step_by(3).for_each(|p| *p = DVec2::splat(value)),
        9 => frame.contour_mm.truncate(random.random_range(0..4)),
        10 => frame.time_s = Some(value),
        _ => {
            let count = frame.contour_mm.len().max(1);
            frame.contour_mm = (0..count).map(|_| DVec2::new(number_of(random), number_of(random))).collect();
        }
    }
}

fn settings(number: u64) -> Settings {
    let method = if number.is_multiple_of(2) { Method::Sweep } else { Method::Cylinders };
    let unfit = [UnfitFrames::LeaveOut, UnfitFrames::LeaveOut, UnfitFrames::Keep][(number / 2 % 3) as usize];
    Settings::default().with_method(method).with_backend(Backend::Cpu).with_unfit_frames(unfit).with_every(5)
}

/// Fails where the surface is not sound, or a node lies farther from every echo than contours are wide. The latter is not
/// asked where unfit frames are used at the user's wish: a sensor that is taken to be everywhere shows a wall anywhere.
fn check_reach(surface: &Surface, recording: &Recording, settings: &Settings) {
    surface.check().unwrap();
    if settings.unfit_frames == UnfitFrames::Keep {
        return;
    }
    let mut reach_mm = 0.0_f64;
    let mut echoes: Vec<DVec3> = Vec::new();
    for frame in recording.frames.iter().filter(|frame| frame.world_from_sensor.is_finite()) {
        for p in frame.echoes_mm().filter(|p| p.is_finite()) {
            reach_mm = reach_mm.max(2.0 * p.length());
            echoes.push(frame.world_from_sensor.transform_point(p.extend(0.0)));
        }
    }
    // Published cylinders reach half their height beyond a frame.
    let reach_mm = 2.0 * reach_mm + 10.0;
    for node in &surface.nodes_mm {
        let nearest_mm = echoes.iter().map(|p| p.distance(*node)).fold(f64::INFINITY, f64::min);
        assert!(
            nearest_mm <= reach_mm,
            "a node {nearest_mm} mm from the nearest echo, contours reach {reach_mm} mm"
        );
    }
}

fn in_each(name: &str, of: impl Fn(u64) -> bool) {
    let recordings = (inputs() / FRAMES as u64).max(50);
    let good = (0..recordings)
        .filter(|&number| {
            catch_unwind(AssertUnwindSafe(|| of(number)))
                .unwrap_or_else(|_| panic!("{name}: recording {number}"))
        })
        .count() as u64;
    assert!(0 < good && good < recordings, "{name}: {good} of {recordings} gave a mesh");
}

#[test]
fn whole_recordings() {
    in_each("whole", |number| {
        let (recording, _) = recording(number);
        let settings = settings(number);
        let Ok(lumen) = Reconstructor::new(settings.clone()).run(&recording) else { return false };
        let surface = lumen.surface();
        assert!(!surface.triangles.is_empty(), "success without a result");
        check_reach(&surface, &recording, &settings);
        true
    });
}

#[test]
fn frames_one_by_one() {
    in_each("live", |number| {
        let (recording, _) = recording(number);
        let settings = settings(number);
        let mut live = Live::new(&settings).unwrap();
        let mut shown = 0;
        for frame in &recording.frames {
            if let Ok(change) = live.push(frame) {
                assert_eq!(change.rings, live.rings());
                for rings in change.changed {
                    assert!(rings.end <= change.rings, "{rings:?} of {}", change.rings);
                    shown += live.part(rings).nodes_mm.len();
                }
            }
        }
        let _ = live.flush();
        check_reach(&live.surface(), &recording, &settings);
        shown > 0
    });
}

/// A number that no image shows made the live wall NaN.
#[test]
fn a_contour_beyond_all_sizes_is_no_contour() {
    let (mut recording, _) = recording(0);
    let settings = Settings::default().with_unfit_frames(UnfitFrames::Keep);
    let mut live = Live::new(&settings).unwrap();
    recording.frames[20].contour_mm = vec![DVec2::new(1e6, -3.3e306); 9];
    let message = recording.frames.iter().find_map(|frame| live.push(frame).err()).unwrap().to_string();
    assert!(message.contains("contour: found ") && message.contains("at most 1e6"), "{message}");
    live.surface().check().unwrap();
}
