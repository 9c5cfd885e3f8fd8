//! The sweep while the recording goes on: every frame changes the wall about it, in bounded time.
//!
//! Instead of all echoes at once, it fits a window of rings about the newest echoes, and a background window that moves
//! along the vessel to bring earlier results to the current noise and smoothness. Within a window, residuals are evaluated
//! again where the wall has moved most since (as iSAM2 relinearises: Kaess et al., IJRR 31(2), 2012), and the wall is
//! solved for with all rings outside fixed. See `docs/method.md`, "Live".

mod band;
mod curve;
mod running_median;
mod vessel;

use super::prepare::centreline::centreline;
use super::prepare::contour::{MAX_FOLDED, Outline};
use super::prepare::noise::{TANGENTIAL_PER_JUMP, outward_bias_mm};
use super::prepare::resolution::resolution;
use super::surface::surface;
use crate::geometry::polyline::lengths;
use crate::recording::echo_error::angle_jumps_mm;
use crate::recording::{FRAME_INTERVAL_S, Frame};
use crate::settings::Settings;
use crate::surface::Surface;
use crate::{Error, Result};
use curve::Curve;
use glam::{DVec2, DVec3};
use running_median::RunningMedian;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::ops::Range;
use std::time::Instant;
pub(crate) use vessel::Step;
use vessel::{GrowingVessel, PlacedFrame};

/// Largest number of frames that wait until the contours cover a lumen's radius of the vessel; beyond it every second one
/// is dropped.
const MAX_WAITING: usize = 128;
/// Echoes that a vessel begins with, and waiting ones that every later frame brings along.
const FIRST_ECHOES: usize = 2048;
const FED_ECHOES: usize = 256;
/// The vessel begins when the contours' centres lie this many lumen radii apart.
const START_RADII: f64 = 1.5;

/// A vessel swept along its centreline while the recording goes on.
#[derive(Serialize, Deserialize)]
pub(crate) struct LiveSweep {
    #[serde(skip)]
    settings: Settings,
    frames: usize,
    clock_s: f64,
    /// Frames from before the vessel began, the oldest first: a few of them come with every frame after that.
    waiting: VecDeque<PlacedFrame>,
    /// Running medians of the contours' radii and of their [angle jumps](angle_jumps_mm).
    contours: RunningMedian,
    jumps: RunningMedian,
    vessel: Option<GrowingVessel>,
}

impl LiveSweep {
    pub fn new(settings: &Settings) -> Self {
        Self {
            settings: settings.clone(),
            frames: 0,
            clock_s: 0.0,
            waiting: VecDeque::new(),
            contours: RunningMedian::new(),
            jumps: RunningMedian::new(),
            vessel: None,
        }
    }

    /// Forgets all frames.
    pub fn reset(&mut self) {
        *self = Self::new(&self.settings);
    }

