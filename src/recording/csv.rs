//! A folder of CSV files.
use super::Recording;
use crate::Result;
use std::path::Path;
pub(super) fn read(_path: &Path) -> Result<Recording> {
    todo!()
}
pub(super) fn write(_recording: &Recording, _path: &Path) -> Result<()> {
    todo!()
}
