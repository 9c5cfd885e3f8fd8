//! Small numerical tools that several stages share.

pub(crate) mod banded;
pub(crate) mod cholesky;
mod scalar;

#[cfg(feature = "gpu")]
pub(crate) use scalar::ANGLE_COEFFICIENTS;
pub use scalar::Scalar;
