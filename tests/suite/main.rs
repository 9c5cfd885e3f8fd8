//! All tests from outside the crate, in one program: one module per area.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on stops there")]

mod support;

#[cfg(feature = "cli")]
mod anatomy;

#[cfg(feature = "cli")]
mod batch;
mod blend;
#[cfg(feature = "cli")]
mod branching;
mod calibration;
#[cfg(feature = "cli")]
mod coronary;
mod cylinder_estimate;
mod evaluate;
#[cfg(feature = "cli")]
mod evaluate_command;
#[cfg(feature = "cli")]
mod experiments;
#[cfg(feature = "cli")]
mod faults;
#[cfg(feature = "cli")]
mod flow;
mod golden;
#[cfg(feature = "cli")]
mod import;
mod layers;
mod live;
mod live_branches;
#[cfg(all(feature = "cli", unix))]
mod live_command;
#[cfg(feature = "cli")]
mod matlab;
#[cfg(all(feature = "cli", feature = "mcap"))]
mod mcap;
mod mesh_files;
mod method;
mod motion;
#[cfg(feature = "cli")]
mod mouths;
#[cfg(feature = "cli")]
mod ndjson;
mod openigtlink;
#[cfg(all(feature = "cli", unix))]
mod outputs;
#[cfg(feature = "cli")]
mod reconstruct_command;
mod recording;
#[cfg(feature = "cli")]
mod recording_command;
#[cfg(feature = "render")]
mod render;
mod screening;
#[cfg(feature = "cli")]
mod sequences;
#[cfg(feature = "cli")]
mod simulate;
#[cfg(feature = "cli")]
mod stdout;
mod surface;
mod sweep;
mod tracker;
