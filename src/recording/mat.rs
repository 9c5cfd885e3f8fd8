//! MATLAB `.mat` files.
use super::Recording;
use crate::Result;
use std::path::Path;
pub(super) fn read_by_ending(_path: &Path) -> Result<Recording> {
    todo!()
}
pub(super) fn write(_recording: &Recording, _path: &Path) -> Result<()> {
    todo!()
}
