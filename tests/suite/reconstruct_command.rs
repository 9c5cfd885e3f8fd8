//! `lumenmesh reconstruct` as a user runs it.

use crate::support::{lumenmesh, names};
use glam::{DVec2, DVec3};
use lumenmesh::geometry::Pose;
use lumenmesh::recording::CylinderModel;
use lumenmesh::recording::{Frame, Recording};
use lumenmesh::settings::{Method, Settings};
use lumenmesh::surface::Surface;
use serde_json::Value;
use std::f64::consts::TAU;
use std::path::Path;

/// By the method cylinders.
fn reconstruct(arguments: &[&str], folder: &Path) -> (i32, String, String) {
    lumenmesh(&[&["reconstruct", "--method", "cylinders"], arguments].concat(), folder)
}

/// By the default method.
fn sweep(arguments: &[&str], folder: &Path) -> (i32, String, String) {
    lumenmesh(&[&["reconstruct"], arguments].concat(), folder)
}

/// A straight vessel of radius 5 mm, 60 frames 0.5 mm apart, with its cylinders.
fn some_recording() -> Recording {
    let frame = |k: i32| {
        Frame::new(
            Pose { translation_mm: DVec3::Z * (f64::from(k) * 0.5), ..Pose::IDENTITY },
            (0..60).map(|j| DVec2::from_angle(f64::from(j) / 60.0 * TAU) * 5.0).collect(),
        )
        .with_cylinder(Some(CylinderModel::from_axis(0.0, 0.0, DVec3::Z, 4.5)))
    };
    Recording { frames: (0..60).map(frame).collect() }
}

/// A folder with that recording as `rec.mat`.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    some_recording().write(&folder.path().join("rec.mat")).unwrap();
    folder
}

/// Runs in the folder, and looks that it fails with that status and those words and leaves no file behind.
fn refused(folder: &Path, arguments: &[&str], status: i32, expected: &str) {
    let before = names(folder);
    let (found, out, said) = reconstruct(arguments, folder);
    assert_eq!((found, out.as_str()), (status, ""), "{arguments:?}: {said}");
    assert!(said.contains(expected), "{arguments:?}: {said}");
    assert_eq!(names(folder), before, "{arguments:?}");
}

#[test]
fn settings_outside_their_limits_are_refused() {
    let folder = folder();
    for (name, text) in [
        ("bad.toml", "nodes = 12\nlevel = 3\n"),
        ("word.toml", "levels = 5\nnodes = \"many\"\n"),
        ("choice.toml", "[sweep]\ncalibrate = \"maybe\"\n"),
        ("later.toml", "[motion]\nshown = \"later\"\n"),
        ("open.toml", "nodes = [3\n"),
    ] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    for (flags, expected) in [
        (&["--nodes", "2"][..], "lumenmesh: setting nodes: found 2, expected at least 3"),
        (&["--levels", "0"], "lumenmesh: setting levels: found 0, expected at least 1"),
        (&["--height", "0"], "lumenmesh: setting height_mm: found 0.0, expected 0.001 to 10000 mm"),
        (&["--height", "-1"], "lumenmesh: setting height_mm: found -1.0, expected 0.001 to 10000 mm"),
        (&["--roughness", "-1"], "lumenmesh: setting sweep.roughness: found -1.0, expected 1e-6 to 1000"),
        (&["--half-life", "-1"], "lumenmesh: setting sweep.half_life_s: found -1.0, expected 0.001 to 1e9 s"),
        (&["--gate", "1.5,0.5"], "lumenmesh: setting gate: found [1.5, 0.5], expected 0 <= low < high"),
        (&["--every", "0"], "lumenmesh: setting every: found 0, expected at least 1"),
        (
            &["--every", "61"],
            "lumenmesh: setting every: found 61, expected at most the recording's 60 frames",
        ),
        (
            &["--config", "bad.toml"],
            "lumenmesh: bad.toml: settings: found line 2: unknown field `level`, expected one of `",
        ),
        (
            &["--config", "word.toml"],
            "lumenmesh: word.toml: settings: found line 2: invalid type: string \"many\", expected u32\n",
        ),
        (
            &["--config", "choice.toml"],
            "lumenmesh: choice.toml: settings: found line 2: unknown variant `maybe`, expected one of `off`, `estimate`, \
             `apply`\n",
        ),
        (
            &["--config", "later.toml"],
            "lumenmesh: later.toml: settings: found line 2: \"later\", expected mean, or a phase from 0 to 1 in cycles\n",
        ),
        (
            &["--config", "open.toml"],
            "lumenmesh: open.toml: settings: found line 1: unclosed array, expected `]`\n",
        ),
        (&["--config", "absent.toml"], "lumenmesh: absent.toml: cannot read"),
    ] {
        refused(folder.path(), &[&["rec.mat", "-o", "mesh.vtp"], flags].concat(), 1, expected);
    }
}

