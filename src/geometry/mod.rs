//! Poses, frames along curves, polylines, polygons and triangles.

pub(crate) mod polygon;
pub(crate) mod polyline;
mod pose;
mod spline;
mod transport;
pub(crate) mod triangle;

pub use pose::Pose;
pub(crate) use spline::NaturalSpline;
pub use transport::rotation_minimising_frames;
pub(crate) use transport::transported;
