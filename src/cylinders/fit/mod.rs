//! The local fit: a cylinder mesh deformed to the wall points about one frame (M. M. Ainchil Cayuela, master
//! thesis, UPC / KU Leuven, 2023, section 3.2; docs/method.md, "Local cylinder fit").
//!
//! A [`Track`] holds the frames; an [`Engine`] fits the cylinders that a [`FitRequest`] names. Engines differ in
//! the processor and the precision, not in the method: its steps are the [`passes`](super::passes).

mod auto;
mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
mod groups;

pub use auto::AutoEngine;
pub use cpu::CpuEngine;
pub use groups::{Groups, group};

use super::passes::Section;
use super::track::Track;
use super::tube::Tube;
use crate::engine::EngineDescription;
use crate::geometry::Pose;
use crate::recording::{LeftOut, MAX_RADIUS_MM, Reason};
#[cfg(not(feature = "gpu"))]
use crate::settings::no_gpu_engine;
use crate::settings::{Backend, Settings};
use crate::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// What is called with the number of cylinders finished since the last call, and says whether to go on.
pub type FitProgress<'a> = dyn Fn(usize) -> ControlFlow<()> + Sync + 'a;

/// The cylinders that an engine fits, and how.
#[derive(Clone, Copy)]
#[non_exhaustive]
pub struct FitRequest<'a> {
    /// Where the points come from.
    pub track: &'a Track,
    /// The frames whose cylinders are fitted.
    pub frames: &'a [usize],
    /// The settings, valid.
    pub settings: &'a Settings,
    /// Whether to keep the radii after every iteration, not only after the last.
    pub history: bool,
    /// Called with the number of cylinders finished since the last call; the fit ends soon after a call that breaks.
    pub progress: &'a FitProgress<'a>,
}

impl<'a> FitRequest<'a> {
    /// A request without history that reports no progress.
    pub fn new(track: &'a Track, frames: &'a [usize], settings: &'a Settings) -> Self {
        Self { track, frames, settings, history: false, progress: &|_| ControlFlow::Continue(()) }
    }

    /// Keeps the radii after every iteration, or only after the last.
    #[must_use]
    pub fn with_history(mut self, history: bool) -> Self {
        self.history = history;
        self
    }

    /// Calls `progress` with the number of cylinders finished since the last call, from any thread. Where a call breaks, the
    /// fit ends soon with [`Error::Cancelled`](crate::Error::Cancelled).
    #[must_use]
    pub fn with_progress(mut self, progress: &'a FitProgress<'a>) -> Self {
        self.progress = progress;
        self
    }
}

/// The frames whose cylinders are merged: every `every`-th, counted from the first (9, 19, 29, … for 10).
pub fn merged_frames(frame_count: usize, settings: &Settings) -> Vec<usize> {
    let every = settings.every as usize;
    (every - 1..frame_count).step_by(every).collect()
}

/// The engine that the settings name.
///
/// # Errors
/// [`Error::Gpu`] where the settings demand a device and there is none.
pub fn engine(settings: &Settings) -> Result<Box<dyn Engine>> {
    Ok(match settings.backend {
        Backend::Auto => Box::new(AutoEngine::default()),
        Backend::Cpu => Box::new(CpuEngine::<f32>::new()),
        Backend::Reference => Box::new(CpuEngine::<f64>::new()),
        #[cfg(feature = "gpu")]
        Backend::Gpu => Box::new(gpu::GpuEngine::new(settings.adapter.as_deref())?),
        #[cfg(not(feature = "gpu"))]
        Backend::Gpu => return Err(no_gpu_engine()),
    })
}

/// Largest coordinate of a point in a section from outside.
const MAX_COORDINATE: f32 = 1e9;

/// Refuses points or a radius from outside that are not finite, or a radius that is not positive.
fn check_section(section: &Section<f32>, radius_mm: f64) -> Result<()> {
    let fail =
        |field, found, expected: &str| Err(Error::Section { field, found, expected: expected.to_owned() });
    // Squares and products of what passes are finite in single precision.
    if !(0.0 < radius_mm && radius_mm <= MAX_RADIUS_MM) {
        return fail("radius_mm", radius_mm.to_string(), "more than 0 and at most 10000 mm");
    }
    let count = section.len();
    for (field, values) in [("r", &section.r), ("theta", &section.theta), ("z", &section.z)] {
        if values.len() != count {
            return fail(field, format!("{} numbers", values.len()), &format!("{count}, as many as r"));
        }
        // Whole pieces first, without a decision in between: a device fits ten million points sooner than one
        // thread would look at them one by one.
        let within = |piece: &[f32]| piece.iter().fold(true, |all, x| all & (x.abs() <= MAX_COORDINATE));
        if !values.par_chunks(1 << 16).all(within)
            && let Some(point) = values.iter().position(|x| x.is_nan() || x.abs() > MAX_COORDINATE)
        {
            return fail(field, format!("{} at point {point}", values[point]), "finite numbers, at most 1e9");
        }
    }
    Ok(())
}

