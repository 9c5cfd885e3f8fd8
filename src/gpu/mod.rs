//! Parts that every engine on a device shares: adapters and devices, the form of a pass, named buffers, and
//! calls whose errors come back as values.
//!
//! The passes themselves belong to [`cylinders`](crate::cylinders) and [`sweep`](crate::sweep).

mod buffers;
mod context;
mod error;
mod runner;
pub(crate) mod shader;
mod transfers;

pub use context::{AdapterDescription, Requirements, adapters, instance};
pub use error::GpuError;
pub use runner::PassTimes;

pub(crate) use buffers::Buffers;
pub(crate) use context::{Context, Job, LARGE_WORKGROUP, NARROW_WORKGROUP, Spent, checked};
pub(crate) use runner::{ReadyPass, Runner, Timer, dispatch_size};
pub(crate) use shader::{Access, Binding, Pass, Pipeline, Shader, constants};
