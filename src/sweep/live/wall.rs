//! The wall about one axis: of the vessel that was seen first, or of a branch.

use super::curve::Curve;
use super::running_median::RunningMedian;
use super::vessel::{About, GrowingVessel, PlacedFrame, Step};
use crate::geometry::polyline::lengths;
use crate::recording::echo_error::angle_jumps_mm;
use crate::settings::Settings;
use crate::surface::Surface;
use crate::sweep::prepare::centreline::centreline;
use crate::sweep::prepare::noise::{TANGENTIAL_PER_JUMP, most_tangential_mm, outward_bias_mm};
use crate::sweep::prepare::resolution::resolution;
use crate::sweep::surface::surface;
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, VecDeque};
use std::f64::consts::TAU;
use std::ops::Range;
use std::time::Instant;

/// Largest number of frames that wait until the contours cover a lumen's radius of the vessel; beyond it every second one
/// is dropped.
const MAX_WAITING: usize = 128;
/// Echoes that a wall begins with, and waiting ones that every later frame brings along.
const FIRST_ECHOES: usize = 2048;
const FED_ECHOES: usize = 256;
/// A wall begins when the contours' centres lie this many lumen radii apart, and that of a branch when its contours were
/// seen this many of their radii outside the lumens of the others.
const START_RADII: f64 = 1.5;
const LEAST_DEPTH_RADII: f64 = 1.0;

/// A wall that grows, or the frames that wait for it to begin.
#[derive(Serialize, Deserialize)]
pub(super) struct LiveWall {
    /// The wall that this one leaves; `None` for the first.
    pub parent: Option<usize>,
    /// How far outside the lumens of all other walls its contours were seen, in their own radii.
    pub depth_radii: f64,
    /// Frames from before the wall began, the oldest first: a few of them come with every frame after that.
    waiting: VecDeque<PlacedFrame>,
    /// Running medians of the contours' radii and of their [angle jumps](angle_jumps_mm).
    contours: RunningMedian,
    jumps: RunningMedian,
    vessel: Option<GrowingVessel>,
}

impl LiveWall {
    pub fn new(parent: Option<usize>) -> Self {
        Self {
            parent,
            depth_radii: 0.0,
            waiting: VecDeque::new(),
            contours: RunningMedian::new(),
            jumps: RunningMedian::new(),
            vessel: None,
        }
    }

    /// Whether it can go on after it was read from a file.
    pub fn is_sound(&self, settings: &Settings) -> bool {
        self.waiting.len() <= MAX_WAITING
            && !self.depth_radii.is_nan()
            && self.contours.holds(std::iter::empty())
            && self.jumps.holds(std::iter::empty())
            && self.vessel.as_ref().is_none_or(|vessel| vessel.is_sound(settings))
    }

    /// Whether there is a wall, rather than frames that wait for one.
    pub fn has_begun(&self) -> bool {
        self.vessel.is_some()
    }

    /// Where a point lies about it; `None` as long as it has not begun.
    pub fn about(&self, point_mm: DVec3) -> Option<About> {
        self.vessel.as_ref().map(|vessel| vessel.about(point_mm))
    }

    /// Whether the centre of a frame that waits lies within a distance of a point.
    pub fn has_waiting_near(&self, point_mm: DVec3, distance_mm: f64) -> bool {
        let mut centres = self.waiting.iter().filter_map(PlacedFrame::centre_mm);
        centres.any(|centre_mm| centre_mm.distance(point_mm) < distance_mm)
    }

    /// The own rings that lie within the lumens' reach of some rings of another wall.
    pub fn rings_within(&self, other: &Self, rings: &Range<usize>) -> Option<Range<usize>> {
        self.vessel.as_ref()?.rings_within(other.vessel.as_ref()?, rings)
    }

    /// Adds a frame. A wall that begins has that many nodes a ring, where they are given.
    pub fn push(&mut self, placed: PlacedFrame, nodes: Option<usize>, settings: &Settings) -> Result<Step> {
        let rings = self.rings();
        let step = self.grow(placed, nodes, settings)?;
        Ok(Step { behind: self.rings() - rings - step.before, ..step })
    }

    fn grow(&mut self, placed: PlacedFrame, nodes: Option<usize>, settings: &Settings) -> Result<Step> {
        if let Some(radius) = placed.outline.map(|outline| outline.radius_mm).filter(|radius| *radius > 0.0) {
            self.contours.add(radius);
        }
        angle_jumps_mm(&placed.frame.contour_mm).for_each(|jump| {
            self.jumps.add(jump);
        });
        let radius_mm = self.contours.value();
        if let Some(vessel) = &mut self.vessel {
            vessel.grid.arc_mm = TAU * radius_mm / vessel.grid.nodes as f64;
            return vessel.push(&placed, &fed(&mut self.waiting, FED_ECHOES));
        }
        self.waiting.push_back(placed);
        if self.waiting.len() > MAX_WAITING {
            let mut count = 0;
            self.waiting.retain(|_| {
                count += 1;
                count % 2 == 1
            });
        }
        let is_deep = self.parent.is_none() || self.depth_radii >= LEAST_DEPTH_RADII;
        if is_deep { self.start(radius_mm, nodes, settings) } else { Ok(Step::default()) }
    }

