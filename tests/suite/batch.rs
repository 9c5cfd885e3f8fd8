//! Many recordings at once: each gives what it gives alone, a failure stops no other, and what is done stays done.

use crate::support::{lumenmesh, names};
use std::path::Path;

fn succeeds(arguments: &[&str], folder: &Path) -> String {
    let (status, stdout, stderr) = lumenmesh(arguments, folder);
    assert_eq!(status, 0, "{stdout}{stderr}");
    stdout
}

#[test]
fn a_folder_of_recordings_becomes_meshes_and_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir(at.join("in")).unwrap();
    for (name, seed) in [("in/a.mat", "1"), ("in/b", "2")] {
        succeeds(&["simulate", "--vessel", "cylinder", "--steady", "--seed", seed, "-o", name], at);
    }
    std::fs::write(at.join("in/broken.mat"), "no recording").unwrap();
    std::fs::write(at.join("in/notes.txt"), "not looked at").unwrap();
    let batch = ["batch", "in", "--out", "out", "--format", "ply", "--backend", "cpu"];
    let (status, stdout, stderr) = lumenmesh(&batch, at);
    assert_eq!(status, 1, "{stdout}");
    assert!(stderr.contains("in: recordings: found 1 of 3 that failed, expected a mesh of each"), "{stderr}");
    assert!(
        stdout.contains("broken.mat: failed: ") && stdout.contains("in/broken.mat: format: found "),
        "{stdout}"
    );
    let expected = ["a.json", "a.ply", "b.json", "b.ply", "batch.csv"];
    assert_eq!(names(&at.join("out")), expected);
    succeeds(&["reconstruct", "in/b", "-o", "b.ply", "--backend", "cpu"], at);
    let bytes = |name: &str| std::fs::read(at.join(name)).unwrap();
    assert!(bytes("out/b.ply") == bytes("b.ply"));
    let table = String::from_utf8(bytes("out/batch.csv")).unwrap();
    assert_eq!(table.lines().next(), Some("recording,frames,left_out,nodes,triangles,error"));
    assert_eq!(table.lines().count(), 4);

    // Again: what is there is kept, what failed is tried again, and what changed is made anew.
    std::fs::remove_file(at.join("in/broken.mat")).unwrap();
    std::fs::copy(at.join("in/a.mat"), at.join("in/c.mat")).unwrap();
    succeeds(&["simulate", "--vessel", "cylinder", "--steady", "--seed", "3", "-o", "in/b"], at);
    let said = succeeds(&batch, at);
    let was_there = |name: &str| {
        said.lines().find(|line| line.starts_with(&format!("{name}: "))).unwrap().ends_with("(was there)")
    };
    assert!(was_there("a.mat") && !was_there("b") && !was_there("c.mat"), "{said}");
    assert!(bytes("out/b.ply") != bytes("b.ply") && bytes("out/c.ply") == bytes("out/a.ply"));
    let said = succeeds(&[&batch[..], &["--roughness", "0.2"]].concat(), at);
    assert!(!said.contains("was there"), "{said}");
    let lines: serde_json::Value =
        serde_json::from_str(&succeeds(&[&batch[..], &["--roughness", "0.2", "--json"]].concat(), at))
            .unwrap();
    assert_eq!(lines.as_array().unwrap().len(), 3);

    // A recording that fails now leaves nothing of what it gave before.
    std::fs::write(at.join("in/c.mat"), "no recording").unwrap();
    let batch = ["batch", "in", "--out", "out", "--backend", "cpu"];
    let (status, stdout, _) = lumenmesh(&batch, at);
    assert_eq!(status, 1, "{stdout}");
    assert_eq!(names(&at.join("out")), ["a.json", "a.vtp", "b.json", "b.vtp", "batch.csv"]);
    let status = lumenmesh(&[&batch[..], &["--roughness", "0.2"]].concat(), at).0;
    assert_eq!((status, names(&at.join("out")).len()), (1, 5));
    assert!(lines[0]["error"].is_null() && lines[0]["nodes"].as_u64().unwrap() > 100);
}

/// The names of columns are no setting, but change what a recording is.
#[test]
fn other_names_of_columns_are_other_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir(at.join("in")).unwrap();
    succeeds(&["simulate", "--vessel", "cylinder", "--steady", "-o", "in/a"], at);
    let poses = std::fs::read_to_string(at.join("in/a/poses.csv")).unwrap();
    let (names_of, lines) = poses.split_once('\n').unwrap();
    std::fs::write(at.join("in/a/poses.csv"), lines).unwrap();
    let was_there = |columns: &str| {
        let batch = ["batch", "in", "--out", "out", "--backend", "cpu", "--pose-columns", columns];
        succeeds(&batch, at).contains("(was there)")
    };
    let others = names_of.replace("x_mm,y_mm", "y_mm,x_mm");
    assert!(!was_there(names_of) && was_there(names_of));
    assert!(!was_there(&others) && was_there(&others) && !was_there(names_of));
}

#[test]
fn folders_that_cannot_be_done_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir_all(at.join("empty")).unwrap();
    std::fs::create_dir_all(at.join("twice/a")).unwrap();
    std::fs::write(at.join("twice/a/poses.csv"), "").unwrap();
    std::fs::write(at.join("twice/a.mat"), "").unwrap();
    for (arguments, message) in [
        (["batch", "no", "--out", "out"], "no: cannot read: "),
        (
            ["batch", "empty", "--out", "out"],
            "empty: recordings: found none, expected a .mat or sequence file",
        ),
        (["batch", "twice", "--out", "out"], "expected names that differ before their endings"),
    ] {
        let (status, _, stderr) = lumenmesh(&arguments, at);
        assert!(status == 1 && stderr.contains(message), "{stderr}");
        assert!(!at.join("out").exists());
    }
    std::fs::remove_dir_all(at.join("twice/a")).unwrap();
    let (status, _, stderr) = lumenmesh(&["batch", "twice", "--out", "twice"], at);
    assert!(status == 1 && stderr.contains("setting out: found twice, the recordings' folder"), "{stderr}");
    let (status, _, stderr) = lumenmesh(&["batch", "twice", "--out", "out", "--format", "3mf"], at);
    assert!(status == 1 && stderr.contains("unknown ending \"3mf\""), "{stderr}");
}
