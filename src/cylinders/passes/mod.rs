//! The passes of a fit: plain functions over slices, generic over the number they compute in.
//!
//! Each is the twin of the shader of the same file name in `shaders/cylinders/`, in the same order of floating-point
//! operations.

mod bin;
mod distance;
mod fill;
mod filter;
mod measure_long;
mod measure_short;
mod parameters;
mod project;
mod scan_downsweep;
mod scan_reduce;
mod scan_spine;
mod scatter;
mod support;
mod update;

pub use bin::bin;
pub use distance::{Face, distance};
pub use fill::fill;
pub use measure_long::measure_long;
pub use measure_short::measure_short;
pub use parameters::{DeviceCylinder, Filter, FitParameters, Gate, NONE, TriangleStatistic, TubeGrid};
pub use project::{DevicePair, Section, TubeTransform, project};
pub use scan_downsweep::{LIST_HEAD, listed_faces, scan_downsweep};
pub use scan_reduce::scan_reduce;
pub use scan_spine::scan_spine;
pub use scatter::{grouped_point, scatter};
pub use support::support;
pub use update::update;
