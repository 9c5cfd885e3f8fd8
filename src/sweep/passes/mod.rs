//! The steps of the wall's fit as plain functions in f32: twins of the shaders in `shaders/sweep/`, statement by
//! statement.
//!
//! The CPU fits in f64 on structures of its own; these functions say what a device has to compute, to the bit where it
//! rounds as they do. Lengths are mm; the wall's radii are measured from the job's `start`, so that f32 keeps their
//! digits, and all that the solver sees is in units of the noise.

mod echo;
mod job;
mod noise;

pub use echo::{FARTHEST_CELL, Sums, Way, accumulate, measure, way_to_wall};
pub use job::{Echo, Job, State};
pub use noise::{count_misses, pick_digit};
