//! Merging fitted cylinders into one vessel.

mod stitch;

pub use stitch::{Ring, Stitched};
