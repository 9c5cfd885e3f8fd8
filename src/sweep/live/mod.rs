//! The sweep while the recording goes on: every frame changes the wall about it, in bounded time.
//!
//! What the batch does for all echoes at once is done for a window of rings: the newest echoes' own, and one that
//! goes up and down the vessel, so that what was found early is brought to what is known now. Within a window, echoes are
//! measured anew where the wall has moved the most since (as iSAM2 relinearises: Kaess et al., IJRR 31(2), 2012), and
//! the wall is solved for with all rings outside held.

mod curve;
mod level;
mod median;

use super::prepare::axis::Axis;
use super::prepare::centreline;
use super::prepare::contour::{MOST_FOLDED, Outline};
use super::support::{Support, Tally, largest_error_mm};
use super::wall::CELL_NOISE;
use super::wall::echo::{Echo, Held, OUT_OF_PLANE};
use super::wall::grid::{Equations, Grid, Solver, System};
use super::{TANGENTIAL_PER_JUMP, bulge_mm, jumps_mm, mesh, resolution};
use crate::Result;
use crate::geometry::{Pose, rotation_minimising_frames, transported};
use crate::recording::FRAME_INTERVAL_S;
use crate::recording::Frame;
use crate::settings::Settings;
use crate::surface::Surface;
use curve::{Curve, Growth};
use glam::{DMat3, DVec3};
use level::{Level, Sample};
use median::Median;
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::ops::Range;

/// Frames that are kept until the contours cover a lumen's radius of the vessel; then every second one goes.
const MOST_WAITING: usize = 128;
/// The vessel begins when its contours' centres lie so many lumen radii apart.
const START_RADII: f64 = 1.5;
/// Echoes beyond the ends that are kept until the axis has grown or turned towards them.
const MOST_BEYOND: usize = 2048;
/// Most rings of the window about a frame.
const WINDOW: usize = 48;
/// Rings of the window that goes up and down, and how far it goes each time.
const ROUND: usize = 24;
const ROUND_STEP: usize = 16;
/// Echoes that are measured anew in a window.
const MOST_MEASURED: usize = 4000;
/// Echoes are good as measured while no node about has travelled more than this share of the noise.
const ENOUGH_NOISE_SHARE: f64 = 0.002;
/// Steps of the solver for a window, and the share of the residual that may be left.
const MOST_STEPS: usize = 8;
const SOLVED_SHARE: f64 = 0.02;
/// Farthest that feet lie from their echoes, in levels.
const FARTHEST_FOOT: usize = 16;
/// Rings beside a window that have a say about the support in it.
const SUPPORT_MARGIN: usize = 8;
/// Rounds over the first frames, and those of them that take the wall for a tube.
const FIRST_ROUNDS: usize = 5;
const ROUGH_ROUNDS: usize = 2;

/// A vessel swept along its centreline while the recording goes on.
pub(crate) struct LiveSweep {
    settings: Settings,
    sensor_from_probe: Pose,
    frames: usize,
    clock_s: f64,
    waiting: Vec<Seen>,
    /// Radii of the contours, and jumps along them.
    contours: Median,
    jumps: Median,
    vessel: Option<Vessel>,
}

/// What a frame did to the vessel.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Step {
    /// Rings that came before the first.
    pub before: usize,
    /// Rings that changed.
    pub changed: Vec<Range<usize>>,
    /// Echoes that were placed or measured.
    pub echoes: usize,
    /// Rings that were solved for.
    pub rings: usize,
    /// Whether its centre is too far from the axis for its echoes to have a place.
    pub off_axis: bool,
}

/// A frame in the world.
#[derive(Clone)]
struct Seen {
    number: u32,
    time_s: f64,
    world_from_probe: Pose,
    frame: Frame,
    outline: Option<Outline>,
}

impl Seen {
    fn centre_mm(&self) -> Option<DVec3> {
        Some(self.world_from_probe.transform_point(self.outline?.centre_mm.extend(0.0)))
    }
}

