//! Estimates of the local cylinder of a frame: the straight piece of vessel about it, for recordings that carry none.

mod follow;
pub(crate) mod local_tube;
mod unscented;
mod upright;
mod window;

pub use unscented::UnscentedFilter;
pub use upright::{CylinderEstimator, Upright};
pub use window::WindowFit;

/// The estimator of frames without a model, wherever none is named.
pub type LocalEstimate = WindowFit;
