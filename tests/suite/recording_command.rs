//! `lumenmesh info` and `lumenmesh import` as a user runs them.

use crate::support::{lumenmesh, names, shared};
use glam::{DMat3, DQuat, DVec2, DVec3};
use lumenmesh::cylinders::estimate::{CylinderEstimator, LocalEstimate};
use lumenmesh::geometry::Pose;
use lumenmesh::recording::{Frame, Pullback, PullbackOptions, PullbackPath, Recording, Summary};
use serde_json::Value;
use std::f64::consts::TAU;

/// A circle of radius 5 mm seen from its middle, 0.5 mm and 0.1 s further on in each of 60 frames.
fn some_recording() -> Recording {
    let ray = |j: i32| DVec2::from_angle(f64::from(j) / 20.0 * TAU) * 5.0;
    let frame = |k: i32| {
        Frame::new(
            Pose { translation_mm: DVec3::Z * (f64::from(k) * 0.5), ..Pose::IDENTITY },
            (0..20).map(ray).collect(),
        )
        .with_time_s(Some(f64::from(k) * 0.1))
    };
    Recording { frames: (0..60).map(frame).collect() }
}

fn kinds(summary: &Summary) -> Vec<(&str, Vec<usize>)> {
    let frames = |example: &lumenmesh::recording::Example| {
        example.frame.into_iter().flat_map(|first| (first..).take(example.frames)).collect::<Vec<_>>()
    };
    summary.defects.iter().map(|d| (d.field, d.examples.iter().flat_map(frames).collect())).collect()
}

#[test]
fn a_summary_counts_what_is_there() {
    let mut recording = some_recording();
    recording.frames[4].contour_mm[3] = DVec2::NAN;
    let mut estimate = LocalEstimate::default();
    recording.frames.iter_mut().for_each(|f| f.cylinder = estimate.push(f));
    let summary = Summary::of(&recording);
    assert_eq!((summary.frames, summary.points, summary.missing_echoes), (60, 1199, 1));
    assert!((summary.path_length_mm - 29.5).abs() < 1e-9);
    assert!((summary.frame_rate_hz.unwrap() - 10.0).abs() < 1e-9);
    assert!((summary.contour_radius_mm.unwrap().median - 5.0).abs() < 1e-9);
    assert_eq!(summary.cylinders, 60);
    assert!((summary.cylinder_radius_mm.unwrap().median - 5.0).abs() < 1e-3);
    assert_eq!(summary.defects, []);
}

#[test]
fn a_summary_names_every_frame_with_a_defect() {
    let mut recording = some_recording();
    let pose = |k: usize, recording: &mut Recording, change: fn(&mut Pose)| {
        change(&mut recording.frames[k].world_from_sensor);
    };
    pose(3, &mut recording, |p| p.rotation.x_axis.x = -1.0);
    pose(5, &mut recording, |p| p.rotation.x_axis.y = 0.5);
    pose(7, &mut recording, |p| p.rotation *= 0.81);
    pose(9, &mut recording, |p| p.translation_mm.y = f64::NAN);
    pose(20, &mut recording, |p| p.translation_mm.x = 7.0);
    pose(30, &mut recording, |p| p.rotation = DMat3::from_rotation_z(0.5));
    recording.frames[40].time_s = Some(1.0);
    recording.frames[50].contour_mm[2].x = f64::NAN;
    let summary = Summary::of(&recording);
    let said = summary.to_string();
    let found = kinds(&summary);
    for (field, frames) in [
        ("rotation", vec![3]),
        ("rotation", vec![5]),
        ("rotation", vec![7]),
        ("position", vec![9]),
        ("contour", vec![50]),
        ("pose", vec![20]),
        ("time", vec![40]),
    ] {
        assert!(found.contains(&(field, frames.clone())), "{field} {frames:?}: {said}");
    }
    let turns = found.iter().find(|d| d.0 == "rotation jump").unwrap();
    assert!(turns.1.contains(&30) && turns.1.contains(&31), "{said}");
    assert!(said.contains("frame 3: determinant -1.000"), "{said}");
    assert!(said.contains("frame 7: axes of length 0.8100 (a quaternion of norm 0.9000)"), "{said}");
    assert!(
        said.contains("DEFECT: position in 1 of 60 frames, expected three finite numbers in mm"),
        "{said}"
    );
    assert!(
        said.contains("SUSPICIOUS: pose in 1 of 60 frames, expected steps of at most 5.0 mm")
            && said.contains("frame 20: 7.0 mm off the path")
            && said.contains("left out        6 frames"),
        "{said}"
    );
}