#[test]
fn wrong_usage_is_status_2() {
    let folder = folder();
    for (arguments, expected) in [
        (&["rec.mat"][..], "--output"),
        (&["-o", "mesh.vtp"], "<REC>"),
        (&["rec.mat", "-o", "mesh.vtp", "--nodes", "-3"], "-3"),
        (&["rec.mat", "-o", "mesh.vtp", "--gate", "1"], "found 1 numbers, expected 2"),
        (&["rec.mat", "-o", "mesh.vtp", "--outliers", "some"], "iqr, deviation, none"),
    ] {
        refused(folder.path(), arguments, 2, expected);
    }
}

#[test]
fn an_output_that_cannot_be_written_is_refused() {
    let folder = folder();
    std::fs::create_dir(folder.path().join("taken.vtp")).unwrap();
    for (output, expected) in [
        ("mesh.xyz", "lumenmesh: mesh.xyz: unknown ending \"xyz\", expected one of .vtp, .ply, .stl, .obj"),
        ("mesh", "lumenmesh: mesh: unknown ending \"\""),
        ("absent/mesh.vtp", "lumenmesh: absent/mesh.vtp: cannot write"),
        ("taken.vtp", "lumenmesh: taken.vtp: cannot write"),
    ] {
        refused(folder.path(), &["rec.mat", "-o", output], 1, expected);
    }
    assert_eq!(names(&folder.path().join("taken.vtp")), [""; 0]);
    let cylinders = "lumenmesh: absent/all.csv: cannot write";
    refused(folder.path(), &["rec.mat", "-o", "mesh.vtp", "--cylinders", "absent/all.csv"], 1, cylinders);
}

#[test]
fn a_recording_that_cannot_be_used_is_refused() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    // The writer refuses a negative radius, so it is put into the file's bytes.
    let mut recording = some_recording();
    recording.frames[7].cylinder.as_mut().unwrap().radius_mm = 4.125;
    recording.write(&at("negative.mat")).unwrap();
    let mut bytes = std::fs::read(at("negative.mat")).unwrap();
    let place = bytes.windows(8).position(|eight| eight == 4.125_f64.to_le_bytes()).unwrap();
    bytes[place..place + 8].copy_from_slice(&(-4.125_f64).to_le_bytes());
    std::fs::write(at("negative.mat"), &bytes).unwrap();
    std::fs::write(at("cut.mat"), &bytes[..bytes.len() / 2]).unwrap();

    let write = |name: &str, change: &dyn Fn(usize, &mut Frame)| {
        let mut recording = some_recording();
        recording.frames.iter_mut().enumerate().for_each(|(k, frame)| change(k, frame));
        recording.write(&at(name)).unwrap();
    };
    write("empty.mat", &|_, frame| frame.contour_mm.clear());
    write("nothing.mat", &|_, frame| {
        frame.contour_mm.fill(DVec2::NAN);
        frame.cylinder = None;
    });
    write("narrow.mat", &|k, frame| {
        if k == 29 {
            frame.cylinder = Some(CylinderModel::from_axis(0.0, 0.0, DVec3::Z, 1.0));
        }
    });
    for (name, expected) in [
        ("absent.mat", "lumenmesh: absent.mat: cannot read"),
        ("cut.mat", "lumenmesh: cut.mat: "),
        (
            "negative.mat",
            "lumenmesh: negative.mat: frame 7: cylinder radius: found -4.125 mm, expected more than 0 and at most 10000 mm",
        ),
        ("empty.mat", "lumenmesh: empty.mat: "),
        ("nothing.mat", "SUSPICIOUS: wall points in 60 of 60 frames, expected at least 3"),
        (
            "narrow.mat",
            "lumenmesh: narrow.mat: frame 29: section: found 0 points (660 outside the radial gate), expected at \
             least 1 within 10 mm of height and a radius of 0.50 to 1.50 mm",
        ),
    ] {
        let flags = ["-o", "mesh.vtp", "--cylinders", "all.csv", "--strict"];
        refused(folder.path(), &[&[name][..], &flags].concat(), 1, expected);
    }
    // Without --strict, one unfit frame is left out and named.
    let (status, said, errors) = reconstruct(&["negative.mat", "-o", "mesh.vtp"], folder.path());
    assert_eq!((status, errors.as_str()), (0, ""));
    assert!(
        said.contains("left out   1 of 60 frames") && said.contains("frame 7: cylinder radius"),
        "{said}"
    );
    let (status, said, _) = reconstruct(&["negative.mat", "-o", "mesh.vtp", "--json"], folder.path());
    let report: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!((status, &report["screening"]["left_out"][0]["frame"]), (0, &serde_json::json!(7)), "{said}");
}

