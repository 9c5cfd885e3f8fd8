//! Local fit.
