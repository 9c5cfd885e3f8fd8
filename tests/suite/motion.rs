//! Vessels that breathe and beat: what is found of their motion, the state that is shown, gating, and what is refused.

use crate::support::vessel::{self, bits, mean_error_mm};
use lumenmesh::reconstruction::{Live, Lumen, Reconstructor};
use lumenmesh::recording::{Frame, Recording};
use lumenmesh::settings::{MotionSettings, MotionState, Settings};
use lumenmesh::simulate::{FaultKind, Insertion, Noise, Simulation, SimulationSettings};
use lumenmesh::sweep::{Cycle, Motion};

/// Median radius of the phantom `arch`, mm: what kinds of errors go with.
const RADIUS_MM: f64 = 10.0;

/// A slow pass through the arch with these kinds of errors.
fn simulated(kinds: &[&str], heart_phase: bool) -> Simulation {
    let mut settings = SimulationSettings::default()
        .with_insertion(Insertion::steady().with_speed_mm_s(2.4))
        .with_noise(Noise::default().with_seed(7))
        .with_heart_phase(heart_phase);
    settings.probe.rays = 48;
    for kind in kinds {
        FaultKind::named(kind).unwrap().apply(&mut settings, RADIUS_MM);
    }
    vessel::simulated("arch", &settings)
}

fn shown(state: MotionState) -> MotionSettings {
    MotionSettings::default().with_shown(Some(state))
}

fn window(from: f64, to: f64) -> MotionSettings {
    MotionSettings::default().with_window(Some([from, to]))
}

fn reconstructed(recording: &Recording, motion: MotionSettings) -> Lumen {
    Reconstructor::new(Settings::default().with_motion(motion)).run(recording).unwrap()
}

/// Mean distance of the nodes to the vessel's wall at rest, mm.
fn error_mm(simulation: &Simulation, motion: MotionSettings) -> (f64, Option<Motion>) {
    let lumen = reconstructed(&simulation.recording, motion);
    (mean_error_mm(&lumen.surface(), simulation.vessel.surface()), lumen.motion().cloned())
}

fn is_near(found: f64, standard_error: f64, expected: f64) -> bool {
    (found - expected).abs() <= 3.0 * standard_error
}

