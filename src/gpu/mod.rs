//! What every engine on a device shares: adapters and devices, the form of a pass, named buffers, and calls whose errors
//! come back as values.
//!
//! What is computed there is the business of [`fit::gpu`](crate::cylinders::fit::gpu) and [`sweep::gpu`](crate::sweep::wall::gpu).

mod buffers;
mod context;
mod error;
pub(crate) mod shader;

pub use context::{AdapterDescription, Requirements, adapters};
pub use error::GpuError;

pub(crate) use buffers::Buffers;
pub(crate) use context::{Context, checked};
pub(crate) use shader::{Access, Binding, Pass, Pipeline, Shader, constants};