impl LiveSweep {
    pub fn new(settings: &Settings) -> Self {
        Self {
            settings: settings.clone(),
            sensor_from_probe: settings.calibration.sensor_from_probe(),
            frames: 0,
            clock_s: 0.0,
            waiting: Vec::new(),
            contours: Median::new(),
            jumps: Median::new(),
            vessel: None,
        }
    }

    /// Takes a frame that has passed [`Frame::check`].
    pub fn push(&mut self, frame: &Frame) -> Result<Step> {
        let after = self.clock_s + if self.frames == 0 { 0.0 } else { FRAME_INTERVAL_S };
        self.clock_s = frame.time_s.unwrap_or(after);
        let world_from_probe = frame.world_from_sensor * self.sensor_from_probe;
        let mut seen = Seen {
            number: self.frames as u32,
            time_s: self.clock_s,
            world_from_probe,
            frame: frame.clone(),
            outline: Outline::of(frame),
        };
        if seen.outline.is_some_and(|outline| outline.folded_share > MOST_FOLDED) {
            // No radius about its centre can hold it.
            seen.frame.contour_mm.clear();
            seen.outline = None;
        }
        self.frames += 1;
        if let Some(radius) = seen.outline.map(|outline| outline.radius_mm).filter(|radius| *radius > 0.0) {
            self.contours.add(radius);
        }
        jumps_mm(&seen.frame).for_each(|jump| {
            self.jumps.add(jump);
        });
        let radius_mm = self.contours.value();
        if let Some(vessel) = &mut self.vessel {
            vessel.grid.arc_mm = TAU * radius_mm / vessel.grid.nodes as f64;
            return Ok(vessel.push(&seen));
        }
        self.waiting.push(seen);
        if self.waiting.len() > MOST_WAITING {
            let mut turn = 0;
            self.waiting.retain(|_| {
                turn += 1;
                turn % 2 == 1
            });
        }
        self.start(radius_mm)
    }

    /// Starts the vessel once its contours cover a length.
    fn start(&mut self, radius_mm: f64) -> Result<Step> {
        let centres: Vec<DVec3> = self.waiting.iter().filter_map(Seen::centre_mm).collect();
        let (low, high) = centres
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        if radius_mm <= 0.0 || centres.is_empty() || low.distance(high) < START_RADII * radius_mm {
            return Ok(Step::default());
        }
        let Some(curve) = centreline::centreline(&centres, radius_mm) else { return Ok(Step::default()) };
        let length_mm = centreline::lengths(&curve).last().copied().unwrap_or(0.0);
        let frames: Vec<Frame> = self.waiting.iter().map(|seen| seen.frame.clone()).collect();
        // As if noise hid all between the nodes: a finer grid would take longer than a frame may.
        let (nodes, step_mm) = resolution(&frames, length_mm, radius_mm, f64::INFINITY, &self.settings)?;
        let curve = Curve::along(&curve, &centres, radius_mm);
        let mut vessel = Vessel::along(curve, nodes, step_mm, radius_mm, &self.settings);
        let step = vessel.start(&self.waiting);
        self.waiting = Vec::new();
        self.vessel = Some(vessel);
        Ok(step)
    }

    pub fn rings(&self) -> usize {
        self.vessel.as_ref().map_or(0, |vessel| vessel.grid.rings)
    }

    pub fn nodes(&self) -> usize {
        self.vessel.as_ref().map_or(0, |vessel| vessel.grid.nodes)
    }

    /// Some rings as a surface.
    pub fn surface(&self, rings: Range<usize>, keep_unsupported: bool) -> Surface {
        let Some(vessel) = &self.vessel else { return Surface::default() };
        let tangential_mm = (TANGENTIAL_PER_JUMP * self.jumps.value()).min(vessel.noise_mm());
        let radius = |node: usize| {
            let radius = vessel.radii_mm[node];
            radius - bulge_mm(radius, tangential_mm)
        };
        mesh(&vessel.axis, vessel.grid.nodes, rings, &vessel.support, radius, keep_unsupported)
    }
}

/// An echo that the axis has not reached.
struct Aside {
    point_mm: DVec3,
    image_normal: DVec3,
    frame: u32,
    time_s: f64,
}

