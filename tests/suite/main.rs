//! All tests from outside the crate, in one program: one module per area.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on stops there")]

mod support;

mod cylinder_estimate;
mod evaluate;
#[cfg(feature = "cli")]
mod evaluate_command;
mod golden;
mod recording;
#[cfg(feature = "cli")]
mod recording_command;
mod surface;