#[test]
fn the_report_is_there_for_people_and_for_machines() {
    let folder = folder();
    let (status, said, errors) = reconstruct(&["rec.mat", "-o", "mesh.ply"], folder.path());
    assert_eq!((status, errors.as_str()), (0, ""));
    for expected in
        ["frames     60, 6 cylinders fitted", "echoes     3600 recorded, 0 missing", "mesh       mesh.ply"]
    {
        assert!(said.contains(expected), "{said}");
    }
    let (status, said, errors) = reconstruct(&["rec.mat", "-o", "mesh.vtp", "--json"], folder.path());
    assert_eq!((status, errors.as_str()), (0, ""));
    let json: Value = serde_json::from_str(&said).unwrap();
    let surface = Surface::read(&folder.path().join("mesh.vtp")).unwrap();
    assert_eq!((&json["recording"], &json["mesh"]), (&Value::from("rec.mat"), &Value::from("mesh.vtp")));
    let count = |pointer: &str| json.pointer(pointer).and_then(Value::as_u64).unwrap();
    assert_eq!((count("/frames"), count("/cylinders"), count("/estimated_cylinders")), (60, 6, 0));
    assert_eq!(count("/nodes"), surface.nodes_mm.len() as u64);
    assert_eq!(count("/triangles"), surface.triangles.len() as u64);
    assert_eq!(count("/rings") * 12, count("/nodes"));
    assert_eq!((count("/points/recorded"), count("/points/missing")), (3600, 0));
    // The first cylinder sees 10 frames, the others the 11 behind them within 5 mm.
    assert_eq!(count("/points/used") + count("/points/rejected"), 60 * (10 + 5 * 11));
    assert_eq!(count("/points/gated"), 0);
    assert!(count("/threads") >= 1 && json["engine"]["name"].is_string());
    assert_eq!(json["mean_travel_mm"].as_array().unwrap().len(), 3);
    assert!(["track", "fit", "merge"].iter().all(|stage| json["seconds"][stage].as_f64().unwrap() >= 0.0));
    let settings: Settings = serde_json::from_value(json["settings"].clone()).unwrap();
    assert_eq!(settings, Settings::default().with_method(Method::Cylinders));
    assert_eq!(names(folder.path()), ["mesh.ply", "mesh.vtp", "rec.mat"]);
}

