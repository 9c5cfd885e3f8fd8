//! File formats of recordings.

pub(super) mod csv;
pub(super) mod mat;
mod mat5;
mod table;

pub(crate) use table::Table;
