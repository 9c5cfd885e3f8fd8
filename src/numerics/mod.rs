//! Small numerical tools that several stages share.

pub(crate) mod banded;
pub(crate) mod cholesky;
pub(crate) mod robust;
mod scalar;

#[cfg(feature = "gpu")]
pub(crate) use scalar::ANGLE_COEFFICIENTS;
pub use scalar::Scalar;
