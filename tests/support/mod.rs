//! What several test files share: the data that lies outside the repository.

use std::path::{Path, PathBuf};

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
