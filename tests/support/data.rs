//! The folder of shared data, for tests, benches and examples.

use std::path::PathBuf;

/// A file of the shared data, whether it exists or not: `LUMENMESH_SHARED` names the folder, `../shared` by default.
pub fn shared_path(path: &str) -> PathBuf {
    std::env::var_os("LUMENMESH_SHARED").map_or_else(|| "../shared".into(), PathBuf::from).join(path)
}