#[test]
fn a_summary_names_every_frame_that_shows_no_wall() {
    let mut recording = some_recording();
    recording.frames[4].contour_mm.fill(DVec2::NAN);
    recording.frames[11].contour_mm.clear();
    recording.frames[12].contour_mm[2..].fill(DVec2::NAN);
    recording.frames[13].contour_mm[3..].fill(DVec2::NAN);
    let summary = Summary::of(&recording);
    assert_eq!(kinds(&summary), [("wall points", vec![4, 11, 12])]);
    assert!(!summary.defects[0].fatal, "a cylinder of a frame of few points draws on the frames before it");
    let said = summary.to_string();
    assert!(said.contains("SUSPICIOUS: wall points in 3 of 60 frames, expected at least 3"), "{said}");
    assert!(said.contains("frame 4: 0 (20 missing echoes)") && said.contains("frame 12: 2 (18"), "{said}");
}

#[test]
fn a_summary_lists_ten_runs_of_frames_of_a_kind_and_counts_the_rest() {
    let mut recording = some_recording();
    recording.frames.iter_mut().step_by(2).for_each(|f| f.world_from_sensor.translation_mm.x = f64::NAN);
    let summary = Summary::of(&recording);
    assert_eq!((summary.defects[0].frames, summary.defects[0].examples.len()), (30, 10));
    assert!(summary.to_string().contains("and 20 more"));

    let mut recording = some_recording();
    recording.frames[4..7].iter_mut().for_each(|f| f.contour_mm.fill(DVec2::NAN));
    recording.frames[9].contour_mm.fill(DVec2::NAN);
    let said = Summary::of(&recording).to_string();
    assert!(said.contains("  frames 4 to 6: 0 (20 missing echoes)\n  frame 9: 0 (20"), "{said}");
    assert!(!said.contains("more"), "{said}");
}

#[test]
fn metres_are_noticed() {
    let mut recording = some_recording();
    recording.frames.iter_mut().flat_map(|f| &mut f.contour_mm).for_each(|p| *p /= 1000.0);
    let said = Summary::of(&recording).to_string();
    assert!(said.contains("contour radius, expected 0.2 to 100 mm"), "{said}");
    assert!(
        said.contains("median 0.0050 mm: are the contours in metres?\n  if so: --contour-units m"),
        "{said}"
    );
}

#[test]
fn info_prints_text_for_people_and_json_for_machines() {
    let folder = tempfile::tempdir().unwrap();
    some_recording().write(&folder.path().join("rec.mat")).unwrap();
    let (status, said, _) = lumenmesh(&["info", "rec.mat"], folder.path());
    assert_eq!(status, 0);
    assert!(said.contains("frames          60 (10.00 per second, 5.90 s)"), "{said}");
    assert!(said.contains("contour radius  5.000 to 5.000, median 5.000 mm"), "{said}");
    let (status, said, _) = lumenmesh(&["info", "rec.mat", "--json"], folder.path());
    assert_eq!(status, 0);
    let json: Value = serde_json::from_str(&said).unwrap();
    assert_eq!((json["frames"].as_u64(), json["defects"].as_array().unwrap().len()), (Some(60), 0));
}

