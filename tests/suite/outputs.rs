//! What is written, and what is left alone.

use crate::support::{lumenmesh, names};
use std::ffi::OsStr;
use std::fs::Permissions;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

const SIMULATE: [&str; 4] = ["simulate", "--vessel", "cylinder", "-o"];

/// A folder with a recording and a truth surface.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    run(&[&SIMULATE[..], &["rec.mat", "--truth", "truth.vtp"]].concat(), folder.path());
    folder
}

fn run(arguments: &[&str], folder: &Path) {
    let (status, _, said) = lumenmesh(arguments, folder);
    assert_eq!((status, said.as_str()), (0, ""), "{arguments:?}");
}

fn mode(path: &Path) -> u32 {
    std::fs::metadata(path).unwrap().permissions().mode() & 0o777
}

/// The man pages and the completions are made of the same description as `--help`.
#[test]
fn the_manual_and_the_completions_know_all_commands() {
    let folder = tempfile::tempdir().unwrap();
    let (status, help, _) = lumenmesh(&["--help"], folder.path());
    assert_eq!(status, 0);
    let commands: Vec<&str> = help
        .lines()
        .skip_while(|line| !line.starts_with("Commands:"))
        .skip(1)
        .take_while(|line| !line.is_empty())
        .filter_map(|line| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect();
    assert!(commands.contains(&"reconstruct") && commands.len() > 15, "{commands:?}");
    assert_eq!(lumenmesh(&["manual", "--out", "man"], folder.path()).0, 0);
    for shell in ["bash", "zsh", "fish"] {
        let (status, text, _) = lumenmesh(&["completions", shell], folder.path());
        assert_eq!(status, 0);
        for name in &commands {
            assert!(text.contains(name), "{shell}: {name}");
            let page = folder.path().join(format!("man/lumenmesh-{name}.1"));
            assert!(std::fs::read_to_string(&page).unwrap().contains(".SH SYNOPSIS"), "{}", page.display());
        }
    }
    assert_eq!(lumenmesh(&["completions", "cmd"], folder.path()).0, 2);
}

#[test]
fn new_files_and_folders_have_the_permissions_that_the_user_wants() {
    let folder = folder();
    let with_mask = |mask: &str, arguments: &str| {
        let script = format!("umask {mask}; exec \"$0\" {arguments}");
        let command = env!("CARGO_BIN_EXE_lumenmesh");
        let done =
            Command::new("sh").args(["-c", &script, command]).current_dir(folder.path()).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    };
    let path = |name: &str| folder.path().join(name);
    with_mask("077", "reconstruct rec.mat -o private.vtp");
    with_mask("077", "simulate --vessel cylinder -o private");
    with_mask("022", "reconstruct rec.mat -o shared.vtp");
    with_mask("022", "simulate --vessel cylinder -o shared");
    let found = ["private.vtp", "private", "private/poses.csv", "shared.vtp", "shared", "shared/poses.csv"];
    assert_eq!(found.map(|name| mode(&path(name))), [0o600, 0o700, 0o600, 0o644, 0o755, 0o644]);
    // A file that is replaced keeps its own.
    std::fs::set_permissions(path("shared.vtp"), Permissions::from_mode(0o640)).unwrap();
    with_mask("022", "reconstruct rec.mat -o shared.vtp");
    assert_eq!(mode(&path("shared.vtp")), 0o640);
}

#[test]
fn an_output_that_is_an_input_is_refused() {
    let folder = folder();
    run(&["reconstruct", "rec.mat", "-o", "vessel.vtp"], folder.path());
    run(&[&SIMULATE[..], &["rec"]].concat(), folder.path());
    std::os::unix::fs::symlink("truth.vtp", folder.path().join("link.vtp")).unwrap();
    let before: Vec<_> = names(folder.path());
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let (truth, poses) = (bytes("truth.vtp"), bytes("rec/poses.csv"));
    for arguments in [
        &["evaluate", "vessel.vtp", "--truth", "truth.vtp", "--out", "truth.vtp"][..],
        &["evaluate", "vessel.vtp", "--truth", "truth.vtp", "--out", "link.vtp"],
        &["evaluate", "vessel.vtp", "--truth", "truth.vtp", "--out", "./rec/../vessel.vtp"],
        &["reconstruct", "rec", "-o", "m.vtp", "--method", "cylinders", "--cylinders", "rec/poses.csv"],
        &["sections", "vessel.vtp", "rec.mat", "--csv", "rec.mat"],
    ] {
        let (status, out, said) = lumenmesh(arguments, folder.path());
        assert_eq!((status, out.as_str()), (1, ""), "{arguments:?}");
        assert!(said.contains("output: found an input of the same command"), "{arguments:?}: {said}");
    }
    assert_eq!(names(folder.path()), before);
    assert_eq!((bytes("truth.vtp"), bytes("rec/poses.csv")), (truth, poses));
}

#[test]
fn a_path_that_is_no_text_is_shown_in_json() {
    let folder = folder();
    for (arguments, ending) in [
        (&["reconstruct", "rec.mat", "--json", "-o"][..], "vtp"),
        (&["replay", "rec.mat", "--json", "-o"], "vtp"),
        (&["render", "truth.vtp", "--size", "320x320", "--json", "-o"], "png"),
        (&["report", "rec.mat", "--json", "-o"], "html"),
        (&["simulate", "--vessel", "cylinder", "--json", "-o"], "mat"),
    ] {
        let name = [b"\xff.", ending.as_bytes()].concat();
        let mut command = Command::new(env!("CARGO_BIN_EXE_lumenmesh"));
        let done = command
            .args(arguments)
            .arg(OsStr::from_bytes(&name))
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(done.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&done.stderr));
        let json: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
        assert!(json.to_string().contains(&format!("\u{fffd}.{ending}")), "{json}");
    }
}

