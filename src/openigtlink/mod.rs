//! OpenIGTLink, the protocol between trackers, PLUS and 3D Slicer: frames come in, the vessel goes out.
//!
//! ```text
//! PLUS ───► client ─┐                                        ┌─► Slicer
//!                   ├─► Source: messages → frames → Live → Server ─► Slicer
//! a program ► server┘
//! ```
//!
//! A [`Source`] takes messages from any number of connections and joins poses and contours to frames by their
//! times; a [`Server`] sends the vessel, the catheter's tip and texts to whoever is connected. Connections
//! run on threads of their own and keep to 127.0.0.1 unless an address says otherwise.
//!
//! Versions 1 to 3 of the protocol (headers 1 and 2, with metadata) are understood. Sizes are checked before
//! anything is allocated, and a body is never trusted to be as long as it says.

mod assembler;
mod client;
mod content;
mod crc64;
mod image;
mod message;
mod poly_data;
mod queue;
mod server;
mod source;
mod stream;
mod strips;
mod time;
mod wire;

pub use assembler::{AssemblerOptions, FrameAssembler, FrameCounts};
pub use content::{Content, Status, Tool};
pub use image::ImageContent;
pub use message::{HEADER_BYTES, Header, MAX_BODY_BYTES, Message};
pub use poly_data::PolyData;
pub use queue::Traffic;
pub use server::{MAX_CLIENTS, Server, ServerOptions};
pub use source::{Counts, SharedCounts, Source, SourceOptions, Stopper};
pub use stream::{MAX_SKIPPED_BYTES, MessageReader, Step};
pub use time::Timestamp;
