//! The vessel that a live sweep has found so far.

use super::band::{EchoBand, Sample, Scene};
use super::curve::{Curve, Growth};
use super::running_median::RunningMedian;
use super::shared::{Independent, Pulls, SharedErrors, WALLS, WallOf};
use crate::geometry::{Pose, rotation_minimising_frames, transported};
use crate::numerics::robust::{SD_PER_MAD, median};
use crate::recording::Frame;
use crate::recording::echo_error::OUT_OF_PLANE;
use crate::settings::{FrameShifts, Settings, SweepSettings};
use crate::sweep::errors;
use crate::sweep::prepare::axis::Axis;
use crate::sweep::prepare::contour::Outline;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::WallGrid;
use crate::sweep::support::{Support, Tally, is_in_reach, max_error_mm};
use crate::sweep::wall::bending::LocalSmoothness;
use crate::sweep::wall::engine::refit;
use crate::sweep::wall::equations::Equations;
use crate::sweep::wall::fit::{Checkpoint, Wall};
use crate::sweep::wall::operator::Operator;
use crate::sweep::wall::residual::ResidualModel;
use crate::sweep::wall::solver::Solver;
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, VecDeque};
use std::f64::consts::TAU;
use std::ops::Range;
use std::time::Instant;

/// Largest number of echoes beyond the ends that wait until the axis reaches them, and of those that are tried in a frame.
const MAX_PENDING: usize = 2048;
const MAX_TRIED: usize = 256;
/// Largest number of rings of the window about a frame.
const MAX_WINDOW: usize = 40;
/// Rings of the background window, and the rings that it advances per frame.
const BACKGROUND_WINDOW: usize = 16;
const BACKGROUND_STEP: usize = 12;
/// Largest number of samples whose residuals are evaluated again in the window about a frame, and in the background window.
const MAX_MEASURED: usize = 3072;
const MAX_MEASURED_BEHIND: usize = 512;
/// Residuals stay valid while no node about has moved by more than this share of the noise.
const ENOUGH_NOISE_SHARE: f64 = 0.002;
/// Steps of the solver for a window, and the share of the residual that may remain.
const MAX_STEPS: usize = 3;
const SOLVED_SHARE: f64 = 0.05;
/// Largest distance of projections from their echoes, in rings.
const MAX_PROJECTION: usize = 16;
/// Rings beside a window that affect the support in it.
const SUPPORT_MARGIN: usize = 8;
/// What a vessel that is read from a file may have: rings, nodes per ring, and the smallest distance of two rings in
/// distances of the curve's nodes.
const MAX_RINGS: usize = 1 << 24;
const MAX_NODES: usize = 1 << 14;
const MIN_STEP_SPACINGS: f64 = 1e-3;
/// Length of an end of the wall before its outermost centre, in lumen radii.
const END_RADII: f64 = 1.0;
/// Rounds over the first frames, and those of them that are a warm-up.
const FIRST_ROUNDS: usize = 4;
const WARM_UP_ROUNDS: usize = 1;
/// Rounds over all echoes after the last frame.
const LAST_ROUNDS: usize = 4;
/// Largest share of the samples that represent several echoes in a wall that is fitted as that of a whole recording.
const MAX_MERGED: f64 = 0.25;
/// Residuals from which the noise is known.
const MIN_RESIDUALS: u64 = 256;

/// The change of the vessel by a frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Step {
    /// Rings that were added in front, and behind.
    pub before: usize,
    pub behind: usize,
    /// Rings that changed.
    pub changed: Vec<Range<usize>>,
    /// Echoes that were placed or whose residuals were evaluated.
    pub echoes: usize,
    /// Rings that were solved for.
    pub rings: usize,
    /// Whether its echoes wait: its centre lies outside of the lumen.
    pub off_axis: bool,
    /// Times of moving the axis, of placing the frame's echoes, and of solving, s.
    pub axis_s: f64,
    pub placing_s: f64,
    pub solving_s: f64,
}

impl Step {
    /// Adds what another step changed after this one.
    pub fn add(&mut self, step: Self) {
        self.changed.iter_mut().for_each(|range| *range = range.start + step.before..range.end + step.before);
        self.changed.extend(step.changed);
        self.before += step.before;
        self.behind += step.behind;
        self.echoes += step.echoes;
        self.rings += step.rings;
        self.off_axis |= step.off_axis;
        self.axis_s += step.axis_s;
        self.placing_s += step.placing_s;
        self.solving_s += step.solving_s;
    }
}

/// Where a point lies about a wall's axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct About {
    /// Distance from the axis in lumen radii there.
    pub radii_away: f64,
    /// Distance from the wall, mm; negative within the lumen.
    pub outside_mm: f64,
    /// Whether it lies beside or beyond the outermost centres, where the axis may still follow the catheter.
    pub is_at_end: bool,
}

/// A frame in the world.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct PlacedFrame {
    pub number: u32,
    pub time_s: f64,
    pub world_from_probe: Pose,
    pub frame: Frame,
    pub outline: Option<Outline>,
}

impl PlacedFrame {
    pub fn echo_count(&self) -> usize {
        self.frame.echoes_mm().count()
    }

    /// An echo in the world.
    pub fn echo_mm(&self) -> Option<DVec3> {
        self.frame.echoes_mm().next().map(|echo| self.world_from_probe.transform_point(echo.extend(0.0)))
    }