/// The vessel so far.
struct Vessel {
    curve: Curve,
    /// How far along the curve the first ring is, mm.
    origin_mm: f64,
    axis: Axis,
    grid: Grid,
    solver: Solver,
    roughness: f64,
    half_life_s: Option<f64>,
    radii_mm: Vec<f64>,
    /// Level k lies between ring k and the next.
    levels: Vec<Level>,
    /// Levels from the first to the last with echoes.
    seen: Range<usize>,
    /// Echoes beyond the ends, the oldest first.
    beyond: VecDeque<Aside>,
    support: Support,
    misses: Median,
    /// Weight of the echoes and standard error of the nodes, and where each is counted.
    densities: Median,
    errors: Median,
    bins: Vec<[Option<u16>; 2]>,
    /// Where the window that goes up and down is, and which way it goes.
    round: usize,
}

impl Vessel {
    fn along(curve: Curve, nodes: usize, step_mm: f64, radius_mm: f64, settings: &Settings) -> Self {
        let rings = (curve.length_mm() / step_mm) as usize + 1;
        let (points_mm, tangents): (Vec<_>, Vec<_>) =
            (0..rings).map(|k| curve.at(k as f64 * step_mm / curve.spacing_mm())).unzip();
        let frames = rotation_minimising_frames(&points_mm, &tangents);
        let grid = Grid::new(rings, nodes, step_mm, radius_mm);
        let mut vessel = Self {
            curve,
            origin_mm: 0.0,
            axis: Axis { points_mm, frames, step_mm },
            grid: Grid { rings: 0, ..grid },
            solver: Solver::new(grid),
            roughness: settings.sweep.roughness,
            half_life_s: settings.sweep.half_life_s,
            radii_mm: Vec::new(),
            levels: Vec::new(),
            seen: 0..0,
            beyond: VecDeque::new(),
            support: Support::none(),
            misses: Median::new(),
            densities: Median::new(),
            errors: Median::new(),
            bins: Vec::new(),
            round: 0,
        };
        vessel.insert_rings(0, rings);
        vessel
    }

    /// Places the first frames and finds the wall about them.
    fn start(&mut self, frames: &[Seen]) -> Step {
        let mut step = Step::default();
        let samples: Vec<(usize, Sample, f64)> =
            frames.iter().flat_map(|seen| self.placed(seen, false)).collect();
        let mut radii: Vec<f64> = samples.iter().map(|(_, sample, _)| sample.echo.radius_mm).collect();
        let start_mm = super::median(&mut radii);
        self.radii_mm.fill(start_mm);
        for (level, sample, time_s) in samples {
            self.insert(level, sample, time_s, start_mm, true);
        }
        for round in 0..FIRST_ROUNDS {
            let noise_mm = if round < ROUGH_ROUNDS { start_mm } else { self.noise_mm() };
            for level in self.seen.clone() {
                let held =
                    Held { grid: &self.grid, radii_mm: &self.radii_mm, noise_mm, out_of_plane: OUT_OF_PLANE };
                self.levels[level].measure(held, &mut self.misses, round < ROUGH_ROUNDS);
                step.echoes += self.levels[level].kept;
            }
            step.rings += self.refit(self.seen.start..self.seen.end + 1, &mut 0).len();
        }
        step.changed.push(0..self.grid.rings);
        step
    }

    fn push(&mut self, seen: &Seen) -> Step {
        let mut step = Step::default();
        match seen.centre_mm().map(|centre| self.curve.push(centre)) {
            Some(Growth::Moved { before, moved }) => {
                let (before, moved) = self.redraw(before, moved, &mut step);
                step.before = before;
                step.changed.push(moved);
            }
            Some(Growth::Stray) => step.off_axis = true,
            Some(Growth::None) | None => (),
        }
        let noise_mm = self.noise_mm();
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (level, sample, time_s) in self.placed(seen, step.off_axis) {
            step.changed.extend(self.see(level));
            let (foot, on_wall) = self.insert(level, sample, time_s, noise_mm, true);
            step.echoes += 1;
            if on_wall {
                (low, high) = (low.min(foot), high.max(foot));
            }
        }
        if low <= high {
            let middle = (low + high) / 2.0;
            let reach = ((high - low) / 2.0 + self.margin()).min(WINDOW as f64 / 2.0);
            let first = (middle - reach).max(0.0) as usize;
            let window = first..((middle + reach) as usize + 2).min(self.grid.rings);
            let mut measured = MOST_MEASURED;
            let solved = self.refit(window, &mut measured);
            step.echoes += MOST_MEASURED - measured;
            step.rings += solved.len();
            step.changed.push(solved);
        }
        step.changed.push(self.next_round(&mut step.echoes, &mut step.rings));
        step.changed.retain(|range| !range.is_empty());
        step.changed.sort_by_key(|range| range.start);
        step.changed.dedup_by(|next, before| {
            let joined = next.start <= before.end;
            if joined {
                before.end = before.end.max(next.end);
            }
            joined
        });
        step
    }

