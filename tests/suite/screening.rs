//! Frames that a tracker lost are left out, wherever they stand, and nothing else is.

use glam::DVec3;
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::geometry::Pose;
use lumenmesh::reconstruction::Reconstructor;
use lumenmesh::recording::{Recording, Screening};
use lumenmesh::settings::{Method, Settings, UnfitFrames};
use lumenmesh::simulate::{Insertion, Phantom, Shape, Simulation, SimulationSettings};

fn simulation() -> Simulation {
    let shape = Shape::Cylinder { radius_mm: 8.0, length_mm: 80.0 };
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    Simulation::run(Phantom::from(shape).vessel().unwrap(), &settings).unwrap()
}

/// The frames that are left out.
fn left_out(recording: &Recording) -> Vec<usize> {
    Screening::of(recording).left_out.iter().map(|one| one.frame).collect()
}

fn off(recording: &Recording, frames: impl Iterator<Item = usize>, pose: impl Fn(Pose) -> Pose) -> Recording {
    let mut recording = recording.clone();
    for k in frames {
        recording.frames[k].world_from_sensor = pose(recording.frames[k].world_from_sensor);
    }
    recording
}

fn moved(by_mm: DVec3) -> impl Fn(Pose) -> Pose {
    move |pose| Pose { translation_mm: pose.translation_mm + by_mm, ..pose }
}

#[test]
fn a_lost_frame_or_a_run_of_them_is_left_out_wherever_it_stands() {
    let recording = far_from_the_origin(&simulation().recording);
    let count = recording.frames.len();
    assert!(count > 200 && left_out(&recording).is_empty());
    let lost = [
        |_| Pose::IDENTITY,
        |pose| Pose { translation_mm: DVec3::ZERO, ..pose },
        |_| Pose { translation_mm: DVec3::splat(-3.697_314e28), ..Pose::IDENTITY },
        |_| Pose { translation_mm: DVec3::splat(f64::NAN), ..Pose::IDENTITY },
    ];
    for first in [0, 1, 77, count - 21, count - 1] {
        for length in [1, 2, 20] {
            let run = first..(first + length).min(count);
            for lost in lost {
                let found = left_out(&off(&recording, run.clone(), lost));
                assert_eq!(found, run.clone().collect::<Vec<_>>(), "{length} frames from {first}");
            }
        }
        for off_mm in [15.0, 40.0, 300.0] {
            for direction in [DVec3::X, DVec3::NEG_Y, DVec3::Z] {
                let found = left_out(&off(&recording, first..first + 1, moved(direction * off_mm)));
                assert_eq!(found, [first], "{off_mm} mm along {direction}");
            }
        }
    }
    let scattered = (0..count).filter(|k| k % 37 == 5);
    let found = left_out(&off(&recording, scattered.clone(), |_| Pose::IDENTITY));
    assert_eq!(found, scattered.collect::<Vec<_>>());
}

/// Trackers stand beside the patient.
fn far_from_the_origin(recording: &Recording) -> Recording {
    off(recording, 0..recording.frames.len(), moved(DVec3::new(0.0, 250.0, 100.0)))
}

#[test]
fn a_turn_that_no_catheter_makes_is_left_out() {
    let recording = simulation().recording;
    let turned = |pose: Pose| Pose { rotation: pose.rotation * glam::DMat3::from_rotation_x(1.5), ..pose };
    assert_eq!(left_out(&off(&recording, 50..53, turned)), [50, 51, 52]);
}

#[test]
fn a_sensor_that_is_moved_elsewhere_and_stays_is_kept() {
    let recording = simulation().recording;
    let count = recording.frames.len();
    assert!(left_out(&off(&recording, count / 2..count, moved(DVec3::X * 100.0))).is_empty());
    let few = Recording { frames: recording.frames[..4].to_vec() };
    assert!(left_out(&off(&few, 2..3, moved(DVec3::X * 100.0))).is_empty());
}

#[test]
fn lost_frames_cost_no_more_than_their_echoes() {
    let simulation = simulation();
    let truth = Truth::new(simulation.vessel.surface().clone()).unwrap();
    let recording = &simulation.recording;
    let lost = off(recording, (3..recording.frames.len()).step_by(29), |_| Pose {
        translation_mm: DVec3::new(0.0, 234.0, 0.0),
        ..Pose::IDENTITY
    });
    for settings in [Settings::default(), Settings::default().with_method(Method::Cylinders)] {
        let error_mm = |recording: &Recording, settings: &Settings| {
            let lumen = Reconstructor::new(settings.clone()).run(recording).unwrap();
            let error_mm = evaluate(&lumen.surface(), &truth).unwrap().mesh_to_truth;
            (error_mm.mean_mm, error_mm.max_mm, lumen.screening().left_out.len())
        };
        let (without, _, none) = error_mm(recording, &settings);
        let (with, _, some) = error_mm(&lost, &settings);
        assert!(none == 0 && some == (recording.frames.len() - 3).div_ceil(29));
        assert!(with < 1.1 * without, "{with} mm, {without} mm without lost frames");
        // What they would have done.
        let (_, max, _) = error_mm(&lost, &settings.clone().with_unfit_frames(UnfitFrames::Keep));
        assert!(max > 10.0, "{max} mm with the lost frames");
    }
}

#[test]
fn what_is_unfit_can_be_refused_and_too_much_of_it_always_is() {
    let recording = simulation().recording;
    let lost = off(&recording, 7..9, moved(DVec3::X * 50.0));
    let strict = Settings::default().with_unfit_frames(UnfitFrames::Refuse);
    let message = Reconstructor::new(strict).run(&lost).unwrap_err().to_string();
    assert!(message.starts_with("frame 7: pose: found ") && message.contains("off the path"), "{message}");
    let nan = |pose| Pose { translation_mm: DVec3::NAN, ..pose };
    let most = off(&recording, 0..recording.frames.len() / 2, nan);
    let message = Reconstructor::new(Settings::default()).run(&most).unwrap_err().to_string();
    assert!(message.contains("frames are unfit"), "{message}");
    let keep = Settings::default().with_unfit_frames(UnfitFrames::Keep);
    let message = Reconstructor::new(keep).run(&off(&recording, 3..4, nan)).unwrap_err().to_string();
    assert!(message.starts_with("frame 3: position: found "), "{message}");
}
