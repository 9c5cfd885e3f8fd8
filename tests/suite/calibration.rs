//! Self-calibration: what of a wrong calibration a recording tells, and what it does not.

use crate::support::vessel;
use lumenmesh::reconstruction::{Lumen, Reconstructor};
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Calibrate, Settings, SweepSettings};
use lumenmesh::simulate::{
    CalibrationFaults, Faults, Insertion, Noise, Probe, Simulation, SimulationSettings,
};
use lumenmesh::sweep::{CalibrationParameter, Mirror, SelfCalibration};
use std::ops::ControlFlow;

fn simulated(shape: &str, insertion: Insertion, noise: Noise, calibration: CalibrationFaults) -> Simulation {
    let settings = SimulationSettings::default()
        .with_insertion(insertion)
        .with_probe(Probe::default().with_rays(48))
        .with_noise(noise)
        .with_faults(Faults::default().with_calibration(calibration));
    vessel::simulated(shape, &settings)
}

/// A catheter whose tip is bent by 30° and turned every 20 mm, in a stenosis; at half the frame rate, where no estimate has to
/// be precise.
fn few(calibration: CalibrationFaults) -> Recording {
    simulated("stenosis", Insertion::default().with_frame_rate_hz(6.0), noise(3), calibration).recording
}

fn noise(seed: u64) -> Noise {
    Noise::default().with_seed(seed)
}

fn estimate(recording: &Recording) -> SelfCalibration {
    SelfCalibration::of(recording, &Settings::default(), &|_, _, _| ControlFlow::Continue(())).unwrap()
}

fn reconstructed(recording: &Recording, calibrate: Calibrate) -> Lumen {
    let settings = Settings::default().with_sweep(SweepSettings::default().with_calibrate(calibrate));
    Reconstructor::new(settings).run(recording).unwrap()
}

fn parameter(found: &SelfCalibration, name: &str) -> CalibrationParameter {
    *found.parameters.iter().find(|parameter| parameter.name == name).unwrap()
}

/// Looks that all of a recording's estimates that are told lie near what the calibration lacks.
fn holds(found: &SelfCalibration, lacks: [f64; 8]) {
    assert!(found.converged, "{found:?}");
    for (parameter, truth) in found.parameters.iter().zip(lacks) {
        let off = (parameter.estimate - truth).abs() / parameter.standard_error;
        assert!(!parameter.told || off < 3.5, "{parameter:?}: {off} standard errors off");
    }
}