    /// Refits the window that goes round the vessel, and moves it on.
    fn next_round(&mut self, echoes: &mut usize, rings: &mut usize) -> Range<usize> {
        if !(self.seen.start..self.seen.end).contains(&self.round) {
            self.round = self.seen.start;
        }
        let window = self.round..(self.round + ROUND).min(self.seen.end + 1);
        self.round += ROUND_STEP;
        let mut measured = MOST_MEASURED / 2;
        let solved = self.refit(window, &mut measured);
        *echoes += MOST_MEASURED / 2 - measured;
        *rings += solved.len();
        solved
    }

    /// Rings beside the newest echoes that feel them: three times the reach of their pull.
    fn margin(&self) -> f64 {
        let density = self.densities.value() / self.grid.cell_mm2();
        let reach_mm = (self.smoothness_mm2() / density.max(f64::MIN_POSITIVE)).powf(0.25);
        (3.0 * reach_mm / self.grid.step_mm).clamp(2.0, 12.0)
    }

    /// Standard deviation of normal noise with the echoes' median |miss|, mm.
    fn noise_mm(&self) -> f64 {
        1.4826 * self.misses.value()
    }

    fn smoothness_mm2(&self) -> f64 {
        let noise_mm = self.noise_mm().hypot(CELL_NOISE * self.roughness * self.grid.arc_mm);
        (noise_mm / self.roughness).powi(2)
    }

    /// The echoes of a frame about the axis, with their levels; those beyond its ends are put aside, or all
    /// of a frame that is off the axis.
    fn placed(&mut self, seen: &Seen, off_axis: bool) -> Vec<(usize, Sample, f64)> {
        let frame = &seen.frame;
        let to_world = |p: glam::DVec2| seen.world_from_probe.transform_point(p.extend(0.0));
        let centre = frame.centroid_mm().or_else(|| frame.echoes_mm().next());
        let near = centre.map_or(0, |centre| self.axis.nearest_ring(to_world(centre)));
        let image_normal = seen.world_from_probe.rotation.z_axis;
        let mut placed = Vec::new();
        for point_mm in frame.echoes_mm().map(to_world) {
            let sample = (!off_axis).then(|| self.sample(point_mm, image_normal, seen.number, near));
            match sample.flatten() {
                Some((level, sample)) => placed.push((level, sample, seen.time_s)),
                None => self.put_aside(point_mm, image_normal, seen),
            }
        }
        placed
    }

    /// An echo about the axis, and its level; looked for from ring `near` on.
    fn sample(
        &self,
        point_mm: DVec3,
        image_normal: DVec3,
        frame: u32,
        near: usize,
    ) -> Option<(usize, Sample)> {
        let place = self.axis.place(point_mm, near)?;
        let echo = Echo::new(&place, image_normal, frame, self.grid.nodes);
        let (weight, scatter_mm2) = (1.0, 0.0);
        let sample =
            Sample { echo, point_mm, image_normal, weight, scatter_mm2, bin: None, is_merged: false };
        Some((place.ring as usize, sample))
    }

    fn put_aside(&mut self, point_mm: DVec3, image_normal: DVec3, seen: &Seen) {
        if self.beyond.len() == MOST_BEYOND {
            self.beyond.pop_front();
        }
        self.beyond.push_back(Aside { point_mm, image_normal, frame: seen.number, time_s: seen.time_s });
    }

