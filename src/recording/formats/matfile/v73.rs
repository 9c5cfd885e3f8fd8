//! Reader of MAT-files of version 7.3.

use super::Fields;
use crate::{Error, Result};
use std::path::Path;

pub(super) fn read(path: &Path, _: Vec<u8>, _: &[&str]) -> Result<Fields> {
    Err(Error::input(path, "format", "version 7.3 (HDF5)", super::FORMATS))
}
