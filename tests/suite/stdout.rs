//! The command's standard output where it cannot be written.

use std::path::Path;
use std::process::{Command, Output, Stdio};

/// One command that prints lines as it goes, and one of each kind that prints at once: text, JSON and a table.
const COMMANDS: [&[&str]; 4] = [
    &["demo"],
    &["info", "lumenmesh-demo/recording.mat"],
    &["info", "lumenmesh-demo/recording.mat", "--json"],
    &["evaluate", "lumenmesh-demo/vessel.vtp", "--truth", "lumenmesh-demo/truth.vtp"],
];

fn lumenmesh(arguments: &[&str], folder: &Path, stdout: impl Into<Stdio>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumenmesh"));
    command.args(arguments).current_dir(folder).stdout(stdout).output().unwrap()
}

/// A folder with the files that the commands read.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    assert!(lumenmesh(&["demo"], folder.path(), Stdio::null()).status.success());
    folder
}

#[test]
fn a_reader_that_has_seen_enough_ends_the_command_quietly() {
    let folder = folder();
    for arguments in COMMANDS {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let done = lumenmesh(arguments, folder.path(), writer);
        assert_eq!(String::from_utf8_lossy(&done.stderr), "", "{arguments:?}");
        assert!(done.status.success(), "{arguments:?}: {}", done.status);
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_behind_stdout_is_said() {
    let folder = folder();
    for arguments in COMMANDS.into_iter().chain([&["--help"][..], &["--version"]]) {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let done = lumenmesh(arguments, folder.path(), full);
        let message = String::from_utf8_lossy(&done.stderr);
        assert!(message.starts_with("lumenmesh: stdout: cannot write: No space left"), "{message}");
        assert_eq!(done.status.code(), Some(1), "{arguments:?}");
    }
}