    /// Takes up the echoes beyond the ends that the axis has reached by now.
    fn take_up(&mut self, noise_mm: f64, step: &mut Step) {
        let aside = std::mem::take(&mut self.beyond);
        step.echoes += aside.len();
        for echo in aside {
            let last = self.grid.rings - 1;
            let distance = |ring: usize| self.axis.points_mm[ring].distance_squared(echo.point_mm);
            let near = if distance(0) < distance(last) { 0 } else { last };
            match self.sample(echo.point_mm, echo.image_normal, echo.frame, near) {
                Some((level, sample)) => {
                    step.changed.extend(self.see(level));
                    self.insert(level, sample, echo.time_s, noise_mm, true);
                }
                None => self.beyond.push_back(echo),
            }
        }
    }

    /// Where its foot is along the axis, and whether it lies on the wall.
    fn insert(&mut self, level: usize, sample: Sample, time_s: f64, noise_mm: f64, new: bool) -> (f64, bool) {
        let held = Held { grid: &self.grid, radii_mm: &self.radii_mm, noise_mm, out_of_plane: OUT_OF_PLANE };
        let here = &mut self.levels[level];
        if new {
            if let Some(half_life_s) = self.half_life_s.filter(|_| here.latest_s < time_s) {
                here.age((-(time_s - here.latest_s) / half_life_s).exp2());
            }
            here.latest_s = here.latest_s.max(time_s);
        }
        here.insert(sample, held, &self.axis, &mut self.misses, new)
    }

    /// Takes note that a level has echoes. The wall beyond those that had any was made up: it goes on as it ended.
    fn see(&mut self, level: usize) -> Option<Range<usize>> {
        let nodes = self.grid.nodes;
        if self.seen.is_empty() {
            self.seen = level..level + 1;
            return None;
        }
        if level >= self.seen.end {
            let end = self.seen.end * nodes;
            let rings = self.seen.end + 1..self.grid.rings;
            rings.clone().for_each(|ring| self.radii_mm.copy_within(end..end + nodes, ring * nodes));
            self.seen.end = level + 1;
            return Some(rings);
        }
        if level < self.seen.start {
            let start = self.seen.start * nodes;
            let rings = 0..self.seen.start;
            rings.clone().for_each(|ring| self.radii_mm.copy_within(start..start + nodes, ring * nodes));
            self.seen.start = level;
            return Some(rings);
        }
        None
    }

    /// Makes room for rings in front of the others and behind them.
    fn insert_rings(&mut self, before: usize, behind: usize) {
        let nodes = self.grid.nodes;
        self.grid.rings += before + behind;
        let ends = [0..before, self.grid.rings - behind..self.grid.rings];
        if before > 0 {
            self.levels.iter_mut().for_each(|level| level.renumber(before));
            self.seen = self.seen.start + before..self.seen.end + before;
            self.round += before;
        }
        for (rings, at_front) in ends.into_iter().zip([true, false]) {
            let levels = rings.clone().map(|ring| Level::new(&self.grid, ring));
            let at = if at_front { 0 } else { self.levels.len() };
            self.levels.splice(at..at, levels);
            let count = rings.len() * nodes;
            let at = at * nodes;
            // As wide as the vessel ends.
            let end = match self.radii_mm.len() {
                0 => vec![0.0; nodes],
                _ if at_front => self.radii_mm[..nodes].to_vec(),
                length => self.radii_mm[length - nodes..].to_vec(),
            };
            self.radii_mm.splice(at..at, end.into_iter().cycle().take(count));
            self.bins.splice(at..at, std::iter::repeat_n([None; 2], count));
            self.support.insert(at, count);
        }
    }