    /// The centre of the outline in the world.
    pub fn centre_mm(&self) -> Option<DVec3> {
        Some(self.world_from_probe.transform_point(self.outline?.centre_mm.extend(0.0)))
    }
}

/// An echo beyond the ends of the axis.
#[derive(Serialize, Deserialize)]
struct PendingEcho {
    point_mm: DVec3,
    image_normal: DVec3,
    frame: u32,
    time_s: f64,
}

/// The vessel found so far.
#[derive(Serialize, Deserialize)]
pub(super) struct GrowingVessel {
    curve: Curve,
    /// Length along the curve of the first ring, mm.
    origin_mm: f64,
    pub axis: Axis,
    pub grid: WallGrid,
    roughness: f64,
    half_life_s: Option<f64>,
    pub radii_mm: Vec<f64>,
    /// Band k lies between ring k and the next.
    bands: Vec<EchoBand>,
    /// Renewals of bands that were begun.
    turns: u64,
    /// The bands from the first to the last with echoes.
    observed: Range<usize>,
    /// Echoes beyond the ends: first those to be tried since the axis has moved, then the others; both the oldest first.
    pending: VecDeque<PendingEcho>,
    untried: usize,
    pub support: Support,
    shared: SharedErrors,
    /// Shifts of whole frames along each axis, as the last fit of the whole wall found them, mm.
    shift_mm: f64,
    /// Whether the next wall that shows errors is one of the background window: frames have them in turns.
    errors_behind: bool,
    /// Running medians of |residual|, of the weight of the echoes at a node, and of the nodes' standard errors.
    residuals: RunningMedian,
    densities: RunningMedian,
    errors: RunningMedian,
    /// The nodes' bins in the last two.
    bins: Vec<[Option<u16>; 2]>,
    /// The first ring of the background window.
    background: usize,
    /// Distance of the wall's farthest echo from the axis, mm.
    farthest_mm: f64,
}

impl GrowingVessel {
    /// A vessel along a curve, without echoes.
    pub fn along(curve: Curve, nodes: usize, step_mm: f64, radius_mm: f64, settings: &Settings) -> Self {
        let rings = (curve.length_mm() / step_mm) as usize + 1;
        let (points_mm, tangents): (Vec<_>, Vec<_>) =
            (0..rings).map(|k| curve.at(k as f64 * step_mm / curve.spacing_mm())).unzip();
        let frames = rotation_minimising_frames(&points_mm, &tangents);
        let grid = WallGrid::new(rings, nodes, step_mm, radius_mm);
        let mut vessel = Self {
            curve,
            origin_mm: 0.0,
            axis: Axis { points_mm, frames, step_mm },
            grid: WallGrid { rings: 0, ..grid },
            roughness: settings.sweep.roughness,
            half_life_s: settings.sweep.half_life_s,
            radii_mm: Vec::new(),
            bands: Vec::new(),
            turns: 0,
            observed: 0..0,
            pending: VecDeque::new(),
            untried: 0,
            support: Support::none(),
            shared: SharedErrors::none(),
            shift_mm: 0.0,
            errors_behind: false,
            residuals: RunningMedian::new(),
            densities: RunningMedian::new(),
            errors: RunningMedian::new(),
            bins: Vec::new(),
            background: 0,
            farthest_mm: 0.0,
        };
        vessel.insert_rings(0, rings);
        vessel
    }

    /// Whether it can go on after it was read from a file.
    pub fn is_sound(&self, settings: &Settings) -> bool {
        let WallGrid { rings, nodes, step_mm, arc_mm } = self.grid;
        // Before anything is multiplied.
        if !(2..=MAX_RINGS).contains(&rings) || !(3..=MAX_NODES).contains(&nodes) || !self.curve.is_sound() {
            return false;
        }
        let of_settings =
            (self.roughness, self.half_life_s) == (settings.sweep.roughness, settings.sweep.half_life_s);
        let lengths = [step_mm, arc_mm, self.axis.step_mm];
        let axis = &self.axis;
        let bins = |k: usize| self.bins.iter().filter_map(move |bins| bins[k]);
        of_settings
            && lengths.iter().all(|mm| mm.is_finite() && *mm > MIN_STEP_SPACINGS * self.curve.spacing_mm())
            && (0.0..2.0 * step_mm).contains(&self.origin_mm)
            && [axis.points_mm.len(), axis.frames.len(), self.bands.len()] == [rings; 3]
            && [self.radii_mm.len(), self.bins.len()] == [rings * nodes; 2]
            && self.support.is_of(rings * nodes)
            && self.shared.is_sound(rings, nodes)
            && self.bands.iter().enumerate().all(|(ring, band)| band.is_sound(&self.grid, ring))
            && self.shift_mm.is_finite()
            && self.observed.start <= self.observed.end
            && self.observed.end < rings
            && self.background < rings + BACKGROUND_STEP
            && self.pending.len() <= MAX_PENDING
            && self.untried <= self.pending.len()
            && self.residuals.holds(self.bands.iter().flat_map(EchoBand::bins))
            && self.densities.holds(bins(0))
            && self.errors.holds(bins(1))
    }