#[test]
fn an_interrupted_command_leaves_no_temporary_file() {
    let folder = folder();
    let before = names(folder.path());
    let mut interrupted = 0;
    for (k, signal) in ["-TERM", "-INT", "-HUP"].into_iter().cycle().take(6).enumerate() {
        let mut child = Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
            .args([
                "simulate",
                "--vessel",
                "aorta",
                "--rays",
                "500",
                "-o",
                if k % 2 == 0 { "big" } else { "big.mat" },
            ])
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // Some while it computes, some while it writes.
        let deadline = std::time::Instant::now() + Duration::from_secs(60);
        let writes = || names(folder.path()).iter().any(|name| name.starts_with(".lumenmesh-"));
        while k % 3 > 0 && !writes() && std::time::Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(20));
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        let status = child.wait().unwrap();
        interrupted += usize::from(!status.success());
        let left: Vec<String> =
            names(folder.path()).into_iter().filter(|name| !name.starts_with("big")).collect();
        assert_eq!(left, before, "{signal}");
    }
    assert!(interrupted >= 3, "{interrupted} of 6 were interrupted");
}

#[test]
fn a_folder_recording_is_replaced_as_a_whole() {
    let folder = tempfile::tempdir().unwrap();
    let simulate = |seed: &str, to: &str| [&SIMULATE[..], &[to, "--seed", seed]].concat().join(" ");
    run(&simulate("1", "one").split(' ').collect::<Vec<_>>(), folder.path());
    run(&simulate("2", "two").split(' ').collect::<Vec<_>>(), folder.path());
    run(&simulate("1", "rec").split(' ').collect::<Vec<_>>(), folder.path());
    let bytes = |of: &str, name: &str| std::fs::read(folder.path().join(of).join(name)).unwrap();
    let (poses, contours) = (bytes("one", "poses.csv"), bytes("one", "contours.csv"));
    assert!(poses != bytes("two", "poses.csv") && contours != bytes("two", "contours.csv"));
    for _ in 0..10 {
        let children: Vec<_> = ["1", "2"]
            .map(|seed| {
                let mut command = Command::new(env!("CARGO_BIN_EXE_lumenmesh"));
                command
                    .args(simulate(seed, "rec").split(' '))
                    .current_dir(folder.path())
                    .stdout(Stdio::null());
                command.spawn().unwrap()
            })
            .into();
        for mut child in children {
            assert!(child.wait().unwrap().success());
        }
        assert_eq!(bytes("rec", "poses.csv") == poses, bytes("rec", "contours.csv") == contours);
    }
}

#[test]
fn no_login_is_no_reason_to_complain() {
    let folder = folder();
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumenmesh"));
    command.args(["reconstruct", "rec.mat", "-o", "v.vtp", "--backend", "gpu"]).current_dir(folder.path());
    let done = command.env_remove("XDG_RUNTIME_DIR").output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(!said.contains("XDG_RUNTIME_DIR"), "{said}");
}
