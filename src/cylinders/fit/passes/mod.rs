//! The passes of a fit: plain functions over slices, one file each, generic over the number they compute in.
//!
//! A device pass has the same name and mirrors its statements.

mod distance;
mod fill;
mod filter;
mod group;
mod project;
mod support;
mod update;

pub use distance::{Face, distance};
pub use fill::fill;
pub use filter::{Filter, TriangleStatistic, filter};
pub use group::{Grid, Groups, group};
pub use project::{Gate, Section, TubeTransform, project};
pub use support::support;
pub use update::update;