#[test]
fn info_shows_a_recording_that_no_reconstruction_can_use() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec");
    some_recording().write(&path).unwrap();
    let poses = std::fs::read_to_string(path.join("poses.csv")).unwrap();
    let poses = poses.replacen("\n7,0.7000000000000001,0,0,3.5,0,0,0,1\n", "\n7,0.7,0,0,inf,0,0,0,0.5\n", 1);
    std::fs::write(path.join("poses.csv"), poses).unwrap();
    assert!(Recording::read(&path).is_err());
    let (status, said, _) = lumenmesh(&["info", "rec"], folder.path());
    assert_eq!(status, 0);
    assert!(said.contains("frame 7: [0, 0, inf]"), "{said}");
    assert!(said.contains("frame 7: axes of length 0.2500 (a quaternion of norm 0.5000)"), "{said}");
}

#[test]
fn bad_data_is_status_1_and_bad_usage_status_2() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bad.mat"), "not one").unwrap();
    std::fs::write(folder.path().join("bad.csv"), "1\t2\t3\t0\n1\t2\tx\t0\n").unwrap();
    for (arguments, expected) in [
        (vec!["info", "bad.mat"], "lumenmesh: bad.mat: format: found a file without the header of one"),
        (vec!["info", "absent.mat"], "lumenmesh: absent.mat: cannot read"),
        (vec!["import", "pullback", "absent.csv", "-o", "rec.mat"], "lumenmesh: absent.csv: cannot read"),
        (
            vec!["import", "pullback", "bad.csv", "-o", "rec.mat"],
            "bad.csv: line 2: y_mm: found \"x\", expected a number",
        ),
    ] {
        let (status, out, said) = lumenmesh(&arguments, folder.path());
        assert_eq!((status, out.as_str()), (1, ""), "{arguments:?}");
        assert!(said.contains(expected), "{said}");
    }
    for arguments in [
        vec!["info"],
        vec!["import", "pullback", "bad.csv"],
        vec!["import", "pullback", "bad.csv", "-o", "rec.mat", "--centre", "4.5"],
    ] {
        let (status, out, said) = lumenmesh(&arguments, folder.path());
        assert_eq!((status, out.as_str()), (2, ""), "{arguments:?}");
        assert!(said.contains("Usage") || said.contains("two numbers with a comma"), "{said}");
    }
    assert_eq!(names(folder.path()), ["bad.csv", "bad.mat"]);
}

/// Ellipses about (4, 5) in the image, pulled from z = 7 down to 1, each closed by its first point again.
fn pullback_text() -> String {
    let mut text = String::new();
    for (i, number) in [385, 90, 40, 12].into_iter().enumerate() {
        for j in (0..16).chain([0]) {
            let p =
                DVec2::new(4.0, 5.0) + DVec2::from_angle(f64::from(j) / 16.0 * TAU) * DVec2::new(2.0, 1.5);
            text += &format!("{number}\t{}\t{}\t{}\n", p.x, p.y, 7 - 2 * i);
        }
    }
    text
}