mod sealed {
    /// Only the engines of this crate implement [`Engine`](super::Engine), so that it may gain methods.
    pub trait Sealed {}
}

/// Fits cylinders. The engines are [`CpuEngine`], [`AutoEngine`] and, in builds with the feature `gpu`, `GpuEngine`.
pub trait Engine: sealed::Sealed + Send + Sync {
    /// Fits the cylinders of a request, in the order of its frames. Frames without a cylinder or without points in its
    /// section are left out.
    ///
    /// # Errors
    /// Where all frames are left out, and where the engine itself fails.
    fn fit(&self, request: &FitRequest) -> Result<Fit>;

    /// Fits one tube of that radius to points that already are in its coordinates and within its gate.
    ///
    /// # Errors
    /// Where a number is not finite or the radius not positive, and where the engine itself fails.
    fn fit_section(&self, section: &Section<f32>, radius_mm: f64, settings: &Settings) -> Result<SectionFit>;
}

/// The cylinders of a request.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Fit {
    /// The cylinders, in the order of the request's frames.
    pub cylinders: Vec<FittedCylinder>,
    /// The frames without one, and why.
    pub left_out: Vec<LeftOut>,
    /// The engine that fitted them, and why this one where it was chosen.
    pub engine: EngineDescription,
}

impl Fit {
    /// Sorts the frames' cylinders from the reasons why there is none.
    ///
    /// # Errors
    /// The first error that is not about a frame; where no frame has a cylinder, the first reason.
    fn of(
        fitted: impl IntoIterator<Item = Result<FittedCylinder>>,
        engine: EngineDescription,
    ) -> Result<Self> {
        let (mut cylinders, mut left_out) = (Vec::new(), Vec::new());
        for fitted in fitted {
            match fitted {
                Ok(cylinder) => cylinders.push(cylinder),
                Err(error) => left_out.push(LeftOut::because(error, Reason::NoCylinder)?),
            }
        }
        match left_out.first() {
            Some(first) if cylinders.is_empty() => Err(first.clone().into_error()),
            _ => Ok(Self { cylinders, left_out, engine }),
        }
    }
}

/// The tube of a section.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SectionFit {
    /// The tube.
    pub tube: DeformedTube,
    /// The engine that fitted it, and why this one where it was chosen.
    pub engine: EngineDescription,
}

/// A tube after its fit.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DeformedTube {
    /// Its topology.
    pub tube: Tube,
    /// Radius of the primitive, mm.
    pub radius_mm: f64,
    /// Radii after the last iteration, node after node, mm.
    pub radii_mm: Vec<f64>,
    /// Radii after each iteration, the primitive first; empty unless asked for.
    pub history_mm: Vec<Vec<f64>>,
    /// Mean |travel| of the nodes in each iteration, mm.
    pub travel_mm: Vec<f64>,
    /// Per node: points kept in the last iteration on the triangles that meet there.
    pub support: Vec<u32>,
    /// Per node: mean |distance| of those points in the last iteration, mm; NaN without points.
    pub residual_mm: Vec<f64>,
    /// Points in the section.
    pub points: u64,
    /// Points within the height but outside the radial gate.
    pub gated: u64,
    /// Points that the filter dropped in the last iteration.
    pub rejected: u64,
}

impl DeformedTube {
    /// A tube that no point has deformed: every radius is that of the primitive.
    pub fn primitive(tube: Tube, radius_mm: f64) -> Self {
        let nodes = tube.node_count();
        Self {
            tube,
            radius_mm,
            radii_mm: vec![radius_mm; nodes],
            history_mm: Vec::new(),
            travel_mm: Vec::new(),
            support: vec![0; nodes],
            residual_mm: vec![f64::NAN; nodes],
            points: 0,
            gated: 0,
            rejected: 0,
        }
    }
}

/// The deformed cylinder of a frame.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FittedCylinder {
    /// The frame (0-based).
    pub frame: usize,
    /// `wTcyl`; the long axis is x.
    pub world_from_cylinder: Pose,
    /// Its mesh.
    pub tube: DeformedTube,
}

impl FittedCylinder {
    /// A tube, placed in the world.
    pub fn new(frame: usize, world_from_cylinder: Pose, tube: DeformedTube) -> Self {
        Self { frame, world_from_cylinder, tube }
    }

    /// Node positions in the world, mm, for the given radii: ring after ring.
    pub fn nodes_mm<'a>(&'a self, radii_mm: &'a [f64]) -> impl Iterator<Item = DVec3> + 'a {
        let tube = &self.tube.tube;
        radii_mm.iter().enumerate().map(move |(node, r)| {
            let z = tube.ring_z_mm(node / tube.nodes);
            let (sin, cos) = tube.node_theta_rad(node % tube.nodes).sin_cos();
            // Tube axes back to {cyl}: X = -qz, Y = qy, Z = qx.
            self.world_from_cylinder.transform_point(DVec3::new(z, r * sin, -r * cos))
        })
    }
}
