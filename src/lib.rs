//! From tracked intravascular ultrasound to a 3D lumen mesh.
//!
//! Data flows one way: [`recording`] → [`sweep`] or [`cylinders`] → [`surface`] → [`evaluate`].
//! Lengths are millimetres, angles radians, times seconds; indices count from 0.

#[cfg(feature = "cli")]
pub mod cli;
pub mod cylinders;
pub mod engine;
mod error;
pub mod evaluate;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod low_level;
mod numerics;
pub mod output;
pub mod reconstruction;
pub mod recording;
#[cfg(feature = "render")]
pub mod report;
pub mod settings;
pub mod simulate;
pub mod study;
pub mod surface;
pub mod sweep;

pub use error::{Error, Result};