#[test]
fn a_pullback_becomes_frames_by_rising_position_about_one_origin() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("contours.tsv");
    std::fs::write(&path, pullback_text()).unwrap();
    let pullback = Pullback::read(&path, &PullbackOptions::default()).unwrap();
    assert_eq!(pullback.frame_numbers, [12, 40, 90, 385]);
    assert_eq!((0..4).map(|k| pullback.recording.number(k)).collect::<Vec<_>>(), [12, 40, 90, 385]);
    assert_eq!(pullback.positions_mm, [1.0, 3.0, 5.0, 7.0]);
    assert!(pullback.centre_mm.abs_diff_eq(DVec2::new(4.0, 5.0), 1e-12));
    for (frame, z) in pullback.recording.frames.iter().zip([1.0, 3.0, 5.0, 7.0]) {
        assert_eq!(frame.contour_mm.len(), 16, "the point that closes the contour is dropped");
        assert!(frame.contour_mm[0].abs_diff_eq(DVec2::new(2.0, 0.0), 1e-12));
        assert_eq!(frame.world_from_sensor, Pose { translation_mm: DVec3::Z * z, ..Pose::IDENTITY });
    }
    let elsewhere =
        Pullback::read(&path, &PullbackOptions::default().with_centre_mm(Some(DVec2::new(3.0, 5.0))))
            .unwrap();
    assert!(elsewhere.recording.frames[0].contour_mm[0].abs_diff_eq(DVec2::new(3.0, 0.0), 1e-12));
    // With names, in another order and dialect, the same.
    let mut named = "z_mm;x_mm;frame;y_mm\r\n".to_owned();
    for line in pullback_text().lines() {
        let [number, x, y, z] = line.split('\t').collect::<Vec<_>>()[..] else { panic!("{line}") };
        named += &format!("{z};{x};{number};{y}\r\n").replace('.', ",");
    }
    std::fs::write(&path, &named).unwrap();
    assert_eq!(Pullback::read(&path, &PullbackOptions::default()).unwrap(), pullback);
    // Without names in the file, but given.
    std::fs::write(&path, named.split_once('\n').unwrap().1).unwrap();
    let named = |names: &[&str]| {
        let names = names.iter().map(|name| name.to_string()).collect();
        Pullback::read(&path, &PullbackOptions::default().with_columns(Some(names)))
    };
    assert_eq!(named(&["z_mm", "x_mm", "frame", "y_mm"]).unwrap(), pullback);
    let said = named(&["z_mm", "x_mm", "frame"]).unwrap_err().to_string();
    assert!(said.ends_with("y_mm: found columns z_mm, x_mm, frame, expected a column y_mm"), "{said}");
    let said = named(&["z_mm", "x_mm", "number", "y_mm"]).unwrap_err().to_string();
    assert!(said.contains("frame"), "{said}");
}

#[test]
fn a_pullback_along_a_centreline_follows_it_without_roll() {
    let folder = tempfile::tempdir().unwrap();
    let (path, line) = (folder.path().join("contours.tsv"), folder.path().join("line.csv"));
    std::fs::write(&path, pullback_text()).unwrap();
    // A quarter of a circle of radius 10 in the xy-plane, and a second branch that does not count.
    let mut text = "branch,s_mm,x_mm,y_mm,z_mm,r_mm\n".to_owned();
    for i in 0..=200 {
        let p = DVec2::from_angle(f64::from(i) / 200.0 * TAU / 4.0) * 10.0;
        text += &format!("0,0,{},{},3,nan\n", p.x, p.y);
    }
    text += "1,0,50,50,50,1\n";
    std::fs::write(&line, text).unwrap();
    let centreline = PullbackPath::read(&line).unwrap();
    assert!((centreline.length_mm() - 10.0 * TAU / 4.0).abs() < 1e-3);
    let pullback =
        Pullback::read(&path, &PullbackOptions::default().with_centreline(Some(centreline))).unwrap();
    let first = &pullback.recording.frames[0].world_from_sensor;
    for (k, frame) in pullback.recording.frames.iter().enumerate() {
        let pose = &frame.world_from_sensor;
        let angle = 2.0 * k as f64 / 10.0;
        let at = DVec3::new(10.0 * angle.cos(), 10.0 * angle.sin(), 3.0);
        assert!(pose.translation_mm.abs_diff_eq(at, 1e-3), "{k}: {pose:?}");
        if k > 0 {
            let along = DVec3::new(-angle.sin(), angle.cos(), 0.0);
            assert!(pose.rotation.z_axis.abs_diff_eq(along, 1e-3), "{k}: {pose:?}");
        }
        // In a plane curve no roll means a constant angle to the plane's normal.
        assert!((pose.rotation.x_axis.z - first.rotation.x_axis.z).abs() < 1e-9, "{k}: {pose:?}");
    }
}