fn only(motion: Option<Motion>) -> Cycle {
    match motion {
        Some(Motion { cycles, .. }) if cycles.len() == 1 => cycles[0].clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_breath_is_found_and_taken_off() {
    let simulation = simulated(&["breathing"], false);
    let (plain, none) = error_mm(&simulation, MotionSettings::default());
    assert_eq!(none, None);
    let (at_rest, motion) = error_mm(&simulation, shown(MotionState::Phase(0.0)));
    // 0.375 to 0.063 mm in docs/accuracy.md.
    assert!(at_rest < 0.4 * plain, "{plain} mm to {at_rest} mm");
    let cycle = only(motion);
    assert!(!cycle.has_phases && cycle.size_change == 0.0, "{cycle:?}");
    assert!(is_near(cycle.frequency_hz, cycle.frequency_standard_error_hz, 0.25), "{cycle:?}");
    assert!(cycle.frequency_standard_error_hz < 0.005, "{cycle:?}");
    assert!(is_near(cycle.way_mm, cycle.way_standard_error_mm, RADIUS_MM / 4.0), "{cycle:?}");
    assert!(cycle.way_standard_error_mm < 0.1 * cycle.way_mm, "{cycle:?}");
    // The recording begins at one end of the way.
    assert!((cycle.farthest_mm / cycle.way_mm - 1.0).abs() < 0.1, "{cycle:?}");

    // At the other end of the breath the vessel lies elsewhere, and from the mean either end is half as far.
    let (away, _) = error_mm(&simulation, shown(MotionState::Phase(0.5)));
    let (mean, motion) = error_mm(&simulation, shown(MotionState::Mean));
    assert!(away > 1.5 * mean && mean > 2.0 * at_rest, "{away} {mean} {at_rest}");
    let from_mean = only(motion);
    assert!((from_mean.farthest_mm / cycle.way_mm - 0.5).abs() < 0.1, "{from_mean:?}");
}

#[test]
fn a_lumen_that_beats_is_found() {
    let simulation = simulated(&["pulsation"], false);
    let cycle = only(error_mm(&simulation, shown(MotionState::Mean)).1);
    assert!(is_near(cycle.frequency_hz, cycle.frequency_standard_error_hz, 1.2), "{cycle:?}");
    assert!(is_near(cycle.size_change, cycle.size_change_standard_error, 0.16), "{cycle:?}");
    assert!(cycle.size_change_standard_error < 0.02 && cycle.way_mm == 0.0, "{cycle:?}");
}

#[test]
fn a_vessel_at_rest_keeps_its_bytes() {
    let recording = simulated(&[], false).recording;
    let plain = reconstructed(&recording, MotionSettings::default());
    for state in [MotionState::Mean, MotionState::Phase(0.3)] {
        let lumen = reconstructed(&recording, shown(state));
        let motion = lumen.motion().unwrap();
        assert!(motion.cycles.is_empty() && motion.frames == recording.frames.len(), "{motion:?}");
        assert_eq!(motion.place_standard_error_mm, [0.0; 3]);
        assert!(bits(&lumen.surface()) == bits(&plain.surface()));
    }
    // A window of phases is none without a motion.
    let settings = Settings::default().with_motion(window(0.2, 0.4));
    let refused = Reconstructor::new(settings).run(&recording).unwrap_err().to_string();
    assert!(refused.contains("motion: found no motion that is significant, and no phases"), "{refused}");
    // Too short for any.
    let short = Recording { frames: recording.frames.iter().step_by(8).cloned().collect() };
    assert!(reconstructed(&short, shown(MotionState::Mean)).motion().unwrap().cycles.is_empty());
}

#[test]
fn phases_of_the_recording_take_the_place_of_a_frequency() {
    let simulation = simulated(&["heart-beat"], true);
    let (plain, _) = error_mm(&simulation, MotionSettings::default());
    let (at_rest, motion) = error_mm(&simulation, shown(MotionState::Phase(0.0)));
    let cycle = only(motion);
    assert!(at_rest < 0.4 * plain, "{plain} mm to {at_rest} mm");
    assert!(cycle.has_phases && (cycle.frequency_hz - 1.2).abs() < 0.01, "{cycle:?}");
    assert!(is_near(cycle.way_mm, cycle.way_standard_error_mm, RADIUS_MM / 10.0), "{cycle:?}");

    // Gating: three of the ten frames of a beat, in which the vessel is nearly at rest.
    let frames = simulation.recording.frames.len() as f64;
    let (gated, motion) = error_mm(&simulation, window(0.86, 0.14));
    let motion = motion.unwrap();
    assert!((motion.frames as f64 / frames - 0.3).abs() < 0.03, "{motion:?} of {frames}");
    assert!(motion.cycles.is_empty() && gated < 0.6 * plain, "{plain} mm to {gated} mm");
    // Half a beat later it is at the other end.
    let (other, _) = error_mm(&simulation, window(0.36, 0.64));
    assert!(other > 1.3 * plain, "{plain} mm to {other} mm");

    // Frames without a phase are left out; whole beats do not count.
    let mut recording = simulation.recording;
    for (k, frame) in recording.frames.iter_mut().enumerate() {
        frame.phase = frame.phase.filter(|_| k % 4 > 0).map(|phase| phase.rem_euclid(1.0) - 3.0);
    }
    let lumen = reconstructed(&recording, window(0.86, 0.14));
    assert!((lumen.motion().unwrap().frames as f64 / frames - 0.225).abs() < 0.03, "{:?}", lumen.motion());
}

#[test]
fn motion_does_not_depend_on_the_number_of_threads() {
    let recording = simulated(&["heart-beat"], false).recording;
    let of_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let lumen = pool.install(|| reconstructed(&recording, shown(MotionState::Phase(0.25))));
        (lumen.motion().cloned(), bits(&lumen.surface()))
    };
    let (one, three) = (of_threads(1), of_threads(3));
    assert_eq!(one.0, three.0);
    assert!(one.1 == three.1 && !one.0.unwrap().cycles.is_empty());
}

#[test]
fn wrong_values_are_refused() {
    for (name, value, says) in [
        ("motion.shown", "1.5", "expected mean, or a phase from 0 to 1"),
        ("motion.shown", "middle", "expected mean, or a phase from 0 to 1"),
        (
            "motion.window",
            "[0.2, 0.2]",
            "setting motion.window: found [0.2, 0.2], expected two different phases",
        ),
        ("motion.window", "[0.2, 1.2]", "two different phases from 0 to 1"),
        ("motion.windows", "[0.2, 0.3]", "no setting of that name"),
    ] {
        let mut settings = Settings::default();
        let refused = settings.set(name, value).unwrap_err().to_string();
        assert!(refused.contains(says), "{name} {value}: {refused}");
        assert_eq!(settings, Settings::default());
    }
    let mut settings = Settings::default();
    settings.set("motion.shown", "0.75").unwrap();
    assert_eq!(settings.motion.shown, Some(MotionState::Phase(0.75)));
    let refused = settings.set("motion.window", "[0.1, 0.3]").unwrap_err().to_string();
    assert!(refused.contains("none where motion.shown is set"), "{refused}");
    settings.set("motion.shown", "mean").unwrap();
    assert!(settings.to_toml().unwrap().contains("shown = \"mean\""));
    settings.set("motion.shown", "none").unwrap();
    assert!(!settings.to_toml().unwrap().contains("motion"));

    for (motion, name) in [(shown(MotionState::Mean), "motion.shown"), (window(0.1, 0.3), "motion.window")] {
        let refused = Live::new(&Settings::default().with_motion(motion)).err().unwrap().to_string();
        assert!(
            refused.starts_with(&format!("setting {name}: found ")) && refused.contains("none live"),
            "{refused}"
        );
    }
    let mut recording = simulated(&[], true).recording;
    recording.frames[3].phase = Some(f64::INFINITY);
    let refused = recording.check().unwrap_err().to_string();
    assert!(refused.contains("frame 3: phase: found inf, expected a finite number of cycles"), "{refused}");
}

#[test]
fn phases_are_written_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = simulated(&[], true).recording;
    recording.frames.truncate(5);
    recording.frames[2].phase = None;
    let phases = |recording: &Recording| recording.frames.iter().map(|f| f.phase).collect::<Vec<_>>();
    assert!(recording.frames[4].phase.unwrap() > 0.3);
    for name in ["a.mat", "folder", "a.ndjson"] {
        let path = folder.path().join(name);
        recording.write(&path).unwrap();
        assert_eq!(phases(&Recording::read(&path).unwrap()), phases(&recording), "{name}");
    }
    for frame in &recording.frames {
        assert_eq!(Frame::from_json(&frame.to_json()).unwrap().phase, frame.phase);
    }
    let wrong = "{\"pose\": null, \"contour\": [], \"phase\": \"systole\"}";
    let refused = Frame::from_json(wrong).unwrap_err().to_string();
    assert!(refused.contains("phase: \"systole\", not a number"), "{refused}");
    let poses = folder.path().join("folder").join("poses.csv");
    let text = std::fs::read_to_string(&poses).unwrap();
    std::fs::write(&poses, text.replacen(",0\n", ",systole\n", 1)).unwrap();
    let read = || Recording::read(&folder.path().join("folder"));
    let refused = read().unwrap_err().to_string();
    assert!(
        refused.contains("poses.csv") && refused.contains("phase") && refused.contains("systole"),
        "{refused}"
    );

    // Another unit is converted where it is one of angles.
    let in_unit = |unit: &str| {
        std::fs::write(&poses, text.replacen(",phase\n", &format!(",phase{unit}\n"), 1)).unwrap()
    };
    in_unit(" [deg]");
    let [expected, found] =
        [&recording, &read().unwrap()].map(|recording| recording.frames[4].phase.unwrap());
    assert!((found * 360.0 - expected).abs() < 1e-12, "{found} {expected}");
    in_unit(" [%]");
    let refused = read().unwrap_err().to_string();
    assert!(refused.contains("the unit \"%\"") && refused.contains("rad, deg, cycles"), "{refused}");
}