#[test]
fn flags_override_the_settings_file() {
    let folder = folder();
    std::fs::write(folder.path().join("s.toml"), "nodes = 24\nlevels = 2\nstatistic = \"median\"\n").unwrap();
    let arguments = ["rec.mat", "-o", "mesh.obj", "--config", "s.toml", "--levels", "4", "--json"];
    let (status, said, _) = reconstruct(&arguments, folder.path());
    assert_eq!(status, 0);
    let json: Value = serde_json::from_str(&said).unwrap();
    let settings = &json["settings"];
    assert_eq!((&settings["nodes"], &settings["levels"]), (&Value::from(24), &Value::from(4)));
    assert_eq!(
        (&settings["statistic"], &settings["outliers"]),
        (&Value::from("median"), &Value::from("iqr"))
    );
    assert_eq!(json["nodes"].as_u64().unwrap() % 24, 0);
}

#[test]
fn the_cylinders_are_written_iteration_by_iteration() {
    let folder = folder();
    let arguments =
        ["rec.mat", "-o", "mesh.stl", "--cylinders", "all.csv", "--iterations", "2", "--every", "20"];
    let (status, said, _) = reconstruct(&arguments, folder.path());
    assert_eq!(status, 0);
    assert!(said.contains("cylinders  all.csv"), "{said}");
    let text = std::fs::read_to_string(folder.path().join("all.csv")).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("frame,iteration,ring,node,radius_mm"));
    let lines: Vec<&str> = lines.collect();
    assert_eq!(lines.len(), 3 * 3 * 6 * 12);
    assert_eq!(lines[0], "19,0,0,0,4.500000000000");
    assert!(lines[3 * 72 - 1].starts_with("19,2,5,11,") && lines[3 * 72].starts_with("39,0,0,0,"));
}

#[test]
fn a_swept_vessel_is_written_with_its_support() {
    let folder = folder();
    let arguments = ["rec.mat", "-o", "vessel.vtp", "--json"];
    let (status, out, said) = sweep(&arguments, folder.path());
    assert_eq!(status, 0, "{said}");
    let report: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(report["echoes"], 3600);
    assert_eq!(report["settings"]["method"], "sweep");
    let cut = Surface::read(&folder.path().join("vessel.vtp")).unwrap();
    for name in ["support", "residual_mm", "standard_error_mm", "frame", "supported"] {
        assert!(cut.array(name).is_some(), "{name}");
    }
    assert!(cut.nodes_mm.iter().all(|p| (p.x.hypot(p.y) - 5.0).abs() < 1e-3));

    let whole = ["rec.mat", "-o", "whole.ply", "--method", "sweep", "--keep-unsupported"];
    let (status, out, said) = sweep(&whole, folder.path());
    assert_eq!(status, 0, "{said}");
    assert!(out.contains("mesh       whole.ply"), "{out}");
    let whole = Surface::read(&folder.path().join("whole.ply")).unwrap();
    assert_eq!(whole.nodes_mm.len() as u64, report["nodes"].as_u64().unwrap());
    assert!(whole.nodes_mm.len() > cut.nodes_mm.len());

    assert!(out.contains("frames     60\n"), "{out}");
}

#[test]
fn flags_that_the_method_does_not_look_at_are_refused() {
    let folder = folder();
    let before = names(folder.path());
    for (method, flags, expected) in [
        ("sweep", &["--nodes", "24"][..], "setting nodes: found a flag for the method sweep"),
        ("sweep", &["--every", "5"], "setting every: found a flag for the method sweep"),
        ("sweep", &["--merge", "blend"], "setting merge: found a flag for the method sweep"),
        ("sweep", &["--cylinders", "all.csv"], "setting method: found sweep, expected cylinders"),
        ("cylinders", &["--sweep-nodes", "24"], "setting sweep.nodes: found a flag for the method cylinders"),
        ("cylinders", &["--keep-unsupported"], "expected --method sweep with it"),
    ] {
        let arguments = [&["rec.mat", "-o", "no.vtp", "--method", method][..], flags].concat();
        let (status, out, said) = sweep(&arguments, folder.path());
        assert_eq!((status, out.as_str()), (1, ""), "{arguments:?}: {said}");
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
    assert_eq!(names(folder.path()), before);
}
