//! Frames as they come, and the vessel to whoever follows it: what `lumenmesh live` is made of.
//!
//! A [`Source`] gives frames: a recording at its own pace, or a [`Queue`] that threads fill from a pipe or a
//! network. [`run`] takes them one by one to a [`Live`](crate::reconstruction::Live) vessel and hands every
//! change to the [`Sink`]s: the page, 3D Slicer, files, a log. No sink may wait for anyone.

mod arrivals;
mod files;
mod log;
mod page;
mod queue;
mod run;
mod slicer;
mod source;
mod times;
mod update;

pub(crate) use arrivals::ArrivalsReport;
pub(crate) use files::Files;
pub(crate) use log::FrameLog;
pub(crate) use page::PageServer;
pub(crate) use queue::{Faults, Queue, WhenFull};
pub(crate) use run::{Ended, Outcome, run};
pub(crate) use slicer::Slicer;
pub(crate) use source::{Recorded, Source, connect, listen, read_lines, take_messages};
pub(crate) use times::{Percentiles, Stages, TimesReport, peak_memory_bytes};
pub(crate) use update::{End, Sink};
