//! Arbitrary input to everything that reads: each file format, settings, frames on a stream. Whatever comes in, the answer
//! is a value or an error, in bounded time and memory; never a panic.
//!
//! Inputs are valid files that a seeded generator has mutated, `LUMENMESH_FUZZ_INPUTS` of them for each reader (2,000 by
//! default; before a release 1,000,000). An input that panics is reported with its number, which makes it again. What has
//! been found stays as a test of its own.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on stops there")]

mod frames;
mod meshes;
mod mutate;
mod openigtlink;
mod recordings;
mod settings;
mod snapshots;
