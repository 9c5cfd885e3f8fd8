//! What several test files share: the data that lies outside the repository, and tools that may be absent.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A file of the shared data; `None`, said loudly, where it is not there.
pub fn shared(name: &str) -> Option<PathBuf> {
    let root = std::env::var("LUMENMESH_SHARED").unwrap_or_else(|_| "../shared".into());
    let path = Path::new(&root).join(name);
    if path.exists() {
        return Some(path);
    }
    let required = std::env::var("LUMENMESH_REQUIRE_DATA").is_ok_and(|v| v == "1");
    assert!(!required, "{} is not there", path.display());
    eprintln!("SKIPPED: {} is not there (set LUMENMESH_SHARED)", path.display());
    None
}

/// What Octave prints for some code run in a folder; `None`, said loudly, where there is no Octave.
///
/// `nansum_(x)` adds up what is not NaN.
pub fn octave(folder: &Path, code: &str) -> Option<String> {
    let code = format!("nansum_ = @(x) sum(x(! isnan(x))); {code}");
    let run = Command::new("octave-cli")
        .args(["--no-init-file", "--quiet", "--eval", &code])
        .current_dir(folder)
        .output();
    match run {
        Ok(output) => {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            Some(String::from_utf8_lossy(&output.stdout).into_owned())
        }
        Err(e) => {
            let required = std::env::var("LUMENMESH_REQUIRE_TOOLS").is_ok_and(|v| v == "1");
            assert!(!required, "octave-cli does not run: {e}");
            eprintln!("SKIPPED: octave-cli does not run: {e}");
            None
        }
    }
}
