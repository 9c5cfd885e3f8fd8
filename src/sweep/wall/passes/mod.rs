//! The steps of the wall's fit as plain functions in f32: twins of the shaders in `shaders/sweep/`, statement by
//! statement.
//!
//! The CPU fits in f64 on structures of its own; these functions say what a device has to compute, to the bit where it
//! rounds as they do. Lengths are mm; the wall's radii are measured from the job's `start`, so that f32 keeps their
//! digits, and all that the solver sees is in units of the noise.

mod bending;
mod blocks;
mod echo;
mod equations;
mod gradients;
mod job;
mod noise;
mod sum;
mod transform;

pub use bending::bending;
pub use blocks::{Factors, couple, eliminate, substitute};
pub use echo::{FARTHEST_CELL, Sums, Way, accumulate, measure, way_to_wall};
pub use equations::{aim, apply, assemble, weigh_rings};
pub use gradients::{advance, move_wall, redirect, stride, turn};
pub use job::{Echo, Job, State};
pub use noise::{count_misses, pick_digit};
pub use sum::{sum_of_partials, sum_of_workgroup};
pub use transform::{join_values, join_waves, part, waves};
