//! Poses and the algebra of frames of reference.

pub(crate) mod polyline;
mod pose;
mod spline;
mod transport;

pub use pose::Pose;
pub(crate) use spline::NaturalSpline;
pub use transport::rotation_minimising_frames;
pub(crate) use transport::transported;
