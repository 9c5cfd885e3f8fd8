//! The files that hold recordings.

pub(super) mod csv;
pub(super) mod mat;
mod mat5;
mod table;

pub(crate) use table::Table;
