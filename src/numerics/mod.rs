//! Small numerical tools that several stages share.

pub(crate) mod banded;
pub(crate) mod cholesky;
mod scalar;
mod scan;

#[cfg(feature = "gpu")]
pub(crate) use scalar::ANGLE_COEFFICIENTS;
pub use scalar::Scalar;
pub use scan::inclusive_scan;
