//! From tracked intravascular ultrasound to a 3D mesh of the vessel's lumen.
//!
//! A catheter carries an ultrasound probe, which gives a contour of the vessel wall in each frame, and an electromagnetic
//! tracker, which gives the probe's pose. This crate turns such a recording into a triangle mesh, on the CPU or on a GPU,
//! and measures how far the mesh is from the truth where that is known.
//!
//! Lengths are in millimetres, angles in radians, times in seconds; indices count from 0. A pose named `a_from_b` takes
//! coordinates in `b` to coordinates in `a`.
//!
//! ```
//! use lumenmesh::evaluate::{Truth, evaluate};
//! use lumenmesh::reconstruction::Reconstructor;
//! use lumenmesh::settings::Settings;
//! use lumenmesh::simulate::{Phantom, Shape, Simulation};
//!
//! // A recording whose truth is known. `Recording::read("pullback.mat".as_ref())?` reads one from a file.
//! let vessel = Phantom::from("cylinder".parse::<Shape>()?).vessel()?;
//! let simulation = Simulation::run(vessel, &Default::default())?;
//!
//! let lumen = Reconstructor::new(Settings::default()).run(&simulation.recording)?;
//! let mesh = lumen.surface();
//! let folder = tempfile::tempdir().unwrap();
//! mesh.write(&folder.path().join("vessel.vtp"))?;
//!
//! let truth = Truth::new(simulation.vessel.surface().clone())?;
//! let fitting_error_mm = evaluate(&mesh, &truth)?.mesh_to_truth.mean_mm;
//! assert!(fitting_error_mm < 0.2);
//! # Ok::<(), lumenmesh::Error>(())
//! ```
//!
//! # Map
//!
//! Data flows in one direction, and a module uses only modules above it in this table.
//!
//! | module | what it holds |
//! |---|---|
//! | [`geometry`] | poses, rotation-minimising frames, polylines |
//! | [`gpu`] | adapters, devices, what the engines require of them |
//! | [`recording`] | recordings, frames, cylinder models; `.mat` files, CSV folders, untracked pullbacks |
//! | [`surface`] | triangle surfaces with arrays per node; VTP, PLY, STL, OBJ, legacy VTK |
//! | [`openigtlink`] | messages of OpenIGTLink: bytes to poses, meshes and texts, and back |
//! | [`settings`] | every setting, with its default, its limits and a TOML form |
//! | [`engine`] | where work is computed, and why there |
//! | [`cylinders`] | the published method: cylinders fitted to the wall points about a frame, then merged |
//! | [`sweep`] | the default method: one smooth tube along the vessel's axis, fitted to all echoes |
//! | [`branching`] | vessels that branch: the branches that were visited, swept and joined |
//! | [`reconstruction`] | [`Reconstructor`](reconstruction::Reconstructor) for whole recordings, [`Live`](reconstruction::Live) for one frame at a time |
//! | [`evaluate`] | distances to a truth surface, volumes |
//! | [`anatomy`] | a vessel's axis, cross-sections, stenoses and aneurysms |
//! | [`flow`] | meshes to simulate flow in: remeshed, with flat ends, extensions, caps and numbered faces |
//! | [`simulate`] | recordings whose truth is known |
//! | [`study`] | the thesis's experiments, resolution against error and time, benches |
//! | [`report`] | pictures, plots and pages |
//! | [`low_level`] | single passes and their device memory, without promises about versions |
//!
//! The mathematics is in `docs/method.md` of the source, results are in `docs/accuracy.md`.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod anatomy;
pub mod branching;
#[cfg(feature = "cli")]
pub mod cli;
pub mod cylinders;
pub mod engine;
mod error;
pub mod evaluate;
pub mod flow;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod low_level;
mod matfile;
mod numerics;
pub mod openigtlink;
pub mod output;
pub mod reconstruction;
pub mod recording;
#[cfg(feature = "render")]
pub mod report;
mod setters;
pub mod settings;
pub mod simulate;
#[cfg(feature = "cli")]
mod stream;
pub mod study;
pub mod surface;
pub mod sweep;
mod text;

pub use error::{Error, Result};
/// The vectors and matrices in this crate's signatures.
pub use glam;
/// The devices, queues and encoders in this crate's signatures.
#[cfg(feature = "gpu")]
pub use wgpu;

/// Compiles and runs the code in the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// Compiles the code on the page for hosts in Rust.
#[cfg(doctest)]
#[doc = include_str!("../docs/hosts/rust.md")]
struct RustHosts;
