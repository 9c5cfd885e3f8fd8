//! Small numerical tools that several stages share.

mod angle;
pub(crate) mod banded;
pub(crate) mod cholesky;
pub(crate) mod graph;
pub(crate) mod nonnegative;
pub(crate) mod robust;
mod scalar;
mod scan;
mod simd;

#[cfg(feature = "gpu")]
pub(crate) use angle::ANGLE_COEFFICIENTS;
pub use scalar::Scalar;
pub use scan::inclusive_scan;
pub(crate) use simd::vectorized;