#[test]
fn a_remark_with_a_lone_quote_takes_no_points_away() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("contours.tsv");
    std::fs::write(&path, pullback_text()).unwrap();
    let pullback = Pullback::read(&path, &PullbackOptions::default()).unwrap();
    let mut text = "frame\tx\ty\tz\tremark\n".to_owned();
    for (i, line) in pullback_text().lines().enumerate() {
        text += &format!("{line}\t{}\n", if i == 20 { "\"calcium" } else { "" });
    }
    for text in [text.clone(), text.replace('\t', ","), text.replace('\t', ";").replace('\n', "\r")] {
        std::fs::write(&path, &text).unwrap();
        assert_eq!(Pullback::read(&path, &PullbackOptions::default()).unwrap(), pullback, "{text}");
    }
}

#[test]
fn decimal_commas_among_commas_are_refused_or_quoted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.csv");
    let read = |quote: &str| {
        let number = |x: f64| format!("{quote}{x:.2}{quote}").replace('.', ",");
        let point = |i: i32| format!("{},{},{}\n", number(0.5 * f64::from(i)), number(1.0), number(-2.0));
        std::fs::write(&path, format!("x,y,z\n{}", (0..20).map(point).collect::<String>())).unwrap();
        PullbackPath::read(&path)
    };
    assert!((read("\"").unwrap().length_mm() - 9.5).abs() < 1e-9);
    let said = read("").unwrap_err().to_string();
    assert!(
        said.ends_with("line.csv: line 2: found 6 fields, expected 3, one for each column name"),
        "{said}"
    );
    std::fs::write(&path, "60,00,3,00,1,00\n61,50,3,00,1,00\n").unwrap();
    let said = PullbackPath::read(&path).unwrap_err().to_string();
    assert!(
        said.contains("line.csv: lines: found 6 fields without a decimal point in any, expected 3: "),
        "{said}"
    );
}

#[test]
fn a_pullback_that_cannot_be_placed_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (path, line) = (folder.path().join("contours.tsv"), folder.path().join("line.csv"));
    let refused = |contours: &str, points: &str| {
        std::fs::write(&path, contours).unwrap();
        std::fs::write(&line, points).unwrap();
        let centreline = PullbackPath::read(&line);
        let pullback = centreline
            .and_then(|line| Pullback::read(&path, &PullbackOptions::default().with_centreline(Some(line))));
        pullback.unwrap_err().to_string()
    };
    let good = pullback_text();
    let said = refused(&good, "0,0,0\n0,0,5\n");
    assert!(
        said.ends_with(
            "line.csv: centreline length: found 5.000 mm, expected at least 6.000 mm (the pullback)"
        ),
        "{said}"
    );
    let said = refused(&good, "0,0,0\n0,0,0\n");
    assert!(said.ends_with("line.csv: centreline: found 1 different points, expected at least 2"), "{said}");
    let said = refused(&good, "0,0,0\n0,nan,0\n");
    assert!(said.ends_with("line.csv: line 2: y_mm: found \"nan\", expected a number"), "{said}");
    let line = "0,0,0\n0,0,50\n";
    let said = refused("1\t2\t3\t0\n1\t2\t4\t0.5\n", line);
    assert!(said.ends_with("line 2: z_mm: found 0.5, expected 0 (as before in frame 1)"), "{said}");
    let half = good.replace("385\t4\t6.5\t7", "385\t4\tna\t7");
    assert_ne!(half, good);
    let said = refused(&half, "0,0,0\n0,0,50\n");
    assert!(said.contains("contours.tsv: frame 385: contour: found ("), "{said}");
    let said = refused("1\t2\t3\n", line);
    assert!(said.ends_with("line 1: z_mm: found a line of 3 fields, expected at least 4"), "{said}");
    let said = refused("", line);
    assert!(said.ends_with("contours: found no lines, expected at least one contour"), "{said}");
    let said = refused("1\t2\t3\t0\n1\t2\t4\t0\n", line);
    assert!(said.contains("contours: found none with an area"), "{said}");
}