    /// Mean radius of a ring, mm.
    fn ring_radius_mm(&self, ring: usize) -> f64 {
        let nodes = self.grid.nodes;
        self.radii_mm[ring * nodes..(ring + 1) * nodes].iter().sum::<f64>() / nodes as f64
    }

    /// Where a point lies.
    pub fn about(&self, point_mm: DVec3) -> About {
        let ring = self.axis.nearest_ring(point_mm);
        let radius_mm = self.ring_radius_mm(ring);
        let distance_mm = point_mm.distance(self.axis.points_mm[ring]);
        let along_mm = self.origin_mm + ring as f64 * self.grid.step_mm;
        let to_end_mm = along_mm.min(self.curve.length_mm() - along_mm);
        About {
            radii_away: distance_mm / radius_mm,
            outside_mm: distance_mm - radius_mm,
            is_at_end: to_end_mm < self.curve.beyond_mm() + END_RADII * radius_mm,
        }
    }

    /// The ring nearest to a ring of another wall, where the two walls may touch.
    pub fn ring_in_reach(&self, other: &Self, ring: usize) -> Option<usize> {
        let point_mm = other.axis.points_mm[ring];
        let near = self.axis.nearest_ring(point_mm);
        let is_near = self.axis.points_mm[near].distance(point_mm) < self.farthest_mm + other.farthest_mm;
        is_near.then_some(near)
    }

    /// Whether a point lies within the wall that was seen, or no farther outside of it than `margin_mm`. The search along the
    /// axis starts at ring `near`.
    pub fn encloses(&self, point_mm: DVec3, near: usize, margin_mm: f64) -> bool {
        let Some(place) = self.axis.place(point_mm, near) else { return false };
        let (ring, nodes) = (place.ring as usize, self.grid.nodes);
        if !self.observed.contains(&ring) {
            return false;
        }
        let around = place.theta_rad.rem_euclid(TAU) / TAU * nodes as f64;
        let (j, beside) = (around as usize % nodes, around.fract());
        let at = |ring: usize| {
            let [a, b] = [j, (j + 1) % nodes].map(|j| self.radii_mm[ring * nodes + j]);
            a + beside * (b - a)
        };
        let along = place.ring - ring as f64;
        place.radius_mm < at(ring) * (1.0 - along) + at(ring + 1) * along + margin_mm
    }

    /// The rings of this wall that may touch some rings of another.
    pub fn rings_within(&self, other: &Self, rings: &Range<usize>) -> Option<Range<usize>> {
        let points_mm = other.axis.points_mm.get(rings.start..rings.end.min(other.grid.rings))?;
        let reach_mm = self.farthest_mm + other.farthest_mm;
        let own_mm = &self.axis.points_mm;
        let is_near = |&ring: &usize| points_mm.iter().any(|point| point.distance(own_mm[ring]) < reach_mm);
        let first = (0..own_mm.len()).find(is_near)?;
        let last = (first..own_mm.len()).rfind(is_near)?;
        Some(first..last + 1)
    }

    /// Places the first frames and fits the wall about them.
    pub fn start(&mut self, frames: &[PlacedFrame]) -> Result<Step> {
        let mut step = Step::default();
        let start = Instant::now();
        let samples: Vec<(usize, Sample, f64)> =
            frames.iter().flat_map(|frame| self.placed(frame, false)).collect();
        let mut radii: Vec<f64> = samples.iter().map(|(_, sample, _)| sample.echo.radius_mm).collect();
        let start_mm = median(&mut radii);
        self.radii_mm.fill(start_mm);
        let count = samples.len();
        step.echoes = count;
        for (band, sample, time_s) in samples {
            self.insert(band, sample, time_s, start_mm);
        }
        step.placing_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        for round in 0..FIRST_ROUNDS {
            let scene = scene(&self.grid, &self.radii_mm, &self.axis, self.judging_noise_mm());
            for band in &mut self.bands[self.observed.clone()] {
                // No echo changes its cell: the axis is as it was.
                band.renew(scene, &mut self.residuals, round < WARM_UP_ROUNDS, &mut { usize::MAX });
            }
            step.echoes += count;
            step.rings += self.solve(self.observed.start..self.observed.end + 1, 0)?.len();
        }
        step.changed.push(0..self.grid.rings);
        step.solving_s = start.elapsed().as_secs_f64();
        Ok(step)
    }

    /// Adds a frame, and the echoes of earlier ones whose centres the axis knows.
    ///
    /// # Errors
    /// [`Error::Solver`](crate::Error::Solver) where the wall's equations have no solution; the wall then stays as it was.
    pub fn push(&mut self, frame: &PlacedFrame, earlier: &[PlacedFrame]) -> Result<Step> {
        let mut step = Step::default();
        let start = Instant::now();
        match frame.centre_mm().map(|centre| self.curve.push(centre)) {
            Some(Growth::Moved { before, moved }) => {
                let (before, moved) = self.move_axis(before, moved);
                step.before = before;
                step.changed.push(moved);
            }
            Some(Growth::Outlier) => step.off_axis = true,
            Some(Growth::None) | None => (),
        }
        let noise_mm = self.judging_noise_mm();
        self.place_pending(noise_mm, &mut step);
        step.axis_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        for earlier in earlier {
            self.place(earlier, false, noise_mm, &mut step);
        }
        let on_wall = self.place(frame, step.off_axis, noise_mm, &mut step);
        step.placing_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        if let Some((low, high)) = on_wall {
            let middle = (low + high) / 2.0;
            let reach = ((high - low) / 2.0 + self.margin()).min(MAX_WINDOW as f64 / 2.0);
            let first = (middle - reach).max(0.0) as usize;
            let window = first..((middle + reach) as usize + 2).min(self.grid.rings);
            self.refit(window, MAX_MEASURED, usize::from(!self.errors_behind), &mut step)?;
        }
        self.refit_background(&mut step)?;
        self.errors_behind = !self.errors_behind;
        step.solving_s = start.elapsed().as_secs_f64();
        step.changed.retain(|range| !range.is_empty());
        Ok(step)
    }

