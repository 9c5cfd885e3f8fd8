//! Shared data and tools that a test may lack, unless the environment requires them.

#[path = "data.rs"]
mod data;

use std::io::Write;
use std::path::PathBuf;

/// A file of the shared data. Where it is missing, `None` and a line on stderr; a failure where `LUMENMESH_REQUIRE_DATA`
/// is 1.
pub fn shared(path: &str) -> Option<PathBuf> {
    let file = data::shared_path(path);
    if file.exists() {
        return Some(file);
    }
    let what = format!("{} is missing (LUMENMESH_SHARED names the data's folder)", file.display());
    skipped(&what, "LUMENMESH_REQUIRE_DATA");
    None
}

/// Reports that a test leaves something out, even where it passes and the harness hides what `eprintln` writes; fails
/// where the variable is 1.
pub fn skipped(what: &str, required_by: &str) {
    let required = std::env::var(required_by).is_ok_and(|value| value == "1");
    assert!(!required, "{what}");
    let mut unseen_by_the_test_harness = std::io::stderr().lock();
    writeln!(unseen_by_the_test_harness, "SKIPPED: {what}").unwrap();
}