#[cfg(feature = "cli")]
#[test]
fn the_command_says_what_moves() {
    let folder = tempfile::tempdir().unwrap();
    simulated(&["breathing"], false).recording.write(&folder.path().join("rec.mat")).unwrap();
    let run = |more: &[&str]| {
        let arguments = ["reconstruct", "rec.mat", "-o", "mesh.vtp"];
        crate::support::lumenmesh(&[&arguments[..], more].concat(), folder.path())
    };
    let (status, said, stderr) = run(&["--motion", "0"]);
    assert_eq!(status, 0, "{stderr}");
    assert!(said.contains("motion     at 0.2") && said.contains("shown at phase 0 of its cycles"), "{said}");
    let page = ["report", "rec.mat", "-o", "page.html", "--motion", "0"];
    assert_eq!(crate::support::lumenmesh(&page, folder.path()).0, 0);
    let page = std::fs::read_to_string(folder.path().join("page.html")).unwrap();
    assert!(page.contains("Hz removed; the vessel is shown at phase 0 of its cycles"));
    let (_, said, _) = run(&["--motion", "mean", "--json"]);
    let said: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(said["settings"]["motion"]["shown"], "mean");
    assert!(said["motion"]["cycles"][0]["way_mm"].as_f64().unwrap() > 1.0, "{said}");
    let (status, said, _) = run(&["--phase-window", "0.4,0.6"]);
    assert!(status == 0 && said.contains("frames of the window of phases are used"), "{said}");
    let (_, said, _) = run(&[]);
    assert!(!said.contains("\nmotion"), "{said}");
    let (status, _, stderr) = run(&["--motion", "systole"]);
    assert!(status == 2 && stderr.contains("mean, or a phase from 0 to 1"), "{stderr}");
    assert_eq!(run(&["--motion", "0", "--phase-window", "0.4,0.6"]).0, 2);
    // A part of the breath with few frames of a place covers less, and that is said as of any recording.
    let (status, _, stderr) = run(&["--phase-window", "0.5,0.5"]);
    assert!(status == 1 && stderr.contains("setting motion.window"), "{stderr}");
}
