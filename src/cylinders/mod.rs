//! The published method: a cylinder mesh is fitted to the wall points about every so many frames, and successive
//! cylinders are merged into one vessel (thesis, chapter 3).
//!
//! Data flows one way: frames are placed in the world by a [`Track`], which asks an [`estimate`] for the cylinders
//! that the recording lacks; an [`Engine`] fits the cylinders; [`merge`] makes one vessel of them.

pub mod estimate;
pub(crate) mod fit;
pub(crate) mod live;
pub mod merge;
pub(crate) mod passes;
mod track;
mod tube;

#[cfg(feature = "gpu")]
pub use fit::gpu::GpuEngine;
pub use fit::{
    AutoEngine, CpuEngine, DeformedTube, Engine, Fit, FitRequest, FittedCylinder, SectionFit, engine,
    merged_frames,
};
pub use passes::Section;
pub use track::{NearFrame, PlacedCylinder, Track};
pub use tube::Tube;

use crate::engine::EngineDescription;
use crate::output::write_atomically;
use crate::recording::{LeftOut, Recording};
use crate::settings::{Settings, UnfitFrames};
use crate::{Error, Result};
use merge::MergedVessel;
use serde::Serialize;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// A vessel reconstructed by the published method.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct CylinderReconstruction {
    /// The deformed cylinders of the merged frames.
    pub cylinders: Vec<FittedCylinder>,
    /// The vessel.
    pub vessel: MergedVessel,
    /// What was done, in numbers.
    pub report: CylindersReport,
}

/// A reconstruction by cylinders in numbers.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct CylindersReport {
    /// The engine that fitted the cylinders.
    pub engine: EngineDescription,
    /// Threads that the CPU part could use.
    pub threads: usize,
    /// Frames of the recording.
    pub frames: usize,
    /// Frames whose cylinder was estimated, because the recording has none.
    pub estimated_cylinders: usize,
    /// Frames whose cylinders were to be merged, but have none or no points in its section.
    pub cylinders_left_out: Vec<LeftOut>,
    /// Cylinders fitted and merged.
    pub cylinders: usize,
    /// Rings of the vessel.
    pub rings: usize,
    /// Nodes of the vessel.
    pub nodes: usize,
    /// Triangles of the vessel.
    pub triangles: usize,
    /// Where the points went.
    pub points: PointCounts,
    /// Mean |travel| of the nodes in each iteration, over all cylinders, mm.
    pub mean_travel_mm: Vec<f64>,
    /// How long each stage took.
    pub seconds: CylindersTimings,
}

/// Where the points went. A point can lie in the sections of several cylinders and counts in each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct PointCounts {
    /// Wall points in the recording.
    pub recorded: u64,
    /// Rays without an echo.
    pub missing: u64,
    /// Points used, summed over the cylinders: in the section and kept by the filter in the last iteration.
    pub used: u64,
    /// Points in a section that the filter rejected in the last iteration, summed over the cylinders.
    pub rejected: u64,
    /// Points within a cylinder's height but outside its radial gate, summed over the cylinders.
    pub gated: u64,
}

/// Wall-clock time of each stage, in seconds.
#[derive(Debug, Clone, Copy, Default, Serialize)]
#[non_exhaustive]
pub struct CylindersTimings {
    /// Placing the frames in the world, with the estimate of cylinders where there are none.
    pub track: f64,
    /// Fitting the cylinders.
    pub fit: f64,
    /// Merging them.
    pub merge: f64,
}

impl CylinderReconstruction {
    /// Reconstructs the vessel of a recording by the published method: a cylinder every `every` frames, fitted by
    /// `engine`, and the cylinders merged as the settings say. [`Settings::method`] is ignored.
    ///
    /// # Errors
    /// Where settings are invalid, the recording has fewer than `every` frames, or a frame cannot be used.
    pub fn of(recording: &Recording, settings: &Settings, engine: &dyn Engine) -> Result<Self> {
        Self::run(recording, settings, engine, false, &|_, _| ControlFlow::Continue(()))
    }