    /// Goes on with a state that was read from a file; what follows it there. `None` where it is not sound, or of other
    /// settings: then nothing changes.
    pub fn go_on<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let (state, rest) = postcard::take_from_bytes::<Self>(bytes).ok()?;
        let sound = state.waiting.len() <= MAX_WAITING
            && state.contours.holds(std::iter::empty())
            && state.jumps.holds(std::iter::empty())
            && state.vessel.as_ref().is_none_or(|vessel| vessel.is_sound(&self.settings));
        sound.then(|| *self = Self { settings: std::mem::take(&mut self.settings), ..state })?;
        Some(rest)
    }

    /// Adds a frame that passes [`Frame::check`]; its number is higher than those before.
    pub fn push(&mut self, number: usize, frame: &Frame) -> Result<Step> {
        let after = self.clock_s + if self.frames == 0 { 0.0 } else { FRAME_INTERVAL_S };
        self.clock_s = frame.time_s.unwrap_or(after);
        let world_from_probe = frame.world_from_sensor * self.settings.calibration.sensor_from_probe();
        let mut placed = PlacedFrame {
            number: number as u32,
            time_s: self.clock_s,
            world_from_probe,
            frame: frame.clone(),
            outline: Outline::of(frame),
        };
        if placed.outline.is_some_and(|outline| outline.folded_share > MAX_FOLDED) {
            // Not star-shaped about its centre.
            placed.frame.contour_mm.clear();
            placed.outline = None;
        }
        self.frames += 1;
        if let Some(radius) = placed.outline.map(|outline| outline.radius_mm).filter(|radius| *radius > 0.0) {
            self.contours.add(radius);
        }
        angle_jumps_mm(&placed.frame.contour_mm).for_each(|jump| {
            self.jumps.add(jump);
        });
        let radius_mm = self.contours.value();
        if let Some(vessel) = &mut self.vessel {
            vessel.grid.arc_mm = TAU * radius_mm / vessel.grid.nodes as f64;
            // On a thread of the pool, so that none of the many short tasks has to be handed over to it.
            let earlier = fed(&mut self.waiting, FED_ECHOES);
            return rayon::scope(|_| vessel.push(&placed, &earlier));
        }
        self.waiting.push_back(placed);
        if self.waiting.len() > MAX_WAITING {
            let mut count = 0;
            self.waiting.retain(|_| {
                count += 1;
                count % 2 == 1
            });
        }
        self.start(radius_mm)
    }

    /// Starts the vessel once its contours cover a length.
    fn start(&mut self, radius_mm: f64) -> Result<Step> {
        let centres: Vec<DVec3> = self.waiting.iter().filter_map(PlacedFrame::centre_mm).collect();
        let (low, high) = centres
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        if radius_mm <= 0.0 || centres.is_empty() || low.distance(high) < START_RADII * radius_mm {
            return Ok(Step::default());
        }
        let start = Instant::now();
        let Some(curve) = centreline(&centres, radius_mm)? else { return Ok(Step::default()) };
        let length_mm = lengths(&curve).last().copied().unwrap_or(0.0);
        let contours_mm: Vec<&[DVec2]> =
            self.waiting.iter().map(|placed| &placed.frame.contour_mm[..]).collect();
        // As for infinite noise: a finer grid would take longer than a frame may.
        let resolution = resolution(&contours_mm, length_mm, radius_mm, f64::INFINITY, &self.settings);
        let (nodes, step_mm) = match resolution {
            // Frames that lie too far apart wait for others between them.
            Err(Error::Recording { .. }) => return Ok(Step::default()),
            resolution => resolution?,
        };
        let curve = Curve::along(&curve, &centres, radius_mm);
        let mut vessel = GrowingVessel::along(curve, nodes, step_mm, radius_mm, &self.settings);
        let axis_s = start.elapsed().as_secs_f64();
        // As many as a frame has time for, evenly spread.
        let echoes: usize = self.waiting.iter().map(PlacedFrame::echo_count).sum();
        let (mut seen, mut taken) = (0, 0);
        let (first, later) =
            std::mem::take(&mut self.waiting).into_iter().partition::<VecDeque<_>, _>(|frame| {
                seen += frame.echo_count();
                let is_due = taken * echoes <= seen * FIRST_ECHOES.min(echoes);
                taken += if is_due { frame.echo_count() } else { 0 };
                is_due
            });
        self.waiting = later;
        let step = Step { axis_s, ..vessel.start(&Vec::from(first))? };
        self.vessel = Some(vessel);
        Ok(step)
    }

    /// Adds what still waits from before the vessel began, and fits the whole wall. After the last frame: it takes longer than
    /// a frame may.
    pub fn flush(&mut self) -> Result<Step> {
        let Some(vessel) = &mut self.vessel else { return Ok(Step::default()) };
        vessel.finish(&fed(&mut self.waiting, usize::MAX))
    }

    /// Number of rings.
    pub fn rings(&self) -> usize {
        self.vessel.as_ref().map_or(0, |vessel| vessel.grid.rings)
    }

    /// Nodes per ring.
    pub fn nodes(&self) -> usize {
        self.vessel.as_ref().map_or(0, |vessel| vessel.grid.nodes)
    }

    /// Some rings as a surface.
    pub fn surface(&self, rings: Range<usize>, keep_unsupported: bool) -> Surface {
        let Some(vessel) = &self.vessel else { return Surface::default() };
        let tangential_mm = (TANGENTIAL_PER_JUMP * self.jumps.value()).min(vessel.noise_mm());
        let radius = |node: usize| {
            let radius = vessel.radii_mm[node];
            radius - outward_bias_mm(radius, tangential_mm)
        };
        surface(&vessel.axis, vessel.grid.nodes, rings, &vessel.support, radius, keep_unsupported)
    }
}

/// Takes the frames that waited longest, of at least so many echoes.
fn fed(waiting: &mut VecDeque<PlacedFrame>, echoes: usize) -> Vec<PlacedFrame> {
    let mut taken = 0;
    let is_enough = |frame: &PlacedFrame| {
        let is_enough = taken >= echoes;
        taken += frame.echo_count();
        is_enough
    };
    let count = waiting.iter().position(is_enough).unwrap_or(waiting.len());
    waiting.drain(..count).collect()
}