    /// Forgets the echoes of some frames, none of them from before a time, but those that were merged with others, and fits the
    /// wall about them again.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn forget(&mut self, frames: &BTreeSet<u32>, since_s: f64) -> Result<Step> {
        let mut step = Step::default();
        let start = Instant::now();
        let is_kept = |echo: &PendingEcho| !frames.contains(&echo.frame);
        self.untried = self.pending.iter().take(self.untried).filter(|echo| is_kept(echo)).count();
        self.pending.retain(is_kept);
        let mut touched: Option<Range<usize>> = None;
        for k in self.observed.clone() {
            let band = &mut self.bands[k];
            if band.latest_s >= since_s && band.forget(frames, &mut self.residuals) {
                touched = Some(touched.map_or(k..k + 2, |range| range.start..k + 2));
            }
        }
        if let Some(touched) = touched {
            let margin = self.margin() as usize;
            let window = touched.start.saturating_sub(margin)..(touched.end + margin).min(self.grid.rings);
            let window = window.start..window.end.min(window.start + MAX_WINDOW);
            self.refit(window, MAX_MEASURED, 0, &mut step)?;
        }
        step.solving_s = start.elapsed().as_secs_f64();
        step.changed.retain(|range| !range.is_empty());
        Ok(step)
    }

    /// Adds the echoes of earlier frames whose centres the axis knows, and fits the whole wall to all echoes, at last as a sweep
    /// of the whole recording does. `times_s` are those of the frames, by their numbers.
    pub fn finish(
        &mut self,
        earlier: &[PlacedFrame],
        times_s: &[Option<f64>],
        settings: &SweepSettings,
    ) -> Result<Step> {
        let mut step = Step::default();
        let start = Instant::now();
        let noise_mm = self.judging_noise_mm();
        for earlier in earlier {
            self.place(earlier, false, noise_mm, &mut step);
        }
        step.placing_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        for _ in 0..LAST_ROUNDS {
            let window = self.observed.start..self.observed.end + 1;
            if window.len() < 2 {
                break;
            }
            self.renew(&window, usize::MAX, &mut step);
            let solved = self.solve(window, WALLS)?;
            step.rings += solved.len();
            step.changed.push(solved);
        }
        let is_fitted = match self.fit_as_whole(times_s, settings) {
            // The wall as it is remains.
            Err(Error::Solver { .. }) => false,
            done => done?,
        };
        if is_fitted {
            step.rings += self.grid.rings;
            step.changed.push(0..self.grid.rings);
        }
        step.solving_s = start.elapsed().as_secs_f64();
        Ok(step)
    }

    /// Fits the wall to all echoes with a smoothness that follows its own roughness, and replaces the standard errors by those
    /// that the errors of the echoes make. `false`, and no change, where many samples represent several echoes: their noise is
    /// not that of an echo.
    ///
    /// # Errors
    /// [`Error::Solver`], and no change, where the equations have no solution.
    fn fit_as_whole(&mut self, times_s: &[Option<f64>], settings: &SweepSettings) -> Result<bool> {
        let samples = self.bands.iter().flat_map(EchoBand::echoes);
        let (mut echoes, is_merged): (Vec<Echo>, Vec<bool>) = samples.unzip();
        let merged = is_merged.iter().filter(|is| **is).count() as f64;
        // Of a state that was read from a file, too.
        let is_timed = echoes.iter().all(|echo| (echo.frame as usize) < times_s.len());
        let is_known = self.residuals.count() >= MIN_RESIDUALS;
        if merged > MAX_MERGED * echoes.len() as f64 || !is_timed || !is_known {
            return Ok(false);
        }
        echoes.sort_by(|a, b| a.ring.total_cmp(&b.ring));
        let go_on: &Checkpoint = &|| Ok(());
        let wall = Wall {
            radii_mm: self.radii_mm.clone(),
            noise_mm: self.noise_mm(),
            smoothness_mm2: self.smoothness_mm2(),
            // Behind the warm-up of a new wall.
            iterations: LAST_ROUNDS,
            ..Wall::tube(&self.grid, self.grid.radius_mm())
        };
        let mut wall = refit(&self.grid, &mut echoes, self.roughness, wall, go_on)?;
        let mut support = Support::of(&self.grid, &echoes, &wall);
        let moved = |moves_mm: &[DVec3]| {
            let samples = self.bands.iter().flat_map(|band| band.moved(moves_mm, &self.axis));
            let mut echoes: Vec<Echo> = samples.collect();
            echoes.sort_by(|a, b| a.ring.total_cmp(&b.ring));
            echoes
        };
        let moves = settings.frame_shifts == FrameShifts::Auto;
        let movable = moves.then_some(errors::Movable { axis: &self.axis, moved: &moved });
        let frames = errors::Frames { times_s, movable, keeps_out_of_plane: true };
        let found = errors::estimate(&self.grid, frames, settings, &mut echoes, &mut wall, &support, go_on)?;
        if let Some((errors, of_nodes)) = found {
            self.shift_mm = errors.shift_mm();
            support = Support::of(&self.grid, &echoes, &wall);
            support.replace_errors(of_nodes);
        }
        // Residuals are evaluated again when the next frames come.
        for (ring, band) in self.bands.iter_mut().enumerate() {
            let nodes = ring * self.grid.nodes..((ring + 2) * self.grid.nodes).min(self.radii_mm.len());
            let moved = nodes.map(|node| (wall.radii_mm[node] - self.radii_mm[node]).abs());
            band.travel_mm += moved.fold(0.0, f64::max);
        }
        self.radii_mm = wall.radii_mm;
        self.support = support;
        Ok(true)
    }

    /// Adds the echoes of a frame; the rings of the first and the last of them on the wall.
    fn place(
        &mut self,
        frame: &PlacedFrame,
        off_axis: bool,
        noise_mm: f64,
        step: &mut Step,
    ) -> Option<(f64, f64)> {
        let mut on_wall: Option<(f64, f64)> = None;
        for (band, sample, time_s) in self.placed(frame, off_axis) {
            step.changed.extend(self.mark_observed(band));
            step.echoes += 1;
            if let (ring, true) = self.insert(band, sample, time_s, noise_mm) {
                let (low, high) = on_wall.unwrap_or((ring, ring));
                on_wall = Some((low.min(ring), high.max(ring)));
            }
        }
        on_wall
    }

    /// Fits the wall in the background window again, and advances it along the vessel.
    fn refit_background(&mut self, step: &mut Step) -> Result<()> {
        if !(self.observed.start..self.observed.end).contains(&self.background) {
            self.background = self.observed.start;
        }
        let window = self.background..(self.background + BACKGROUND_WINDOW).min(self.observed.end + 1);
        self.background += BACKGROUND_STEP;
        self.refit(window, MAX_MEASURED_BEHIND, usize::from(self.errors_behind), step)
    }

    /// Rings beside the newest echoes that these affect: three times the range of the bending term.
    fn margin(&self) -> f64 {
        let density = self.densities.value() / self.grid.cell_mm2();
        let reach_mm = (self.smoothness_mm2() / density.max(f64::MIN_POSITIVE)).powf(0.25);
        (3.0 * reach_mm / self.grid.step_mm).clamp(2.0, 12.0)
    }

    /// Standard deviation of an echo about the wall, mm; 0 of no residuals yet.
    pub fn noise_mm(&self) -> f64 {
        SD_PER_MAD * self.residuals.value()
    }

    /// Standard deviation of shifts of whole frames along each axis, mm; 0 until the whole wall was fitted.
    pub fn shift_mm(&self) -> f64 {
        self.shift_mm
    }

    /// The noise that residuals are judged by, mm: as much as the lumen's radius until enough of them are known.
    fn judging_noise_mm(&self) -> f64 {
        match self.residuals.count() < MIN_RESIDUALS {
            true => self.grid.radius_mm(),
            false => self.noise_mm(),
        }
    }

    fn smoothness_mm2(&self) -> f64 {
        let noise_mm = self.grid.smoothed_noise_mm(self.noise_mm(), self.roughness);
        (noise_mm / self.roughness).powi(2)
    }

    /// The echoes of a frame about the axis, with their bands; echoes beyond its ends, and all of a frame off the axis, are
    /// postponed.
    fn placed(&mut self, placed_frame: &PlacedFrame, off_axis: bool) -> Vec<(usize, Sample, f64)> {
        let PlacedFrame { number, time_s, world_from_probe, frame, .. } = placed_frame;
        let to_world = |p: glam::DVec2| world_from_probe.transform_point(p.extend(0.0));
        let centre = frame.centroid_mm().or_else(|| frame.echoes_mm().next());
        let near = centre.map_or(0, |centre| self.axis.nearest_ring(to_world(centre)));
        let image_normal = world_from_probe.rotation.z_axis;
        let mut placed = Vec::new();
        for point_mm in frame.echoes_mm().map(to_world) {
            let sample = (!off_axis).then(|| self.sample(point_mm, image_normal, *number, near));
            match sample.flatten() {
                Some((band, sample)) => placed.push((band, sample, *time_s)),
                None => self.postpone(point_mm, image_normal, placed_frame),
            }
        }
        placed
    }

    /// An echo about the axis, and its band; the search starts at ring `near`.
    fn sample(
        &self,
        point_mm: DVec3,
        image_normal: DVec3,
        frame: u32,
        near: usize,
    ) -> Option<(usize, Sample)> {
        let place = self.axis.place(point_mm, near)?;
        let sample = Sample::new(&place, point_mm, image_normal, frame, &self.grid);
        Some((place.ring as usize, sample))
    }

    fn postpone(&mut self, point_mm: DVec3, image_normal: DVec3, frame: &PlacedFrame) {
        if self.pending.len() == MAX_PENDING {
            self.pending.pop_front();
            self.untried = self.untried.saturating_sub(1);
        }
        let PlacedFrame { number, time_s, .. } = *frame;
        self.pending.push_back(PendingEcho { point_mm, image_normal, frame: number, time_s });
    }

    /// Places the pending echoes that the axis has reached by now, as many as a frame has time for.
    fn place_pending(&mut self, noise_mm: f64, step: &mut Step) {
        for _ in 0..self.untried.min(MAX_TRIED) {
            self.untried -= 1;
            let Some(echo) = self.pending.pop_front() else { return };
            step.echoes += 1;
            let last = self.grid.rings - 1;
            let distance = |ring: usize| self.axis.points_mm[ring].distance_squared(echo.point_mm);
            let near = if distance(0) < distance(last) { 0 } else { last };
            match self.sample(echo.point_mm, echo.image_normal, echo.frame, near) {
                Some((band, sample)) => {
                    step.changed.extend(self.mark_observed(band));
                    self.insert(band, sample, echo.time_s, noise_mm);
                }
                None => self.pending.push_back(echo),
            }
        }
    }

    /// Adds a sample to its band; returns the ring of its projection, and whether it lies on the wall.
    fn insert(&mut self, band: usize, sample: Sample, time_s: f64, noise_mm: f64) -> (f64, bool) {
        let scene = scene(&self.grid, &self.radii_mm, &self.axis, noise_mm);
        let band = &mut self.bands[band];
        if let Some(half_life_s) = self.half_life_s.filter(|_| band.latest_s < time_s) {
            band.age((-(time_s - band.latest_s) / half_life_s).exp2());
        }
        band.latest_s = band.latest_s.max(time_s);
        let radius_mm = sample.echo.radius_mm;
        let inserted = band.insert(sample, scene, &mut self.residuals);
        if inserted.1 {
            self.farthest_mm = self.farthest_mm.max(radius_mm);
        }
        inserted
    }

    /// Marks a band as observed. The wall beyond the observed bands continues with the radii of the last observed ring;
    /// returns the rings that change by that.
    fn mark_observed(&mut self, band: usize) -> Option<Range<usize>> {
        let nodes = self.grid.nodes;
        if self.observed.is_empty() {
            self.observed = band..band + 1;
            return None;
        }
        if band >= self.observed.end {
            let end = self.observed.end * nodes;
            let rings = self.observed.end + 1..self.grid.rings;
            rings.clone().for_each(|ring| self.radii_mm.copy_within(end..end + nodes, ring * nodes));
            self.observed.end = band + 1;
            return Some(rings);
        }
        if band < self.observed.start {
            let start = self.observed.start * nodes;
            let rings = 0..self.observed.start;
            rings.clone().for_each(|ring| self.radii_mm.copy_within(start..start + nodes, ring * nodes));
            self.observed.start = band;
            return Some(rings);
        }
        None
    }

    /// Inserts rings in front of the others and behind them.
    fn insert_rings(&mut self, before: usize, behind: usize) {
        let nodes = self.grid.nodes;
        self.grid.rings += before + behind;
        let ends = [0..before, self.grid.rings - behind..self.grid.rings];
        if before > 0 {
            self.bands.iter_mut().for_each(|band| band.renumber(before));
            self.observed = self.observed.start + before..self.observed.end + before;
            self.background += before;
        }
        for (rings, at_front) in ends.into_iter().zip([true, false]) {
            let bands = rings.clone().map(|ring| EchoBand::new(&self.grid, ring));
            let at = if at_front { 0 } else { self.bands.len() };
            self.bands.splice(at..at, bands);
            let count = rings.len() * nodes;
            let at = at * nodes;
            // With the radii of the last ring.
            let end = match self.radii_mm.len() {
                0 => vec![0.0; nodes],
                _ if at_front => self.radii_mm[..nodes].to_vec(),
                length => self.radii_mm[length - nodes..].to_vec(),
            };
            self.radii_mm.splice(at..at, end.into_iter().cycle().take(count));
            self.bins.splice(at..at, std::iter::repeat_n([None; 2], count));
            self.support.insert(at, count);
            self.shared.insert(at_front, rings.len(), nodes);
        }
    }

    /// Moves the rings about the curve's nodes `moved`, after `before` nodes were added in front. Returns the number of rings
    /// added in front, and the rings that moved or are new.
    ///
    /// To first order, wall and sums keep their meaning; the echoes are placed again when their bands are renewed.
    fn move_axis(&mut self, before: usize, moved: Range<usize>) -> (usize, Range<usize>) {
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
        let points_before: Vec<DVec3> = points[changed.clone()].to_vec();
        let frames_before: Vec<DMat3> = frames[changed.clone()].to_vec();
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
        let mut shift_mm = vec![0.0; changed.len() * nodes];
        let mut travel_mm = vec![0.0; changed.len()];
        for (k, ring) in
            changed.clone().enumerate().filter(|(_, ring)| (in_front..in_front + old).contains(ring))
        {
            let shift = self.axis.points_mm[ring] - points_before[k];
            let frame = &self.axis.frames[ring];
            let turn = *frame - frames_before[k];
            let turn =
                [turn.x_axis, turn.y_axis, turn.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max);
            travel_mm[k] = shift.length() + turn * self.grid.radius_mm();
            let (x, y) = (shift.dot(frame.x_axis), shift.dot(frame.y_axis));
            for j in 0..nodes {
                let (sin, cos) = (TAU * j as f64 / nodes as f64).sin_cos();
                shift_mm[k * nodes + j] = -(x * cos + y * sin);
            }
        }
        let first_node = changed.start * nodes;
        self.radii_mm[first_node..].iter_mut().zip(&shift_mm).for_each(|(radius, shift)| *radius += shift);
        for (ring, band) in self.bands.iter_mut().enumerate() {
            band.follow(&changed, &shift_mm);
            if (changed.start.saturating_sub(1)..changed.end).contains(&ring) {
                let of = |ring: usize| ring.checked_sub(changed.start).and_then(|k| travel_mm.get(k));
                band.travel_mm += of(ring).into_iter().chain(of(ring + 1)).copied().fold(0.0, f64::max);
                band.is_misplaced = true;
            }
        }
        self.untried = self.pending.len();
        (in_front, changed)
    }

    /// The band to renew next, of those that have travelled by more than `enough_mm`: one that was begun, or the one whose
    /// last turn was longest ago. If the one that travelled most came first, an end that moves with every frame would keep
    /// all others waiting.
    fn next_due(&self, bands: Range<usize>, enough_mm: f64) -> Option<usize> {
        let is_due = |band: &usize| {
            let band = &self.bands[*band];
            band.is_in_renewal() || band.travel_mm > enough_mm
        };
        bands.filter(is_due).min_by_key(|&band| (!self.bands[band].is_in_renewal(), self.bands[band].turn))
    }

    /// Evaluates up to `budget` residuals again about a window of rings, where wall and axis have moved most.
    fn renew(&mut self, window: &Range<usize>, budget: usize, step: &mut Step) {
        let noise_mm = self.judging_noise_mm();
        let enough_mm = ENOUGH_NOISE_SHARE * noise_mm;
        let bands = window.start.saturating_sub(1)..window.end.min(self.grid.rings - 1);
        let mut left = budget;
        while left > 0
            && let Some(band) = self.next_due(bands.clone(), enough_mm)
        {
            if !self.bands[band].is_in_renewal() {
                self.turns += 1;
                self.bands[band].turn = self.turns;
            }
            let scene = scene(&self.grid, &self.radii_mm, &self.axis, noise_mm);
            let leaving = self.bands[band].renew(scene, &mut self.residuals, false, &mut left);
            for (band, sample) in leaving {
                step.changed.extend(self.mark_observed(band));
                let scene = self::scene(&self.grid, &self.radii_mm, &self.axis, noise_mm);
                self.bands[band].take_in(sample, scene, enough_mm);
            }
        }
        step.echoes += budget - left;
    }

    /// Fits the wall in a window of rings again: up to `budget` residuals are evaluated anew, and the wall is solved for.
    fn refit(
        &mut self,
        window: Range<usize>,
        budget: usize,
        of_errors: usize,
        step: &mut Step,
    ) -> Result<()> {
        let window = window.start.max(self.observed.start)..window.end.min(self.observed.end + 1);
        if window.len() >= 2 {
            self.renew(&window, budget, step);
            let solved = self.solve(window, of_errors)?;
            step.rings += solved.len();
            step.changed.push(solved);
        }
        Ok(())
    }

    /// Solves for the wall in a window of observed rings with all others fixed, and for so many of the walls that show its
    /// errors. Returns the rings.
    fn solve(&mut self, window: Range<usize>, of_errors: usize) -> Result<Range<usize>> {
        let (nodes, all) = (self.grid.nodes, self.grid.rings);
        let smoothness = self.smoothness_mm2();
        let beside = |margin: usize| window.start.saturating_sub(margin)..(window.end + margin).min(all);
        let (solved, supporting) = (beside(2), beside(SUPPORT_MARGIN));
        let grid = WallGrid { rings: solved.len(), ..self.grid };
        let mut equations = Equations::over(&self.grid, solved.clone());
        let mut tally = Tally::new(supporting.len() * nodes);
        let bands = beside(MAX_PROJECTION + SUPPORT_MARGIN);
        for band in &self.bands[bands.clone()] {
            let sums = &band.sums;
            if sums.rings.is_empty() {
                continue;
            }
            equations.merge(&sums.equations);
            tally.merge(
                sums.rings.start.saturating_sub(supporting.start) * nodes,
                &sums.tally,
                supporting.start.saturating_sub(sums.rings.start) * nodes,
            );
        }
        let first = solved.start * nodes;
        let x = &self.radii_mm[first..solved.end * nodes];
        let free = window.start - solved.start..window.end - solved.start;
        let free_nodes = free.start * nodes..free.end * nodes;
        let operator = Operator::of(&equations, &grid, smoothness, LocalSmoothness::EVEN);
        let mut product = vec![0.0; x.len()];
        operator.apply(x, &mut product);
        let equations = equations.of_change(&grid, smoothness, &product, free.clone());
        let matrix = Operator::of(&equations, &grid, smoothness, LocalSmoothness::EVEN);
        let solver = Solver::of(&matrix)?;
        let change_of = |right: &[f64]| -> Result<Vec<f64>> {
            let mut change = vec![0.0; right.len()];
            solver.solve(right, &|_, _| (), SOLVED_SHARE, MAX_STEPS, &mut change)?;
            Ok(change)
        };
        let right: Vec<f64> = equations.rows().iter().map(|row| row[4]).collect();
        let change = change_of(&right)?;
        for _ in 0..of_errors {
            let wall = self.shared.next(&window);
            let mut right = match wall {
                WallOf::Residuals(k) => self.pulls(k, &bands, &solved),
                WallOf::Remains(k) => {
                    // What the wall through the residuals leaves of them is what its bending takes.
                    let mut right = vec![0.0; product.len()];
                    let drawn = self.shared.at(WallOf::Residuals(k), first..solved.end * nodes);
                    Operator::lumped(
                        &grid,
                        vec![0.0; drawn.len()],
                        smoothness,
                        LocalSmoothness::EVEN.clone(),
                    )
                    .apply(&drawn, &mut right);
                    right
                }
            };
            operator.apply(&self.shared.at(wall, first..solved.end * nodes), &mut product);
            for (node, (right, product)) in right.iter_mut().zip(&product).enumerate() {
                *right = if free_nodes.contains(&node) { *right - product } else { 0.0 };
            }
            let change = change_of(&right)?;
            self.shared.add(wall, first + free_nodes.start, &change[free_nodes.clone()]);
        }
        for ring in free {
            let travel = &change[ring * nodes..(ring + 1) * nodes];
            let ring = ring + solved.start;
            let farthest = travel.iter().fold(0.0_f64, |max, t| max.max(t.abs()));
            self.radii_mm[ring * nodes..(ring + 1) * nodes].iter_mut().zip(travel).for_each(|(r, t)| *r += t);
            for band in &mut self.bands[ring.saturating_sub(1)..=ring] {
                band.travel_mm += farthest;
            }
        }
        self.update_support(&window, &supporting, &tally);
        Ok(window)
    }

    /// The right-hand side of the wall through the residuals with signs `k`, over the rings `solved`.
    fn pulls(&self, k: usize, bands: &Range<usize>, solved: &Range<usize>) -> Vec<f64> {
        let nodes = self.grid.nodes;
        let mut right = vec![0.0; solved.len() * nodes];
        for band in &self.bands[bands.clone()] {
            let Pulls(pulls) = &band.sums.pulls;
            let first = band.sums.rings.start * nodes;
            let skipped = (solved.start * nodes).saturating_sub(first).min(pulls.len());
            let at = (first + skipped).saturating_sub(solved.start * nodes).min(right.len());
            right[at..]
                .iter_mut()
                .zip(&pulls[skipped..])
                .for_each(|(right, pull)| *right += f64::from(pull[k]));
        }
        right
    }

    /// Updates the support of a window's nodes by the echoes of the rings `supporting`.
    fn update_support(&mut self, window: &Range<usize>, supporting: &Range<usize>, tally: &Tally) {
        let nodes = self.grid.nodes;
        let smoothness = self.smoothness_mm2();
        let grid = WallGrid { rings: supporting.len(), ..self.grid };
        let density = self.densities.value() / grid.cell_mm2();
        // Echoes whose residuals are still to be evaluated have none, and are not certain for that.
        let statistics = tally.statistics(&grid, density, smoothness, self.noise_mm());
        let max_mm = max_error_mm(self.errors.value(), &grid);
        let offset = supporting.start * nodes;
        let own: Vec<f64> = tally.own().collect();
        // Half of a thin plate's variance is the echoes', the other half the bends'.
        let plate_mm = &statistics.errors.standard_error_mm;
        let variance_mm2: Vec<f64> = plate_mm.iter().map(|plate| 0.5 * plate * plate).collect();
        let independent = Independent {
            grid: &grid,
            variance_mm2: &variance_mm2,
            alike_mm: &statistics.errors.reach_mm,
            weight: &own,
            reach_mm: (smoothness / density.max(f64::MIN_POSITIVE)).powf(0.25),
        };
        let errors = self.shared.node_errors(window, supporting.start, &independent);
        for (place, node) in (window.start * nodes..window.end * nodes).enumerate() {
            let here = node - offset;
            let plate_mm = plate_mm[here];
            let [density_bin, error_bin] = &mut self.bins[node];
            recount(&mut self.densities, density_bin, Some(own[here]).filter(|n| *n > 0.0));
            recount(&mut self.errors, error_bin, Some(plate_mm).filter(|e| e.is_finite()));
            self.support.echoes[node] = own[here].round() as u32;
            self.support.residual_mm[node] = statistics.residual_mm[here];
            self.support.standard_error_mm[node] = errors.standard_error_mm[place];
            self.support.error_reach_mm[node] = errors.reach_mm[place];
            self.support.last_frame[node] = tally.last_frame[here];
            self.support.supported[node] = plate_mm <= max_mm
                && !statistics.is_mouth[here]
                && is_in_reach(self.radii_mm[node], self.farthest_mm);
        }
    }
}

/// What samples are measured about.
fn scene<'a>(grid: &'a WallGrid, radii_mm: &'a [f64], axis: &'a Axis, noise_mm: f64) -> Scene<'a> {
    Scene { model: ResidualModel::new(grid, radii_mm, noise_mm, OUT_OF_PLANE), axis }
}

/// Replaces a value in a running median.
fn recount(median: &mut RunningMedian, bin: &mut Option<u16>, value: Option<f64>) {
    if let Some(before) = bin.take() {
        median.remove(before);
    }
    *bin = value.map(|value| median.add(value));
}