    /// As [`of`](Self::of). With `history`, cylinders keep their radii of every iteration. `progress` is called with the
    /// number of cylinders that are ready and their total.
    ///
    /// # Errors
    /// As [`of`](Self::of).
    pub fn run(
        recording: &Recording,
        settings: &Settings,
        engine: &dyn Engine,
        history: bool,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<Self> {
        let in_time = |cylinders: &[FittedCylinder]| MergedVessel::of(cylinders, settings.merge);
        Self::merged_by(in_time, recording, settings, engine, history, progress)
    }

    /// As [`run`](Self::run), with the cylinders merged by a function of those in the order of their frames.
    pub(crate) fn merged_by(
        merged: impl FnOnce(&[FittedCylinder]) -> MergedVessel,
        recording: &Recording,
        settings: &Settings,
        engine: &dyn Engine,
        history: bool,
        progress: &(dyn Fn(usize, usize) -> ControlFlow<()> + Sync),
    ) -> Result<Self> {
        settings.validate()?;
        let start = Instant::now();
        let track = Track::of(recording, settings)?;
        let track_seconds = start.elapsed().as_secs_f64();

        // A frame without a contour, such as one that was left out, has no cylinder of its own and does not count.
        let seen: Vec<usize> =
            (0..track.len()).filter(|&k| recording.frames[k].echoes_mm().next().is_some()).collect();
        if seen.is_empty() {
            return Err(Error::Recording {
                field: "contours",
                found: format!("no echo in {} frames", track.len()),
                expected: "contours along a vessel".into(),
            });
        }
        let frames: Vec<usize> = merged_frames(seen.len(), settings).iter().map(|&k| seen[k]).collect();
        if frames.is_empty() {
            return Err(Error::Setting {
                name: "every".into(),
                found: settings.every.to_string(),
                expected: format!("at most the recording's {} frames with a contour", seen.len()),
            });
        }
        let start = Instant::now();
        let ready = AtomicUsize::new(0);
        let tell = |newly| progress(ready.fetch_add(newly, Ordering::Relaxed) + newly, frames.len());
        let request = FitRequest { track: &track, frames: &frames, settings, history, progress: &tell };
        let Fit { cylinders, mut left_out, engine } = engine.fit(&request)?;
        let fit_seconds = start.elapsed().as_secs_f64();
        if let Some(first) = left_out.first().filter(|_| settings.unfit_frames == UnfitFrames::Refuse) {
            return Err(first.clone().into_error());
        }
        left_out.iter_mut().for_each(|one| one.name(recording));

        let start = Instant::now();
        let vessel = merged(&cylinders);
        let merge_seconds = start.elapsed().as_secs_f64();

        if vessel.rings.len() < 2 {
            return Err(Error::Frame {
                frame: cylinders.last().map_or(0, |c| c.frame),
                field: "vessel",
                found: format!("{} rings that points support", vessel.rings.len()),
                expected: "at least 2 from all cylinders up to here".into(),
            });
        }
        let nodes: usize = vessel.rings.iter().map(|r| r.nodes_mm.len()).sum();
        let sum = |of: &dyn Fn(&FittedCylinder) -> u64| cylinders.iter().map(of).sum::<u64>();
        let rejected = sum(&|c| c.tube.rejected);
        let report = CylindersReport {
            engine,
            threads: rayon::current_num_threads(),
            frames: track.len(),
            estimated_cylinders: track.estimated_count(),
            cylinders_left_out: left_out,
            cylinders: cylinders.len(),
            rings: vessel.rings.len(),
            nodes,
            triangles: 2 * (nodes - settings.nodes as usize),
            points: PointCounts {
                recorded: track.echo_count() as u64,
                missing: track.missing_count(),
                used: sum(&|c| c.tube.points) - rejected,
                rejected,
                gated: sum(&|c| c.tube.gated),
            },
            mean_travel_mm: (0..settings.iterations as usize)
                .map(|i| cylinders.iter().map(|c| c.tube.travel_mm[i]).sum::<f64>() / cylinders.len() as f64)
                .collect(),
            seconds: CylindersTimings { track: track_seconds, fit: fit_seconds, merge: merge_seconds },
        };
        Ok(Self { cylinders, vessel, report })
    }
}

/// Writes every cylinder's radii after every iteration as CSV: `frame,iteration,ring,node,radius_mm`, frames
/// and indices from 0, iteration 0 the primitive. Numbers carry all their digits.
///
/// # Errors
/// [`Error::Write`].
pub fn write_cylinders<'a>(
    cylinders: impl IntoIterator<Item = &'a FittedCylinder>,
    path: &Path,
) -> Result<()> {
    write_atomically(path, |out| {
        let mut table = csv::Writer::from_writer(out);
        table.write_record(["frame", "iteration", "ring", "node", "radius_mm"])?;
        for cylinder in cylinders {
            let count = cylinder.tube.tube.nodes;
            for (iteration, radii) in cylinder.tube.history_mm.iter().enumerate() {
                for (index, radius) in radii.iter().enumerate() {
                    let numbers = [cylinder.frame, iteration, index / count, index % count];
                    let numbers = numbers.map(|number| number.to_string());
                    table.write_record(numbers.iter().chain([&format!("{radius:.12}")]))?;
                }
            }
        }
        table.flush()
    })
}
