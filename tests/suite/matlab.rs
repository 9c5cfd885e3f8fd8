//! The MATLAB package, run by Octave.

use crate::support::{lumenmesh, skipped};
use lumenmesh::surface::Surface;
use std::path::Path;
use std::process::Command;

/// What Octave prints for some code run in a folder, with the package on its path; `None` where there is no Octave. An
/// error of the code is in the text.
fn octave(folder: &Path, code: &str) -> Option<String> {
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("matlab");
    let code = format!(
        "addpath ('{}'); try\n{code}\ncatch error\n printf ('error: %s\\n', error.message);\nend",
        package.display()
    );
    let mut command = Command::new("octave-cli");
    command.args(["--no-init-file", "--quiet", "--eval", &code]).current_dir(folder);
    match command.env("LUMENMESH", env!("CARGO_BIN_EXE_lumenmesh")).output() {
        Ok(output) => Some(String::from_utf8_lossy(&output.stdout).into_owned()),
        Err(error) => {
            skipped(&format!("octave-cli does not run: {error}"), "LUMENMESH_REQUIRE_TOOLS");
            None
        }
    }
}

fn succeeds(arguments: &[&str], folder: &Path) {
    let (status, stdout, stderr) = lumenmesh(arguments, folder);
    assert_eq!(status, 0, "{stdout}{stderr}");
}

#[test]
fn a_recording_becomes_the_mesh_of_the_command() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    succeeds(
        &["simulate", "--vessel", "cylinder", "--steady", "-o", "rec.mat", "--truth", "truth.stl"],
        folder,
    );
    let options = ["--method", "cylinders", "--nodes", "16", "--gate", "0.5,1.6", "--backend", "cpu"];
    succeeds(&[&["reconstruct", "rec.mat", "-o", "expected.mat"], &options[..]].concat(), folder);
    succeeds(&["replay", "rec.mat", "-o", "live.mat", "--backend", "cpu"], folder);
    let Some(said) = octave(
        folder,
        "recording = lumenmesh.read ('rec.mat');
         [mesh, report] = lumenmesh.reconstruct (recording, 'method', 'cylinders', 'nodes', 16, 'gate', [0.5 1.6], ...
                                                 'backend', 'cpu', 'strict', false);
         expected = load ('expected.mat');
         printf ('same %d\\n', isequaln (mesh, expected));
         printf ('faces from %d to %d of %d\\n', min (mesh.faces(:)), max (mesh.faces(:)), rows (mesh.vertices));
         printf ('method %s\\n', jsondecode (report).settings.method);
         printf ('live %d\\n', isequaln (lumenmesh.live ('rec.mat', 'backend', 'cpu'), load ('live.mat')));
         printf ('error %.6f\\n', lumenmesh.evaluate (mesh, 'truth.stl'));
         lumenmesh.write (mesh, 'written.vtp');
         again = lumenmesh.read ('written.vtp');
         printf ('again %d\\n', isequaln (again, expected));
         lumenmesh.write (recording, 'copy.mat');",
    ) else {
        return;
    };
    let expected = Surface::read(&folder.join("expected.mat")).unwrap();
    let nodes = expected.nodes_mm.len();
    for line in
        ["same 1", &format!("faces from 1 to {nodes} of {nodes}"), "method cylinders", "live 1", "again 1"]
    {
        assert!(said.lines().any(|said| said == line), "{line}:\n{said}");
    }
    let error_mm: f64 = said.lines().find_map(|l| l.strip_prefix("error ")).unwrap().parse().unwrap();
    assert!(error_mm > 0.0 && error_mm < 1.0, "{said}");
    assert_eq!(Surface::read(&folder.join("written.vtp")).unwrap().nodes_mm, expected.nodes_mm);
    let [rec, copy] = ["rec.mat", "copy.mat"]
        .map(|name| lumenmesh::recording::Recording::read(&folder.join(name)).unwrap());
    assert_eq!(rec.frames.len(), copy.frames.len());
    assert!(rec.frames.iter().zip(&copy.frames).all(|(a, b)| a.world_from_sensor == b.world_from_sensor));
}

#[test]
fn wrong_input_has_the_words_of_the_command() {
    let folder = tempfile::tempdir().unwrap();
    for (code, message) in [
        ("lumenmesh.reconstruct ('no.mat')", "error: lumenmesh: no.mat: cannot read: "),
        (
            "lumenmesh.reconstruct (struct ('a', 1))",
            "error: data: found fields a, expected vertices and faces, or ",
        ),
        ("lumenmesh.reconstruct (1)", "error: data: found a double, expected a struct"),
        ("lumenmesh.reconstruct ('no.mat', 'nodes')", "error: options: found 1 arguments, expected pairs"),
        ("lumenmesh.reconstruct ('no.mat', 'nodez', 3)", "unexpected argument '--nodez'"),
        ("lumenmesh.reconstruct ('no.mat', 'nodes', {})", "error: nodes: found a cell, expected a number"),
        (
            "m = struct ('vertices', [0 0 0; 1 0 0; 0 1 0], 'faces', [0 1 2]); lumenmesh.write (m, 'm.ply')",
            "faces, row 1: found 0, expected a node from 1 to 3",
        ),
        ("setenv ('LUMENMESH', '/no/lumenmesh'); lumenmesh.reconstruct ('no.mat')", "/no/lumenmesh"),
    ] {
        let Some(said) = octave(folder.path(), code) else { return };
        assert!(said.contains(message) && said.starts_with("error: "), "{code}\n{said}");
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "nothing is left behind");
}
