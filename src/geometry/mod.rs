//! Poses and the algebra of frames of reference.

mod pose;
mod transport;

pub use pose::Pose;
pub use transport::rotation_minimising_frames;
pub(crate) use transport::transported;
