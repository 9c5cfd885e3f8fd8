//! From tracked intravascular ultrasound to a 3D lumen mesh.
//!
//! Data flows one way: [`recording`] → [`cylinder`] → [`fit`] → [`merge`] → [`surface`] → [`evaluate`].
//! [`sweep`] is the other way from a recording to a surface.
//! Lengths are millimetres, angles radians, times seconds; indices count from 0.

pub mod bench;
#[cfg(feature = "cli")]
pub mod cli;
pub mod cylinder;
mod error;
pub mod evaluate;
pub mod experiments;
pub mod fit;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod live;
pub mod merge;
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
pub mod tube;

pub use error::{Error, Result};