    /// Draws the rings about the curve's nodes `moved` anew, after `before` nodes came in front of the others, and places
    /// their echoes anew. Rings that came in front, and those that moved or are new.
    fn redraw(&mut self, before: usize, moved: Range<usize>, step: &mut Step) -> (usize, Range<usize>) {
        let (step_mm, nodes) = (self.grid.step_mm, self.grid.nodes);
        let spacing_mm = self.curve.spacing_mm();
        self.origin_mm += before as f64 * spacing_mm;
        let in_front = (self.origin_mm / step_mm) as usize;
        self.origin_mm -= in_front as f64 * step_mm;
        let rings = ((self.curve.length_mm() - self.origin_mm) / step_mm) as usize + 1;
        let old = self.grid.rings;
        let behind = rings.saturating_sub(old + in_front);
        self.insert_rings(in_front, behind);

        let place = |ring: usize| (self.origin_mm + ring as f64 * step_mm) / spacing_mm;
        let is_moved = |ring: &usize| {
            let place = place(*ring);
            moved.start as f64 - 2.0 < place && place < moved.end as f64 + 1.0
        };
        let all = 0..self.grid.rings;
        let first = all.clone().find(is_moved).unwrap_or(0);
        let last = all.clone().rfind(is_moved).unwrap_or(0);
        let changed = first..last + 1;

        let (points, frames) = (&mut self.axis.points_mm, &mut self.axis.frames);
        points.splice(0..0, std::iter::repeat_n(DVec3::ZERO, in_front));
        frames.splice(0..0, std::iter::repeat_n(DMat3::IDENTITY, in_front));
        points.resize(all.end, DVec3::ZERO);
        frames.resize(all.end, DMat3::IDENTITY);
        let before_mm: Vec<DVec3> = points[changed.clone()].to_vec();
        let tangents: Vec<DVec3> = changed
            .clone()
            .map(|ring| {
                let (point, tangent) = self.curve.at(place(ring));
                points[ring] = point;
                tangent
            })
            .collect();
        if changed.start > 0 || changed.end == all.end {
            for ring in changed.clone() {
                let from = ring.saturating_sub(1);
                let start = if ring == 0 { frames[in_front] } else { frames[from] };
                frames[ring] =
                    transported(&start, points[ring] - points[from], tangents[ring - changed.start]);
            }
        } else {
            for ring in changed.clone().rev() {
                let from = ring + 1;
                frames[ring] = transported(&frames[from], points[ring] - points[from], tangents[ring]);
            }
        }
        // To first order the wall stays where it was.
        for ring in changed.clone().filter(|ring| (in_front..in_front + old).contains(ring)) {
            let shift = self.axis.points_mm[ring] - before_mm[ring - changed.start];
            let frame = &self.axis.frames[ring];
            let (x, y) = (shift.dot(frame.x_axis), shift.dot(frame.y_axis));
            for j in 0..nodes {
                let (sin, cos) = (TAU * j as f64 / nodes as f64).sin_cos();
                self.radii_mm[ring * nodes + j] -= x * cos + y * sin;
            }
        }
        let noise_mm = self.noise_mm();
        let levels = changed.start.saturating_sub(1)..changed.end.min(all.end - 1);
        let mut samples = Vec::new();
        for level in levels {
            let latest_s = self.levels[level].latest_s;
            let drained = self.levels[level].drain(&self.grid, level);
            samples.extend(drained.into_iter().map(|sample| (level, sample, latest_s)));
        }
        step.echoes += samples.len();
        for (level, mut sample, latest_s) in samples {
            if let Some(place) = self.axis.place(sample.point_mm, level) {
                let old = sample.echo;
                sample.echo = Echo::new(&place, sample.image_normal, old.frame, nodes);
                sample.echo.keep_foot_of(&old);
                let level = place.ring as usize;
                step.changed.extend(self.see(level));
                self.insert(level, sample, latest_s, noise_mm, false);
            }
        }
        self.take_up(noise_mm, step);
        (in_front, changed)
    }