#[test]
fn a_wrong_offset_is_found_and_corrected() {
    let calibration = CalibrationFaults::default().with_offset_mm([2.0, 0.0, 0.0]);
    let simulation = simulated("stenosis", Insertion::default(), noise(3), calibration);
    let wall = simulation.vessel.surface();
    let error_mm = |lumen: &Lumen| vessel::mean_error_mm(&lumen.surface(), wall);
    let plain = reconstructed(&simulation.recording, Calibrate::Off);
    let estimated = reconstructed(&simulation.recording, Calibrate::Estimate);
    let applied = reconstructed(&simulation.recording, Calibrate::Apply);
    let found = applied.calibration().unwrap();
    holds(found, [-2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert!(parameter(found, "offset x").told && found.mirror == Some(Mirror::No), "{found:?}");
    let (before, after) = (error_mm(&plain), error_mm(&applied));
    assert!(after < 0.5 * before, "{before} mm to {after} mm");
    // The settings of the lumen have the calibration that it was reconstructed with.
    let x_mm = applied.settings().calibration.position_mm[0];
    assert!((x_mm - parameter(found, "offset x").correction).abs() < 1e-9, "{x_mm}");
    // An estimate alone changes nothing.
    assert_eq!(estimated.calibration(), Some(found));
    assert_eq!(estimated.settings().calibration, plain.settings().calibration);
    assert_eq!(estimated.surface().nodes_mm, plain.surface().nodes_mm);
    assert_eq!(plain.calibration(), None);
}

#[test]
fn a_right_calibration_stays() {
    let recording = few(CalibrationFaults::default());
    let plain = reconstructed(&recording, Calibrate::Off);
    let asked = reconstructed(&recording, Calibrate::Apply);
    let found = asked.calibration().unwrap();
    holds(found, [0.0; 8]);
    assert!(found.parameters.iter().all(|parameter| parameter.correction == 0.0), "{found:?}");
    assert_eq!(asked.surface().nodes_mm, plain.surface().nodes_mm);
    assert_eq!(asked.settings().calibration, plain.settings().calibration);
}

#[test]
fn a_single_straight_pass_tells_nothing() {
    let calibration = CalibrationFaults::default().with_offset_mm([2.0, 0.0, 0.0]);
    for shape in ["stenosis", "arch"] {
        let steady = Insertion::steady().with_speed_mm_s(2.4);
        let found = estimate(&simulated(shape, steady, noise(3), calibration.clone()).recording);
        assert!(found.parameters.iter().all(|parameter| !parameter.told), "{shape}: {found:?}");
        assert!(found.parameters.iter().all(|parameter| parameter.correction == 0.0), "{shape}: {found:?}");
        assert_eq!(found.mirror, None);
    }
}

#[test]
fn a_mirrored_image_is_found() {
    let right = few(CalibrationFaults::default());
    let mut mirrored = right.clone();
    mirrored.frames.iter_mut().flat_map(|frame| &mut frame.contour_mm).for_each(|p| p.y = -p.y);
    let found = estimate(&mirrored);
    assert_eq!(found.mirror, Some(Mirror::Y));
    let (back, settings) = found.corrected(&mirrored, &Settings::default());
    // The plane turned over about x shows y for -y.
    let (probe, contour) = (settings.calibration.sensor_from_probe(), &back.frames[9].contour_mm);
    for (p, expected) in contour.iter().zip(&right.frames[9].contour_mm) {
        let off = probe.transform_point(p.extend(0.0)).distance(expected.extend(0.0));
        assert!(p.is_nan() || off < 0.5, "{off} mm");
    }
    assert_eq!(estimate(&right).mirror, Some(Mirror::No));
}

#[test]
fn the_number_of_threads_changes_no_estimate() {
    let recording = few(CalibrationFaults::default().with_sound_speed(1.03));
    let found = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| estimate(&recording))
    };
    assert_eq!(found(1), found(3));
}

#[test]
fn frames_without_times_tell_no_offset_in_time() {
    let mut recording = few(CalibrationFaults::default());
    recording.frames.iter_mut().for_each(|frame| frame.time_s = None);
    let time = parameter(&estimate(&recording), "time");
    assert!(!time.told && time.estimate == 0.0 && time.correction == 0.0, "{time:?}");
}

#[cfg(feature = "cli")]
#[test]
fn the_command_says_what_it_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let recording = path("straight.mat");
    let steady = Insertion::steady().with_speed_mm_s(2.4);
    let straight = simulated("cylinder", steady, noise(3), CalibrationFaults::default());
    straight.recording.write(recording.as_ref()).unwrap();
    let mesh = path("mesh.vtp");
    let run = |more: &[&str]| {
        crate::support::lumenmesh(&[&["reconstruct", &recording, "-o", &mesh], more].concat(), folder.path())
    };
    let (status, said, stderr) = run(&["--calibrate"]);
    assert_eq!(status, 0, "{stderr}");
    assert!(said.contains("offset x: cannot be told from this recording"), "{said}");
    let (_, said, _) = run(&["--calibrate", "apply", "--json"]);
    let said: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(said["settings"]["sweep"]["calibrate"], "apply");
    assert_eq!(said["calibration"]["parameters"][7]["name"], "time");
    assert_eq!(said["calibration"]["parameters"][0]["told"], false);
    let (_, said, _) = run(&["--json"]);
    let said: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert!(said.get("calibration").is_none(), "{said}");
    let (status, _, stderr) = run(&["--calibrate", "twice"]);
    assert!(status == 2 && stderr.contains("invalid value 'twice'") && stderr.contains("apply"), "{stderr}");
    let (status, _, stderr) = run(&["--calibrate", "--method", "cylinders"]);
    assert!(status == 1 && stderr.contains("sweep.calibrate"), "{stderr}");
}
