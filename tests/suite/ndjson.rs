//! Frames as JSON, one per line: read back equal, and told apart from what is no frame.

use crate::support::{lumenmesh, shared};
use glam::{DQuat, DVec2, DVec3};
use lumenmesh::cylinders::estimate::{CylinderEstimator, LocalEstimate};
use lumenmesh::geometry::Pose;
use lumenmesh::recording::{Frame, FrameLines, Recording};
use lumenmesh::simulate::{Insertion, SimulationSettings};

/// A frame with all that one may have.
fn frame() -> Frame {
    let turn = DQuat::from_rotation_z(0.3) * DQuat::from_rotation_x(-1.1);
    let pose = Pose::from_quaternion(DVec3::new(1.0 / 3.0, -2e-7, 1e5), turn);
    let mut frame =
        Frame::new(pose, vec![DVec2::new(0.1, -3.0), DVec2::NAN, DVec2::new(2.5, f64::NAN), DVec2::Y])
            .with_time_s(Some(1.25))
            .with_number(Some(812));
    frame.cylinder =
        LocalEstimate::default().push(&Frame::new(pose, vec![DVec2::X, DVec2::Y, -DVec2::X, -DVec2::Y]));
    frame
}

/// Bits, so that NaN equals itself.
fn bits(frame: &Frame) -> String {
    format!("{frame:?}")
}

#[test]
fn a_frame_comes_back_equal() {
    let lost = Frame::new(Pose::LOST, Vec::new());
    for frame in [frame(), lost, Frame::new(Pose::IDENTITY, vec![DVec2::NAN; 3])] {
        let line = frame.to_json();
        assert!(!line.contains('\n'));
        let back = Frame::from_json(&line).unwrap();
        assert_eq!(bits(&back), bits(&frame), "{line}");
    }
    assert!(frame().cylinder.is_some());
    let other = frame().with_time_s(Some(1.250_000_000_1));
    assert_ne!(
        bits(&Frame::from_json(&other.to_json()).unwrap()),
        bits(&frame()),
        "the comparison sees differences"
    );
}

#[test]
fn poses_and_missing_echoes_are_read_as_other_programs_write_them() {
    let flat = "1,0,0,10, 0,1,0,20, 0,0,1,30, 0,0,0,1";
    let nested = "[1,0,0,10],[0,1,0,20],[0,0,1,30],[0,0,0,1]";
    let of = |pose: &str, contour: &str| {
        Frame::from_json(&format!("\u{feff}{{\"pose\": [{pose}], \"contour\": {contour}}}\r")).unwrap()
    };
    let [a, b] = [of(flat, "[[1,2],null]"), of(nested, "[[1,2],[NaN,NaN]]")];
    assert_eq!(bits(&a), bits(&b));
    assert_eq!((a.time_s, a.world_from_sensor.translation_mm), (None, DVec3::new(10.0, 20.0, 30.0)));
    assert!(a.contour_mm[1].is_nan() && a.contour_mm.len() == 2);
    assert!(of(flat, "null").contour_mm.is_empty());
    let lost = of(&flat.replace("10", "NaN"), "[]");
    assert!(lost.world_from_sensor.translation_mm.is_nan());
}

#[test]
fn all_that_is_wrong_with_a_line_is_named() {
    let says = |line: &str, parts: &[&str]| {
        let message = Frame::from_json(line).unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "{line}: {message}");
        }
        assert!(message.len() < 600 && message.contains("expected {\"time_s\": s, "), "{message}");
    };
    says("", &["no JSON"]);
    says("[1, 2]", &["an array"]);
    says("{\"pose\": null", &["no JSON", "EOF"]);
    says("{}", &["pose: absent", "contour: absent"]);
    says(
        "{\"when_s\": 1, \"pose\": [1,2,3], \"contour\": [[1,2],[3]], \"time_s\": \"1\", \"frame\": -1}",
        &[
            "the unknown member \"when_s\"",
            "pose: 3 numbers, not 16",
            "contour: an array at point 1",
            "time_s: \"1\", not a number",
            "frame: -1, not a whole number",
        ],
    );
    says("{\"pose\": null, \"contour\": [], \"cylinder\": {\"px_mm\": 1}}", &["cylinder: py_mm: absent"]);
    let by_columns = "{\"pose\": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,6,7,1], \"contour\": []}";
    says(by_columns, &["a last row of [5.0, 6.0, 7.0, 1.0]", "column by column"]);
    let many: Vec<String> = (0..10_000).map(|k| format!("\"x{k}\": 0")).collect();
    says(&format!("{{{}}}", many.join(",")), &["10000 unknown members"]);
    says(&"[".repeat(100_000), &["no JSON: recursion limit"]);
}

#[test]
fn a_bad_line_is_counted_and_the_next_one_is_read() {
    let good = frame().to_json();
    let long = format!("{{\"pose\": null, \"contour\": [{}]}}", "[1,2],".repeat(3_000_000));
    let text =
        [good.as_bytes(), b"\n\n{\"pose\"\n", long.as_bytes(), b"\n\xff\xfe\n", good.as_bytes()].concat();
    let lines: Vec<_> = FrameLines::new(&*text).map(|line| line.unwrap()).collect();
    let bad: Vec<usize> = lines.iter().filter_map(|line| line.as_ref().err()).map(|bad| bad.line).collect();
    assert_eq!((lines.len(), bad), (5, vec![3, 4, 5]));
    let says = |k: usize| lines[k].as_ref().unwrap_err().to_string();
    assert!(says(2).starts_with("line 4: found more than 16777216 bytes, expected"), "{}", says(2));
    assert!(says(3).contains("no UTF-8"));
    assert_eq!(bits(lines[4].as_ref().unwrap()), bits(&frame()));
}

#[test]
fn a_recording_is_a_file_of_frames_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec.ndjson");
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    let mut recordings = vec![crate::support::vessel::simulated("cylinder", &settings).recording];
    recordings.extend(shared("recordings/adult_aorta_noisy.mat").map(|path| Recording::read(&path).unwrap()));
    for mut recording in recordings {
        recording.write(&path).unwrap();
        let same = |a: &Recording, b: &Recording| {
            a.frames.len() == b.frames.len()
                && a.frames.iter().zip(&b.frames).all(|(a, b)| bits(a) == bits(b))
        };
        let back = Recording::read(&path).unwrap();
        assert!(same(&back, &recording));
        recording.frames[3].contour_mm[2].x += 1e-12;
        assert!(!same(&back, &recording), "the comparison sees differences");
    }
    std::fs::write(&path, format!("{}\n{{\"pose\": 3}}\n", frame().to_json())).unwrap();
    let (status, out, said) = lumenmesh(&["info", "rec.ndjson"], folder.path());
    assert_eq!((status, out.as_str()), (1, ""));
    assert!(
        said.contains(
            "rec.ndjson: line 2: found pose: 3, not 16 numbers, row by row, or null; contour: absent"
        ),
        "{said}"
    );
}

/// What a tracker lost stays in the file.
#[test]
fn a_frame_without_a_pose_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let recording = Recording { frames: vec![frame(), Frame::new(Pose::LOST, vec![DVec2::X])] };
    recording.write(&folder.path().join("rec.mat")).unwrap_err();
    recording.write(&folder.path().join("rec.jsonl")).unwrap();
    let back = Recording::read_unchecked(&folder.path().join("rec.jsonl")).unwrap();
    assert_eq!(back.frames[1].defects()[0].field, "pose");
    assert_eq!(bits(&back.frames[0]), bits(&recording.frames[0]));
}
