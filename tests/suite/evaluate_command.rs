//! `lumenmesh evaluate` as a user runs it.

use crate::support::{lumenmesh, tube};
use lumenmesh::evaluate::DEFINITIONS;
use lumenmesh::surface::Surface;
use std::path::Path;

fn evaluate(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    lumenmesh(&[&["evaluate"], arguments].concat(), folder)
}

fn shapes() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    tube(24, 10, 9.5, 20.0).write(&folder.path().join("mesh.vtp")).unwrap();
    tube(240, 40, 10.0, 60.0).write(&folder.path().join("truth.stl")).unwrap();
    folder
}

#[test]
fn the_command_prints_every_number_and_which_part_of_the_truth_counted() {
    let folder = shapes();
    let (status, text, errors) = evaluate(folder.path(), &["mesh.vtp", "--truth", "truth.stl"]);
    assert_eq!((status, errors.as_str()), (0, ""));
    // Node to facet of a finely divided tube: 0.5 mm less its sag of 10·(1 - cos(π/240)) = 0.0009 mm.
    assert!(text.contains("fitting error  0.49") || text.contains("fitting error  0.5000 mm"), "{text}");
    for word in [
        "rms, mm",
        "median, mm",
        "95th percentile, mm",
        "largest, mm",
        "signed mean, mm",
        "not on an open rim",
        "--recording gives a better rule",
    ] {
        assert!(text.contains(word), "{word} is missing:\n{text}");
    }
    assert!(!text.contains("nearest rank"), "definitions are for --help and --json:\n{text}");
}

#[test]
fn the_command_writes_json_and_a_coloured_mesh() {
    let folder = shapes();
    let (status, text, _) =
        evaluate(folder.path(), &["mesh.vtp", "--truth", "truth.stl", "--json", "--out", "error.vtp"]);
    assert_eq!(status, 0);
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let coloured = Surface::read(&folder.path().join("error.vtp")).unwrap();
    let errors = coloured.array("error_mm").unwrap();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!((report["mesh_to_truth"]["mean_mm"].as_f64().unwrap() - mean).abs() < 1e-12);
    assert_eq!(report["mesh_to_truth"]["nodes"], errors.len());
    assert!(coloured.array("signed_error_mm").unwrap().iter().all(|&e| (-0.5..-0.49).contains(&e)));
    assert!((report["covered_area_share"].as_f64().unwrap() - 1.0 / 3.0).abs() < 0.03);
    assert!(report["definitions"]["truth_to_mesh"].is_string() && report.get("error_mm").is_none());
}

#[test]
fn the_command_says_what_is_wrong_and_exits_accordingly() {
    let folder = shapes();
    std::fs::write(folder.path().join("empty.stl"), "").unwrap();
    let failed = |arguments: &[&str], status: i32, expected: &str| {
        let (found, _, text) = evaluate(folder.path(), arguments);
        assert_eq!(found, status, "{text}");
        assert!(text.contains(expected), "{text}");
    };
    failed(&["mesh.vtp", "--truth", "none.stl"], 1, "lumenmesh: none.stl: cannot read: ");
    failed(
        &["mesh.vtp", "--truth", "empty.stl"],
        1,
        "empty.stl: content: found an empty file, expected a surface",
    );
    failed(
        &["mesh.vtp", "--truth", "truth.stl", "--out", "e.obj"],
        1,
        "e.obj: unknown ending \"obj\", expected one of .vtp, .ply",
    );
    failed(&["mesh.vtp"], 2, "--truth <SURFACE>");
    assert!(!folder.path().join("e.obj").exists());

    let mut metres = tube(24, 10, 9.5e-3, 20e-3);
    metres.nodes_mm.iter_mut().for_each(|p| p.z += 0.001);
    metres.write(&folder.path().join("metres.ply")).unwrap();
    let (status, _, errors) = evaluate(folder.path(), &["metres.ply", "--truth", "truth.stl"]);
    assert_eq!(status, 0);
    assert!(errors.contains("lumenmesh: warning: the mesh spans"), "{errors}");
}

#[test]
fn the_long_help_defines_every_number_and_both_show_examples() {
    // Where lines break is the terminal's to say.
    let in_one_line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let help = |which: &str| in_one_line(&evaluate(Path::new("."), &[which]).1);
    let (short, long) = (help("-h"), help("--help"));
    for text in [&short, &long] {
        assert!(text.contains("lumenmesh evaluate mesh.vtp --truth aorta.stl"), "{text}");
    }
    for (name, definition) in DEFINITIONS {
        assert!(long.contains(&in_one_line(&format!("{name} {definition}"))), "{name}: {long}");
        assert!(!short.contains(&in_one_line(definition)), "{name}: {short}");
    }
}

#[test]
fn a_statistic_of_sections_counts_what_was_measured() {
    use glam::{DVec2, DVec3};
    use lumenmesh::geometry::Pose;
    use lumenmesh::recording::{Frame, Recording};
    let folder = tempfile::tempdir().unwrap();
    // Closed up to z = 3, half open beyond.
    let mut mesh = crate::support::tube(48, 12, 2.0, 12.0);
    mesh.nodes_mm.iter_mut().for_each(|p| p.z += 6.0);
    let nodes = mesh.nodes_mm.clone();
    mesh.triangles.retain(|t| t.iter().all(|&n| nodes[n as usize].z < 5.5 || nodes[n as usize].y > -1e-9));
    mesh.write(&folder.path().join("mesh.obj")).unwrap();
    let frame = |k: u32| {
        let ring = (0..16).map(|j| DVec2::from_angle(f64::from(j) / 16.0 * std::f64::consts::TAU) * 2.0);
        Frame::new(Pose { translation_mm: DVec3::Z * (0.5 + f64::from(k)), ..Pose::IDENTITY }, ring.collect())
    };
    Recording { frames: (0..9).map(frame).collect() }.write(&folder.path().join("frames.mat")).unwrap();
    // By hand: 1, 2, 3 ... per cent off the area of the mesh, 48-gons of radius 2.
    let area = 0.5 * 48.0 * 4.0 * (std::f64::consts::TAU / 48.0).sin();
    let mut by_hand = String::from("frame,lumen_area\n");
    for k in 0..9 {
        by_hand += &format!("{k},{}\n", area / (1.0 + 0.01 * f64::from(k + 1)));
    }
    std::fs::write(folder.path().join("by_hand.csv"), by_hand).unwrap();
    let arguments = ["sections", "mesh.obj", "frames.mat", "--against", "by_hand.csv"];
    let (status, said, _) = lumenmesh(&arguments, folder.path());
    assert_eq!(status, 0);
    let expected =
        "difference of area: 3.00 % over 5 frames with an area, of 9 with a value in the table and 9 in all";
    assert!(said.contains(expected), "{said}");
    let (_, json, _) = lumenmesh(&[&arguments[..], &["--json"]].concat(), folder.path());
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((json["compared"].as_u64(), json["with_value"].as_u64()), (Some(5), Some(9)));
}
