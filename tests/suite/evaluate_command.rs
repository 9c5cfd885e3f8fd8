//! `lumenmesh evaluate` as a user runs it.

use crate::support::tube;
use lumenmesh::surface::Surface;
use std::path::Path;
use std::process::{Command, Output};

fn command(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumenmesh"));
    command.current_dir(folder).arg("evaluate").args(arguments).output().unwrap()
}

fn shapes() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    tube(24, 10, 9.5, 20.0).write(&folder.path().join("mesh.vtp")).unwrap();
    tube(240, 40, 10.0, 60.0).write(&folder.path().join("truth.stl")).unwrap();
    folder
}

#[test]
fn the_command_prints_every_number_with_its_definition() {
    let folder = shapes();
    let output = command(folder.path(), &["mesh.vtp", "--truth", "truth.stl"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success() && output.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    // Node to facet of a finely divided tube: 0.5 mm less its sag of 10·(1 - cos(π/240)) = 0.0009 mm.
    assert!(text.contains("fitting error  0.49") || text.contains("fitting error  0.5000 mm"), "{text}");
    for word in [
        "rms, mm",
        "median, mm",
        "95th percentile, mm",
        "largest, mm",
        "signed mean, mm",
        "not on an open rim",
        "nearest rank",
    ] {
        assert!(text.contains(word), "{word} is missing:\n{text}");
    }
}

#[test]
fn the_command_writes_json_and_a_coloured_mesh() {
    let folder = shapes();
    let output =
        command(folder.path(), &["mesh.vtp", "--truth", "truth.stl", "--json", "--out", "error.vtp"]);
    assert!(output.status.success());
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
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
        let output = command(folder.path(), arguments);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(status), "{text}");
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
    let output = command(folder.path(), &["metres.ply", "--truth", "truth.stl"]);
    assert!(output.status.success());
    assert!(String::from_utf8(output.stderr).unwrap().contains("lumenmesh: warning: the mesh spans"));
}

#[test]
fn the_help_shows_examples() {
    let output = command(Path::new("."), &["--help"]);
    assert!(
        String::from_utf8(output.stdout).unwrap().contains("lumenmesh evaluate mesh.vtp --truth aorta.stl")
    );
}