    /// Begins the wall once its contours cover a length.
    fn start(&mut self, radius_mm: f64, nodes: Option<usize>, settings: &Settings) -> Result<Step> {
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
        let settings = match nodes {
            Some(nodes) => &settings.clone().with_sweep(settings.sweep.with_nodes(Some(nodes as u32))),
            None => settings,
        };
        let resolution = resolution(&contours_mm, length_mm, radius_mm, f64::INFINITY, settings);
        let (nodes, step_mm) = match resolution {
            // Frames that lie too far apart wait for others between them.
            Err(Error::Recording { .. }) => return Ok(Step::default()),
            resolution => resolution?,
        };
        let curve = Curve::along(&curve, &centres, radius_mm);
        let mut vessel = GrowingVessel::along(curve, nodes, step_mm, radius_mm, settings);
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

    /// Forgets those of some frames that wait for the wall to begin.
    pub fn forget_waiting(&mut self, frames: &BTreeSet<u32>) {
        self.waiting.retain(|placed| !frames.contains(&placed.number));
    }

    /// Forgets the echoes of some frames, none of them from before a time, and fits the wall about them again.
    pub fn forget(&mut self, frames: &BTreeSet<u32>, since_s: f64) -> Result<Step> {
        self.forget_waiting(frames);
        self.vessel.as_mut().map_or(Ok(Step::default()), |vessel| vessel.forget(frames, since_s))
    }

    /// Adds what still waits from before the wall began, and fits the whole wall. After the last frame: it takes longer than
    /// a frame may.
    pub fn flush(&mut self, times_s: &[Option<f64>], settings: &Settings) -> Result<Step> {
        let Some(vessel) = &mut self.vessel else { return Ok(Step::default()) };
        vessel.finish(&fed(&mut self.waiting, usize::MAX), times_s, &settings.sweep)
    }

    /// Number of rings.
    pub fn rings(&self) -> usize {
        self.vessel.as_ref().map_or(0, |vessel| vessel.grid.rings)
    }

    /// Nodes per ring.
    pub fn nodes(&self) -> usize {
        self.vessel.as_ref().map_or(0, |vessel| vessel.grid.nodes)
    }

    /// Some rings as a surface. What lies within the lumen of one of the other walls is not supported; of two walls that
    /// coincide, the one that comes first in the vessel is kept (`true` for those that come before this).
    pub fn surface(&self, rings: Range<usize>, others: &[(&Self, bool)], keep_unsupported: bool) -> Surface {
        let Some(vessel) = &self.vessel else { return Surface::default() };
        let most_mm = most_tangential_mm(vessel.noise_mm(), vessel.grid.radius_mm());
        let tangential_mm = (TANGENTIAL_PER_JUMP * self.jumps.value()).min(most_mm).hypot(vessel.shift_mm());
        let radius = |node: usize| {
            let radius = vessel.radii_mm[node];
            radius - outward_bias_mm(radius, tangential_mm)
        };
        let noise_mm = vessel.noise_mm();
        // Of each ring: the other walls about it, and where along them to search.
        let others: Vec<(&GrowingVessel, f64)> = others
            .iter()
            .filter_map(|(other, comes_first)| {
                Some((other.vessel.as_ref()?, if *comes_first { noise_mm } else { -noise_mm }))
            })
            .collect();
        let beside: Vec<Vec<(usize, usize)>> = rings
            .clone()
            .map(|ring| {
                let near = |(k, (other, _)): (usize, &(&GrowingVessel, f64))| {
                    Some((k, other.ring_in_reach(vessel, ring)?))
                };
                others.iter().enumerate().filter_map(near).collect()
            })
            .collect();
        let is_supported = |node: usize| {
            let (ring, j) = (node / vessel.grid.nodes, node % vessel.grid.nodes);
            let theta_rad = TAU * j as f64 / vessel.grid.nodes as f64;
            let point_mm = vessel.axis.point_mm(ring, theta_rad, vessel.radii_mm[node]);
            vessel.support.supported[node]
                && beside[ring - rings.start].iter().all(|&(k, near)| {
                    let (other, margin_mm) = others[k];
                    !other.encloses(point_mm, near, margin_mm)
                })
        };
        let (axis, nodes) = (&vessel.axis, vessel.grid.nodes);
        surface(axis, nodes, rings.clone(), &vessel.support, is_supported, radius, keep_unsupported)
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