#[test]
fn real_pullbacks_are_imported_along_a_real_centreline() {
    for (name, frames) in
        [("ivus_rest/diastolic", 20), ("ivus_rest/systolic", 17), ("ivus_stress/diastolic", 25)]
    {
        let Some(contours) = shared(&format!("data/ivus_narco/{name}_contours.csv")) else { return };
        let Some(line) = shared("data/ivus_narco/centerline_raw.csv") else { return };
        let [contours, line] = [contours, line].map(|p| p.canonicalize().unwrap().display().to_string());
        let folder = tempfile::tempdir().unwrap();
        let arguments = ["import", "pullback", &contours, "-o", "rec.mat", "--centreline", &line];
        let (status, said, errors) = lumenmesh(&arguments, folder.path());
        assert_eq!((status, errors.as_str()), (0, ""));
        assert!(said.contains("roll            not measured"), "{said}");
        let recording = Recording::read(&folder.path().join("rec.mat")).unwrap();
        assert_eq!(recording.frames.len(), frames);
        assert!(recording.frames.iter().all(|f| f.contour_mm.len() == 500));
        let (status, json, _) = lumenmesh(&[&arguments[..], &["--json"]].concat(), folder.path());
        assert_eq!(status, 0);
        let json: Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["frame_numbers"].as_array().unwrap().len(), frames);
        assert_eq!(json["summary"]["frames"].as_u64(), Some(frames as u64));
        assert_eq!(names(folder.path()), ["rec.mat"]);
    }
}

#[test]
fn a_roll_in_the_poses_shows_as_turns() {
    let mut recording = some_recording();
    for (k, frame) in recording.frames.iter_mut().enumerate() {
        frame.world_from_sensor.rotation = DMat3::from_quat(DQuat::from_rotation_z(k as f64 * 0.01));
    }
    let summary = Summary::of(&recording);
    assert!((summary.turn_rad.unwrap().median - 0.01).abs() < 1e-6);
    assert_eq!(summary.defects, []);
}

#[test]
fn files_without_column_names_are_read_with_names_given() {
    let folder = tempfile::tempdir().unwrap();
    let recording = some_recording();
    recording.write(&folder.path().join("named")).unwrap();
    std::fs::create_dir(folder.path().join("bare")).unwrap();
    let text = |name: &str| std::fs::read_to_string(folder.path().join("named").join(name)).unwrap();
    let without_names = |text: &str| text.split_once('\n').unwrap().1.to_owned();
    std::fs::write(folder.path().join("bare/poses.csv"), without_names(&text("poses.csv"))).unwrap();
    // In another order: y, x, frame.
    let contours = without_names(&text("contours.csv"));
    let turned: String =
        contours.lines().map(|line| line.split(',').rev().collect::<Vec<_>>().join(",") + "\n").collect();
    std::fs::write(folder.path().join("bare/contours.csv"), turned).unwrap();
    let info = |arguments: &[&str]| lumenmesh(&[&["info", "--json"], arguments].concat(), folder.path());
    let (status, _, said) = info(&["bare"]);
    assert!(status == 1 && said.contains("found no line of column names"), "{said}");
    let names =
        ["--pose-columns", "frame,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw", "--contour-columns", "y_mm,x_mm,frame"];
    let (status, bare, said) = info(&[&["bare"], &names[..]].concat());
    assert_eq!((status, said.as_str()), (0, ""));
    assert_eq!(bare, info(&["named"]).1);
    let (status, _, said) = info(&["bare", names[0], "frame,x_mm", names[2], names[3]]);
    assert!(status == 1 && said.contains("found columns frame, x_mm, expected a column y_mm"), "{said}");
    recording.write(&folder.path().join("rec.mat")).unwrap();
    let (status, _, said) = info(&[&["rec.mat"], &names[..]].concat());
    assert!(status == 1 && said.contains("expected a folder of CSV files"), "{said}");
}