    /// Solves for the wall in a window of rings with all others held, after up to `measured` echoes have been measured anew
    /// where the wall has travelled the most. Returns the rings.
    fn refit(&mut self, window: Range<usize>, measured: &mut usize) -> Range<usize> {
        let window = window.start.max(self.seen.start)..window.end.min(self.seen.end + 1);
        if window.len() < 2 {
            return 0..0;
        }
        let (nodes, all) = (self.grid.nodes, self.grid.rings);
        let noise_mm = self.noise_mm();
        let held = Held { grid: &self.grid, radii_mm: &self.radii_mm, noise_mm, out_of_plane: OUT_OF_PLANE };
        let enough_mm = ENOUGH_NOISE_SHARE * noise_mm;
        let mut due: Vec<usize> = (window.start.saturating_sub(1)..window.end.min(all - 1))
            .filter(|&level| self.levels[level].travel_mm > enough_mm)
            .collect();
        due.sort_by(|&a, &b| self.levels[b].travel_mm.total_cmp(&self.levels[a].travel_mm));
        for level in due {
            let level = &mut self.levels[level];
            if level.kept > *measured {
                break;
            }
            *measured -= level.kept;
            level.measure(held, &mut self.misses, false);
        }

        let smoothness = self.smoothness_mm2();
        let beside = |margin: usize| window.start.saturating_sub(margin)..(window.end + margin).min(all);
        let (solved, weighed) = (beside(2), beside(SUPPORT_MARGIN));
        let grid = Grid { rings: solved.len(), ..self.grid };
        let mut equations = Equations::over(&self.grid, solved.clone());
        let mut tally = Tally::new(weighed.len() * nodes);
        for level in &self.levels[beside(FARTHEST_FOOT + SUPPORT_MARGIN)] {
            if level.rings.is_empty() {
                continue;
            }
            equations.merge(&level.equations);
            tally.merge(
                level.rings.start.saturating_sub(weighed.start) * nodes,
                &level.tally,
                weighed.start.saturating_sub(level.rings.start) * nodes,
            );
        }
        let x = &self.radii_mm[solved.start * nodes..solved.end * nodes];
        let free = window.start - solved.start..window.end - solved.start;
        let equations = equations.of_change(&grid, smoothness, x, free.clone());
        let mut change = vec![0.0; x.len()];
        self.solver.over(grid, MOST_STEPS).solve(
            &System::plain(&equations, smoothness),
            SOLVED_SHARE,
            &mut change,
        );
        for ring in free {
            let travel = &change[ring * nodes..(ring + 1) * nodes];
            let ring = ring + solved.start;
            let farthest = travel.iter().fold(0.0_f64, |most, t| most.max(t.abs()));
            self.radii_mm[ring * nodes..(ring + 1) * nodes].iter_mut().zip(travel).for_each(|(r, t)| *r += t);
            for level in &mut self.levels[ring.saturating_sub(1)..=ring] {
                level.travel_mm += farthest;
            }
        }
        self.weigh(&window, &weighed, &tally, smoothness);
        window
    }

    /// Weighs what the nodes of a window rest on, by the echoes of the rings `weighed`.
    fn weigh(&mut self, window: &Range<usize>, weighed: &Range<usize>, tally: &Tally, smoothness: f64) {
        let nodes = self.grid.nodes;
        let grid = Grid { rings: weighed.len(), ..self.grid };
        let density = self.densities.value() / grid.cell_mm2();
        let said = tally.weighed(&grid, density, smoothness);
        let largest_mm = largest_error_mm(self.errors.value(), &grid);
        let offset = weighed.start * nodes;
        let own: Vec<f64> = tally.own().collect();
        for node in window.start * nodes..window.end * nodes {
            let here = node - offset;
            let error_mm = said.standard_error_mm[here];
            let [density_bin, error_bin] = &mut self.bins[node];
            recount(&mut self.densities, density_bin, Some(own[here]).filter(|n| *n > 0.0));
            recount(&mut self.errors, error_bin, Some(error_mm).filter(|e| e.is_finite()));
            self.support.echoes[node] = own[here].round() as u32;
            self.support.residual_mm[node] = said.residual_mm[here];
            self.support.standard_error_mm[node] = error_mm;
            self.support.last_frame[node] = tally.last_frame[here];
            self.support.supported[node] = error_mm <= largest_mm && !said.is_mouth[here];
        }
    }
}

/// Counts a value in the place of the one before.
fn recount(median: &mut Median, bin: &mut Option<u16>, value: Option<f64>) {
    if let Some(before) = bin.take() {
        median.take(before);
    }
    *bin = value.map(|value| median.add(value));
}
