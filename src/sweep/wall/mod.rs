//! The wall about the axis: robust penalised least squares for the radii, on residuals along the echoes' error ellipsoids.

pub(in crate::sweep) mod bending;
mod cpu;
pub(in crate::sweep) mod engine;
pub(in crate::sweep) mod equations;
pub(in crate::sweep) mod fit;
#[cfg(feature = "gpu")]
pub mod gpu;
mod multigrid;
#[cfg(feature = "gpu")]
mod on_device;
pub(in crate::sweep) mod operator;
pub mod passes;
pub(in crate::sweep) mod residual;
pub(in crate::sweep) mod solver;
