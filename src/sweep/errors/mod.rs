//! The errors of a recording, estimated from what the wall leaves unexplained, and the standard errors that follow.
//!
//! Errors of neighbouring rays, or of successive frames, are alike: a tracker shifts whole frames, and a segmentation
//! misses the wall over an arc and for a while. Many such echoes say less than as many independent ones. Second moments of
//! the residuals ([`moments`]) show which kinds of errors ([`process`]) a recording has. What each kind leaves of itself in
//! the residuals, and how much of it the wall takes up, is found by drawing it at random and fitting the wall to the draws
//! ([`smoother`]): the fit is linear in the echoes. Levels of the kinds are those whose moments add up to the recording's.
//! What lasts longer than the wall was seen anywhere leaves nothing in the residuals, and is in no standard error.
//! The wall's own bends are one of the kinds; where the wall is rougher or smoother than its prior expects is found in the
//! same way, so that smoothing can follow the vessel. Where single frames are shifted, and the wall gains by it, their shifts
//! are taken off the poses ([`shifts`]).

mod moments;
pub(super) mod process;
mod shifts;
pub(super) mod smoother;

use super::prepare::axis::Axis;
use super::prepare::echo::Echo;
use super::prepare::grid::WallGrid;
use super::support::{NodeErrors, Support};
use super::wall::bending::LocalSmoothness;
use super::wall::engine::refit;
use super::wall::fit::{Checkpoint, Wall};
use super::wall::residual::is_inlier;
use crate::Result;
use crate::numerics::nonnegative::nonnegative_least_squares;
use crate::numerics::robust::median;
use crate::recording::FRAME_INTERVAL_S;
use crate::recording::echo_error::{CONTOUR_OUT_OF_PLANE, OUT_OF_PLANE};
use crate::settings::SweepSettings;
use glam::DVec3;
use moments::{Sectors, Sums};
use process::{Process, SLOWEST_BREATH_HZ, Seen, add_draw, frequency_hz, random};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use shifts::{ShiftEstimator, Told};
use smoother::{Smoother, linearised};

/// Errors of a recording, as far as its echoes show them.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct RecordingErrors {
    /// Standard deviation of the errors that every echo has for itself, mm.
    pub rays_mm: f64,
    /// Shifts that the echoes of a frame have in common: the tracker's.
    pub shifts: Vec<AlikeErrors>,
    /// Errors of the contours that are alike along the wall.
    pub contours: Vec<AlikeErrors>,
    /// Oscillations of the lumen's size, and of the place of whole frames.
    pub beats: Vec<Beat>,
    /// What of the shifts was taken off the poses; `None` where the frames are left as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corrected: Option<CorrectedShifts>,
    /// For how long a place of the wall was seen, s: the median over the supported wall. Errors that are alike for longer
    /// move the wall as a whole and show in no residual, so that standard errors are without them.
    pub seen_for_s: f64,
    /// Roughness of the wall, as `sweep.roughness` counts it: the median over the supported nodes.
    pub roughness: f64,
    /// Number of descriptions that suit the echoes equally well. The first one is given here; standard errors are a mean
    /// over all.
    pub descriptions: usize,
}

/// Errors that are alike in neighbouring echoes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AlikeErrors {
    /// Standard deviation, mm; of a shift along each axis.
    pub sd_mm: f64,
    /// Width about the lumen over which they are alike, degrees; `None` for a shift of the whole frame.
    pub width_deg: Option<f64>,
    /// Time over which they are forgotten, s; 0 where every frame has its own.
    pub correlation_s: f64,
}

/// Shifts of single frames, each against the frames about it, that were taken off the poses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CorrectedShifts {
    /// Frames that were moved.
    pub frames: usize,
    /// Root mean square of the shifts along each axis across the vessel, mm.
    pub rms_mm: f64,
}

/// An oscillation that the echoes show.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Beat {
    /// Standard deviation, mm; of a shift along each axis.
    pub sd_mm: f64,
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Whether frames are shifted as a whole; otherwise the lumen widens and narrows.
    pub is_shift: bool,
}

/// Smallest recording whose errors are estimated: frames, and echoes.
const MIN_FRAMES: usize = 24;
const MIN_ECHOES: usize = 500;
/// Draws of the kinds of errors that every recording has, the bends behind the roughness among them, and of each other kind.
const BASE_DRAWS: usize = 3;
const OTHER_DRAWS: usize = 1;
/// Draws of errors behind the roughness, and behind the standard errors.
const ROUGHNESS_DRAWS: usize = 3;
const VARIANCE_DRAWS: usize = 8;
/// Residuals beyond this many standard deviations of the noise count as that many.
const MAX_SDS: f64 = 3.0;
/// Accuracy of the moments at best: a share of their own, and of the residuals' variance.
const MOMENT_SHARE: f64 = 0.03;
const VARIANCE_SHARE: f64 = 0.001;
/// Further kinds are tried where the mean square misfit of the moments, in variances of theirs, exceeds `POOR_FIT` (a wall that
/// is rougher in some places than in others leaves nearly as much by itself) and until it is below `GOOD_FIT`, …
const POOR_FIT: f64 = 2.0;
const GOOD_FIT: f64 = 1.5;
/// … and kept where they lower the sum of squares by this share, and by this much.
const MIN_GAIN_SHARE: f64 = 0.2;
const MIN_GAIN: f64 = 8.0;
/// Other descriptions are as good where their sum of squares exceeds the best by at most this share and this much.
const SAME_SHARE: f64 = 0.15;
const SAME: f64 = 3.0;
/// Correlation times of shifts and contours, in intervals of the frames, and widths of the contours' errors, degrees.
const CORRELATION_FRAMES: [f64; 3] = [3.0, 12.0, 48.0];
const WIDTHS_DEG: [f64; 2] = [20.0, 40.0];
/// Squared roughness of a wall, in units of the setting's; that about a node does not count as less than `MIN_NODE` in
/// standard errors, since it is hard to tell from 0.
const MIN_RATIO: f64 = 0.16;
const MIN_NODE: f64 = 0.25;
const MAX_RATIO: f64 = 64.0;
/// Least squared roughness that the sums of rings show.
const MIN_SUM: f64 = 0.04;
/// Largest squared roughness of a ring that smoothing follows: at the mouths of branches echoes of these make it seem rough.
const MAX_RING: f64 = 9.0;
/// Largest design effect that smoothing makes up for: how much more variance more smoothing takes off a wall whose echoes err
/// alike than off one where they err independently. Waves of the errors that are longer than the reach of an echo are not smoothed
/// away, and do not count.
const MAX_DESIGN_EFFECT: f64 = 4.0;
/// Largest share of the variance across the image planes: directions of echoes that have more of it there are hardly told apart.
const MAX_OUT_OF_PLANE: f64 = 0.5;
/// Distances over which statistics are averaged, in reaches of an echo.
const RING_REACHES: f64 = 1.0;
const NODE_REACHES: f64 = 3.0;
const VARIANCE_REACHES: f64 = 2.0;

/// Levels of some kinds of errors: variances, mm².
type Levels = Vec<(Process, f64)>;

/// What smoothing and standard errors need to know of a recording's errors.
struct Estimate {
    /// Descriptions that suit the echoes, the best one first.
    descriptions: Vec<Levels>,
    /// Squared roughness of the wall about each node, in units of the setting's.
    of_nodes: Vec<f64>,
    /// The same of each ring, over the design effect: the inverse of the factor of λ.
    of_rings: Vec<f64>,
    /// Squared roughness that the sums of rings show: what makes a whole ring too narrow or too wide.
    of_sums: Vec<f64>,
}

/// Residuals of the echoes, mm, and whether each is a single one on the wall.
#[derive(Clone, Copy)]
struct Residuals<'a> {
    values_mm: &'a [f64],
    is_on_wall: &'a [bool],
    /// For how long a place of the wall was seen, s.
    seen_for_s: f64,
}

/// Squared roughness of a wall in units of the setting's, and what the errors make of the wall.
struct Roughness {
    /// About each node.
    of_nodes: Vec<f64>,
    /// What more smoothing would take off the variances of the nodes, mm².
    smoothable: Vec<f64>,
    /// As the sums of rings show it.
    sums: Vec<f64>,
}

/// Bends of a wall that is as rough as the smoothing assumes.
struct Bends {
    /// The residuals of the echoes that come with them, mm.
    residuals_mm: Vec<f64>,
    /// The wall through these, mm.
    found_mm: Vec<f64>,
}

impl Bends {
    fn drawn(smoother: &Smoother, draws: usize) -> Result<Vec<Self>> {
        let of_draw = |draw| {
            let bends_mm = smoother.bends(draw, None)?;
            let residuals_mm: Vec<f64> = smoother.residuals_of_bends(&bends_mm).collect();
            Ok(Self { found_mm: smoother.wall(residuals_mm.iter().copied())?, residuals_mm })
        };
        (0..draws).into_par_iter().map(of_draw).collect()
    }
}

/// The frames that the echoes come from, by their numbers.
#[derive(Clone, Copy)]
pub(super) struct Frames<'a> {
    /// When they were taken, s.
    pub times_s: &'a [Option<f64>],
    /// `None` where frames must stay where they are.
    pub movable: Option<Movable<'a>>,
    /// Whether the share of the variance across the images stays that of the wall: where the poses were corrected, in the
    /// search for motion, and live.
    pub keeps_out_of_plane: bool,
}

/// Frames whose shifts may be taken off their poses.
#[derive(Clone, Copy)]
pub(super) struct Movable<'a> {
    pub axis: &'a Axis,
    /// The echoes where each frame is moved by so much, mm.
    pub moved: &'a dyn Fn(&[DVec3]) -> Vec<Echo>,
}

/// Whether so many frames and these echoes suffice to estimate errors.
pub(super) fn suffice(frames: usize, echoes: &[Echo]) -> bool {
    frames >= MIN_FRAMES && echoes.len() >= MIN_ECHOES
}

/// Estimates the errors of a recording, fits the wall again with a smoothness that follows its roughness and without shifts of
/// single frames, and replaces the standard errors of the nodes. `None`, and no change, where there are too few echoes for it, or
/// they are perfect.
pub(super) fn estimate(
    grid: &WallGrid,
    frames: Frames,
    settings: &SweepSettings,
    echoes: &mut Vec<Echo>,
    wall: &mut Wall,
    support: &Support,
    checkpoint: &Checkpoint,
) -> Result<Option<(RecordingErrors, NodeErrors)>> {
    let roughness = settings.roughness;
    let perfect = wall.noise_mm.is_nan() || wall.noise_mm <= 1e-9 * grid.radius_mm();
    let Frames { times_s, mut movable, keeps_out_of_plane } = frames;
    if !suffice(times_s.len(), echoes) || perfect {
        return Ok(None);
    }
    let mut recording = Recorded::of(grid, times_s, echoes, &support.supported);
    let mut estimate = recording.estimate(roughness, echoes, wall)?;
    // Without noise the grid smooths more than the echoes ask for.
    if !settings.even_smoothness && wall.noise_mm > grid.cell_noise_mm(roughness) {
        if !keeps_out_of_plane {
            wall.out_of_plane = out_of_plane(&estimate.descriptions);
        }
        wall.local = LocalSmoothness::of(estimate.of_rings.iter().map(|ratio| ratio.recip()).collect());
        *wall = refit(grid, echoes, roughness, wall.clone(), checkpoint)?;
    } else {
        estimate.of_rings.fill(1.0);
        movable = None;
    }
    let mut linear = linearised(grid, echoes, wall);
    let mut told = None;
    let mut corrected = None;
    if let Some(Movable { axis, moved }) = movable
        && let Some(found) = recording.told_shifts(&estimate, echoes, wall)
    {
        let estimator = ShiftEstimator::of(&found, &recording, axis, echoes, wall, &linear.0);
        let smoother = Smoother::of(grid, &linear, wall.smoothness_mm2, roughness)?;
        if found.pays(&estimator, &recording, &smoother)? {
            let shifts_mm = estimator.shifts_mm(&clamped_residuals_mm(echoes, wall));
            let mut moves_mm = vec![DVec3::ZERO; times_s.len()];
            for (&frame, shift_mm) in recording.frames.iter().zip(&shifts_mm) {
                moves_mm[frame] = -*shift_mm;
            }
            *echoes = moved(&moves_mm);
            // Across the images there is still what moves the frames along the vessel.
            wall.out_of_plane = OUT_OF_PLANE;
            wall.residual_model(grid).project_all(echoes);
            *wall = refit(grid, echoes, roughness, wall.clone(), checkpoint)?;
            recording = Recorded::of(grid, times_s, echoes, &support.supported);
            linear = linearised(grid, echoes, wall);
            told = Some(ShiftEstimator::of(&found, &recording, axis, echoes, wall, &linear.0));
            let squares: f64 = shifts_mm.iter().map(|shift_mm| shift_mm.length_squared()).sum();
            // Two axes lie across the vessel.
            let rms_mm = (squares / (2 * shifts_mm.len()) as f64).sqrt();
            corrected = Some(CorrectedShifts { frames: shifts_mm.len(), rms_mm });
        }
    }
    let smoother = Smoother::of(grid, &linear, wall.smoothness_mm2, roughness)?;
    let of_nodes = recording.node_errors(&estimate, &smoother, told.as_ref(), echoes, wall)?;
    let of_supported = estimate.of_nodes.iter().zip(&support.supported).filter(|(_, s)| **s);
    let median_ratio = median(&mut of_supported.map(|(ratio, _)| *ratio).collect::<Vec<_>>());
    let mut errors = RecordingErrors::of(&estimate.descriptions, roughness * median_ratio.sqrt());
    errors.corrected = corrected;
    errors.seen_for_s = recording.seen_for_s(echoes, recording.reach_mm(echoes, wall));
    Ok(Some((errors, of_nodes)))
}

/// Share of an echo's variance that lies across its image plane: shifts of frames lie in all directions, other errors within it.
fn out_of_plane(descriptions: &[Levels]) -> f64 {
    let variance_mm2 = |of_frames: bool| -> f64 {
        let levels = descriptions.iter().flatten().filter(|(process, _)| match process {
            Process::Shift { .. } | Process::Beat { order: 1.., .. } => of_frames,
            Process::Wall => false,
            _ => !of_frames,
        });
        levels.map(|(_, variance_mm2)| variance_mm2).sum()
    };
    let [of_frames, others] = [true, false].map(variance_mm2);
    let share = of_frames / (of_frames + others);
    if share.is_finite() { share.clamp(CONTOUR_OUT_OF_PLANE, MAX_OUT_OF_PLANE) } else { OUT_OF_PLANE }
}

/// A recording about its grid.
struct Recorded<'a> {
    grid: &'a WallGrid,
    /// The frames with echoes, by their numbers.
    frames: Vec<usize>,
    /// When they were taken, s.
    times_s: Vec<f64>,
    seen: Vec<Seen>,
    /// Of each echo, the errors that single echoes have for themselves: less than 1 where one stands for several, whose mean it
    /// is. Empty where none does.
    own_errors: Vec<f64>,
    supported: &'a [bool],
}

impl<'a> Recorded<'a> {
    fn of(grid: &'a WallGrid, of_frames_s: &[Option<f64>], echoes: &[Echo], supported: &'a [bool]) -> Self {
        let mut has_echoes = vec![false; of_frames_s.len()];
        echoes.iter().for_each(|echo| has_echoes[echo.frame as usize] = true);
        let frames: Vec<usize> = (0..of_frames_s.len()).filter(|&k| has_echoes[k]).collect();
        let (mut times_s, mut numbers) = (Vec::new(), vec![0; of_frames_s.len()]);
        for &k in &frames {
            numbers[k] = times_s.len() as u32;
            let next_s = times_s.last().map_or(0.0, |before| before + FRAME_INTERVAL_S);
            times_s.push(of_frames_s[k].unwrap_or(next_s));
        }
        let seen = |echo: &Echo| Seen::new(echo.theta_rad(grid.nodes), numbers[echo.frame as usize]);
        let own_errors = match echoes.iter().any(|echo| echo.weight > 1.0) {
            true => echoes.iter().map(|echo| f64::from(echo.weight.max(1.0)).sqrt().recip()).collect(),
            false => Vec::new(),
        };
        Self { grid, frames, times_s, seen: echoes.par_iter().map(seen).collect(), own_errors, supported }
    }

    /// Adds a draw of a process, times `sd_mm`, to the errors of the echoes.
    fn add_draw(&self, process: Process, sd_mm: f64, rng: &mut ChaCha8Rng, errors_mm: &mut [f64]) {
        if self.own_errors.is_empty() || !process.is_white() {
            return add_draw(process, sd_mm, rng, &self.seen, &self.times_s, errors_mm);
        }
        let mut of_single_mm = vec![0.0; errors_mm.len()];
        add_draw(process, sd_mm, rng, &self.seen, &self.times_s, &mut of_single_mm);
        let draws = of_single_mm.iter().zip(&self.own_errors);
        errors_mm.iter_mut().zip(draws).for_each(|(error, (drawn, share))| *error += drawn * share);
    }

    /// Median over the rings with supported nodes of the time between the first and the last echo within a distance, s.
    fn seen_for_s(&self, echoes: &[Echo], within_mm: f64) -> f64 {
        let WallGrid { rings, nodes, step_mm, .. } = *self.grid;
        let mut spans = vec![[f64::INFINITY, f64::NEG_INFINITY]; rings];
        for (echo, seen) in echoes.iter().zip(&self.seen) {
            let [first, last] = &mut spans[(echo.ring.max(0.0) as usize).min(rings - 1)];
            let time_s = self.times_s[seen.frame as usize];
            (*first, *last) = (first.min(time_s), last.max(time_s));
        }
        let away = (within_mm / step_mm).round() as usize;
        let is_supported = |k: &usize| self.supported[k * nodes..(k + 1) * nodes].contains(&true);
        let span_s = |k: usize| {
            let about = &spans[k.saturating_sub(away)..(k + away + 1).min(rings)];
            let [first, last] =
                about.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[first, last], span| {
                    [first.min(span[0]), last.max(span[1])]
                });
            last - first
        };
        let spans_s = (0..rings).filter(is_supported).map(span_s).filter(|s| s.is_finite());
        median(&mut spans_s.collect::<Vec<_>>())
    }

    /// Median time from one frame to the next, s.
    fn interval_s(&self) -> f64 {
        let intervals = self.times_s.windows(2).map(|t| t[1] - t[0]).filter(|d| *d > 0.0);
        median(&mut intervals.collect::<Vec<_>>())
    }

    /// Kinds that are tried where rays, frames of their own and the wall's bends do not explain the residuals.
    fn other_kinds(&self) -> Vec<Process> {
        let interval_s = self.interval_s();
        let correlations = CORRELATION_FRAMES.map(|frames| frames * interval_s);
        let shifts = correlations.iter().map(|&correlation_s| Process::Shift { correlation_s });
        let contours = WIDTHS_DEG.iter().flat_map(|width_deg| {
            let width_rad = width_deg.to_radians();
            let of_width = move |correlation_s| Process::Contour { width_rad, correlation_s };
            std::iter::once(0.0).chain(correlations).map(of_width)
        });
        shifts.chain(contours).collect()
    }

    fn estimate(&self, roughness: f64, echoes: &[Echo], wall: &Wall) -> Result<Estimate> {
        let linearised = linearised(self.grid, echoes, wall);
        let smoother = Smoother::of(self.grid, &linearised, wall.smoothness_mm2, roughness)?;
        let residuals_mm = clamped_residuals_mm(echoes, wall);
        // One that stands for several has other moments.
        let counts = |echo: &Echo| echo.weight <= 1.0 && is_inlier(echo, wall.noise_mm);
        let is_on_wall: Vec<bool> = echoes.iter().map(counts).collect();
        let sectors = Sectors::of(&self.seen, &is_on_wall, self.times_s.len());
        let (found_mm, bends) = rayon::join(
            || smoother.wall(residuals_mm.iter().copied()),
            || Bends::drawn(&smoother, BASE_DRAWS),
        );
        let (found_mm, bends) = (found_mm?, bends?);
        let reach_mm = self.reach_mm(echoes, wall);
        let roughness_for =
            |descriptions: &[Levels]| self.roughness(&smoother, &found_mm, &bends, reach_mm, descriptions);
        let seen_for_s = self.seen_for_s(echoes, reach_mm);
        let residuals = Residuals { values_mm: &residuals_mm, is_on_wall: &is_on_wall, seen_for_s };
        let descriptions = self.descriptions(&smoother, &sectors, residuals, &bends, &roughness_for)?;
        let Roughness { of_nodes, smoothable, sums } = roughness_for(&descriptions)?;

        let design_effect = self.design_effect(&smoothable, reach_mm, wall).clamp(1.0, MAX_DESIGN_EFFECT);
        // Geometric means: one rough place of a ring should not leave the noise of all others in.
        let logarithms: Vec<f64> = of_nodes.iter().map(|ratio| ratio.ln()).collect();
        let of_ring =
            |mean: &f64| if mean.is_finite() { mean.exp().min(MAX_RING) / design_effect } else { 1.0 };
        let of_rings =
            self.averaged_rings(&logarithms, RING_REACHES * reach_mm).iter().map(of_ring).collect();
        Ok(Estimate { descriptions, of_nodes, of_rings, of_sums: sums })
    }

    /// How much more variance more smoothing takes off the wall than off one whose echoes err independently.
    ///
    /// The fit S passes a wave of wave number k on with s = 1/(1 + (ℓk)⁴), and ds/d ln λ = -s(1 - s): with λ, the variance of a
    /// wall with the errors e falls by 2 Se·S(1 - S)e. Echoes of the standard deviation σ that err independently give it the
    /// variance (σℓ)²/16λ, a quarter of which is Se·S(1 - S)e.
    fn design_effect(&self, smoothable: &[f64], reach_mm: f64, wall: &Wall) -> f64 {
        let independent = (wall.noise_mm * reach_mm).powi(2) / (64.0 * wall.smoothness_mm2);
        let of_supported = smoothable.iter().zip(self.supported).filter(|(_, s)| **s).map(|(e, _)| *e);
        let (sum, count) = of_supported.fold((0.0, 0.0), |(sum, count), e| (sum + e, count + 1.0));
        sum / count / independent
    }

    /// The roughness of the wall where the residuals are, smoothed, `found_mm`, and errors are described so.
    fn roughness(
        &self,
        smoother: &Smoother,
        found_mm: &[f64],
        bends: &[Bends],
        reach_mm: f64,
        descriptions: &[Levels],
    ) -> Result<Roughness> {
        let fields: Vec<[Vec<f64>; 2]> = (0..ROUGHNESS_DRAWS)
            .into_par_iter()
            .map(|draw| {
                let errors_mm = self.drawn(&descriptions[draw % descriptions.len()], draw);
                let wall_mm = smoother.wall(errors_mm.iter().copied())?;
                let of_residuals_mm = smoother.wall(smoother.residuals(&errors_mm, &wall_mm))?;
                Ok([wall_mm, of_residuals_mm])
            })
            .collect::<Result<_>>()?;
        let noise = mean_squares(fields.iter().map(|[_, of_residuals_mm]| of_residuals_mm));
        let products = |[wall_mm, of_residuals_mm]: &[Vec<f64>; 2]| {
            wall_mm.iter().zip(of_residuals_mm).map(|(a, b)| a * b).collect()
        };
        let smoothable = mean(fields.iter().map(products));
        let bent = mean_squares(bends.iter().map(|bends| &bends.found_mm));
        let found: Vec<f64> = found_mm.iter().map(|x| x * x).collect();
        let [found, noise, bent] = self.averaged([&found, &noise, &bent], NODE_REACHES * reach_mm);
        let ratio = |least: f64, found: f64, noise: f64, bends: f64| {
            let ratio = (found - noise) / bends;
            if ratio.is_finite() { ratio.clamp(least, MAX_RATIO) } else { 1.0 }
        };
        let of_nodes: Vec<f64> =
            (0..self.grid.node_count()).map(|n| ratio(MIN_RATIO, found[n], noise[n], bent[n])).collect();
        let weights = gaussian(RING_REACHES * reach_mm / self.grid.step_mm, self.grid.rings);
        let noise_sums = mean(fields.iter().map(|[_, noise]| self.squared_sums(noise)));
        let bent_sums = mean(bends.iter().map(|bends| self.squared_sums(&bends.found_mm)));
        let [found, noise, bent] =
            [self.squared_sums(found_mm), noise_sums, bent_sums].map(|sums| smoothed_along(&weights, &sums));
        let sums = (0..self.grid.rings).map(|k| ratio(MIN_SUM, found[k], noise[k], bent[k])).collect();
        Ok(Roughness { of_nodes, smoothable, sums })
    }

    /// Of each ring: the square of the sum over its supported nodes.
    fn squared_sums(&self, field: &[f64]) -> Vec<f64> {
        let nodes = self.grid.nodes;
        let of_ring = |(ring, supported): (&[f64], &[bool])| {
            let sum: f64 = ring.iter().zip(supported).filter(|(_, s)| **s).map(|(x, _)| x).sum();
            sum * sum
        };
        field.chunks_exact(nodes).zip(self.supported.chunks_exact(nodes)).map(of_ring).collect()
    }

    /// Descriptions of the errors by which the moments of the residuals are explained, the best one first.
    fn descriptions(
        &self,
        smoother: &Smoother,
        sectors: &Sectors,
        residuals: Residuals,
        bends: &[Bends],
        roughness: &dyn Fn(&[Levels]) -> Result<Roughness>,
    ) -> Result<Vec<Levels>> {
        let found = sectors.sums(residuals.values_mm.iter().copied());
        let (moments, scatter) = (sectors.means(&found), sectors.errors(&found));
        let variance = moments[0];
        let scales: Vec<f64> = moments
            .iter()
            .zip(scatter)
            .map(|(m, s)| {
                (s * s + (MOMENT_SHARE * m).powi(2) + (VARIANCE_SHARE * variance).powi(2)).sqrt().recip()
            })
            .collect();
        let scaled = |of: &[f64]| -> Vec<f64> { of.iter().zip(&scales).map(|(m, s)| m * s).collect() };
        let target = scaled(&moments);
        let columns = |kinds: &[Process],
                       draws: usize,
                       first: usize,
                       rougher: Option<&[f64]>|
         -> Result<Vec<Vec<f64>>> {
            let jobs: Vec<(usize, usize)> =
                (0..kinds.len()).flat_map(|kind| (0..draws).map(move |draw| (kind, draw))).collect();
            let sums: Vec<Sums> = jobs
                .par_iter()
                .map(|&(kind, draw)| {
                    Ok(match (kinds[kind], rougher) {
                        (Process::Wall, None) => sectors.sums(bends[draw].residuals_mm.iter().copied()),
                        (Process::Wall, rougher) => {
                            let bends_mm = smoother.bends(draw, rougher)?;
                            sectors.sums(smoother.residuals_of_bends(&bends_mm))
                        }
                        (process, _) => {
                            let mut errors_mm = vec![0.0; self.seen.len()];
                            let rng = &mut random(draw, first + kind);
                            self.add_draw(process, 1.0, rng, &mut errors_mm);
                            let wall_mm = smoother.wall(errors_mm.iter().copied())?;
                            sectors.sums(smoother.residuals(&errors_mm, &wall_mm))
                        }
                    })
                })
                .collect::<Result<_>>()?;
            let mean = |kind: usize| {
                let of_kind = sums[kind * draws..(kind + 1) * draws].iter().map(|sums| sectors.means(sums));
                let total = of_kind.reduce(|a, b| a.iter().zip(b).map(|(a, b)| a + b).collect());
                total.unwrap_or_default().iter().map(|m| m / draws as f64).collect::<Vec<f64>>()
            };
            Ok((0..kinds.len()).map(|kind| scaled(&mean(kind))).collect())
        };
        let mut kinds = vec![Process::Ray, Process::Shift { correlation_s: 0.0 }, Process::Wall];
        let base = kinds.len();
        let mut of_kinds = columns(&kinds, BASE_DRAWS, 0, None)?;
        let explain = |of_kinds: &[Vec<f64>], chosen: &[usize]| {
            let columns: Vec<&[f64]> = chosen.iter().map(|&k| &of_kinds[k][..]).collect();
            nonnegative_least_squares(&columns, &target)
        };
        let mut chosen: Vec<usize> = (0..base).collect();
        let levels = |kinds: &[Process], of_kinds: &[Vec<f64>], chosen: &[usize]| -> Levels {
            let (levels, _) = explain(of_kinds, chosen);
            chosen.iter().map(|&k| kinds[k]).zip(levels).filter(|(_, level)| *level > 0.0).collect()
        };
        let exceeds = |misfit: f64, mean_square: f64| misfit > mean_square * target.len() as f64;
        let (_, mut misfit) = explain(&of_kinds, &chosen);
        if exceeds(misfit, POOR_FIT) {
            // A wall that is rougher in places leaves other moments than one that is equally rough everywhere.
            let Roughness { of_nodes, .. } = roughness(&[levels(&kinds, &of_kinds, &chosen)])?;
            let of_supported =
                of_nodes.iter().zip(self.supported).filter(|(_, s)| **s).map(|(ratio, _)| *ratio);
            let usual = median(&mut of_supported.collect::<Vec<_>>());
            let rougher: Vec<f64> = of_nodes.iter().map(|ratio| (ratio / usual).sqrt()).collect();
            let uneven = columns(&[Process::Wall], BASE_DRAWS, base, Some(&rougher))?;
            let mut with_uneven = of_kinds.clone();
            with_uneven[base - 1].clone_from(&uneven[0]);
            let (_, uneven_misfit) = explain(&with_uneven, &chosen);
            if uneven_misfit < misfit {
                (of_kinds, misfit) = (with_uneven, uneven_misfit);
            }
        }
        if exceeds(misfit, POOR_FIT) {
            let mut others = self.other_kinds();
            others.extend(self.beats(residuals));
            of_kinds.extend(columns(&others, OTHER_DRAWS, base, None)?);
            kinds.extend(others);
            while exceeds(misfit, GOOD_FIT) {
                let with = |k: usize| {
                    let more: Vec<usize> = chosen.iter().copied().chain([k]).collect();
                    (explain(&of_kinds, &more).1, k)
                };
                let left = (0..kinds.len()).filter(|k| !chosen.contains(k));
                let Some((better, k)) = left.map(with).min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
                if better > (1.0 - MIN_GAIN_SHARE) * misfit - MIN_GAIN {
                    break;
                }
                (misfit, _) = (better, chosen.push(k));
            }
        }
        let mut alternatives = vec![chosen.clone()];
        for place in base..chosen.len() {
            for k in (base..kinds.len()).filter(|k| !chosen.contains(k)) {
                let mut other = chosen.clone();
                other[place] = k;
                if explain(&of_kinds, &other).1 <= (1.0 + SAME_SHARE) * misfit + SAME {
                    alternatives.push(other);
                }
            }
        }
        Ok(alternatives.iter().map(|chosen| levels(&kinds, &of_kinds, chosen)).collect())
    }

    /// Oscillations of the lumen's size and of the frames' places, as far as the residuals show any. One that is slower than a
    /// breath, or whose period is longer than a place of the wall was seen, is none: waves of the wall, which the catheter
    /// passes, look the same.
    fn beats(&self, residuals: Residuals) -> Vec<Process> {
        let Residuals { values_mm, is_on_wall, seen_for_s } = residuals;
        let least_hz = seen_for_s.recip().max(SLOWEST_BREATH_HZ);
        // Means over each frame of the residuals, times 1, cos θ and sin θ.
        let mut sums = vec![[0.0; 3]; self.times_s.len()];
        let mut counts = vec![0.0_f64; self.times_s.len()];
        for ((seen, residual), _) in self.seen.iter().zip(values_mm).zip(is_on_wall).filter(|(_, on)| **on) {
            let [cos, sin] = seen.direction.map(f64::from);
            let frame = seen.frame as usize;
            sums[frame].iter_mut().zip([1.0, cos, sin]).for_each(|(sum, part)| *sum += part * residual);
            counts[frame] += 1.0;
        }
        let means = |part: usize| -> Vec<f64> {
            sums.iter().zip(&counts).map(|(sums, count)| sums[part] / count.max(1.0)).collect()
        };
        let [size, x, y] = [0, 1, 2].map(means);
        let of_size = frequency_hz(&self.times_s, &[&size], least_hz)
            .map(|f| Process::Beat { order: 0, frequency_hz: f });
        let of_place = frequency_hz(&self.times_s, &[&x, &y], least_hz)
            .map(|f| Process::Beat { order: 1, frequency_hz: f });
        of_size.into_iter().chain(of_place).collect()
    }

    /// A draw of all errors but the wall's bends.
    fn drawn(&self, levels: &Levels, draw: usize) -> Vec<f64> {
        let mut errors_mm = vec![0.0; self.seen.len()];
        for (stream, (process, variance_mm2)) in levels.iter().enumerate() {
            let rng = &mut random(100 + draw, stream);
            self.add_draw(*process, variance_mm2.sqrt(), rng, &mut errors_mm);
        }
        errors_mm
    }

    /// What the shifts of single frames are estimated from, where they can be.
    fn told_shifts(&self, estimate: &Estimate, echoes: &[Echo], wall: &Wall) -> Option<Told> {
        // λ of the usual ring.
        let factor = median(&mut estimate.of_rings.iter().map(|ratio| ratio.recip()).collect::<Vec<_>>());
        let reach_mm = self.reach_mm(echoes, wall) * factor.powf(0.25);
        Told::of(&estimate.descriptions, self.interval_s(), reach_mm)
    }

    /// Standard errors of the nodes, from draws of the errors; `told` takes those shifts off them that it took off the echoes'.
    fn node_errors(
        &self,
        estimate: &Estimate,
        smoother: &Smoother,
        told: Option<&ShiftEstimator>,
        echoes: &[Echo],
        wall: &Wall,
    ) -> Result<NodeErrors> {
        let Estimate { descriptions, of_nodes, of_rings, of_sums } = estimate;
        let fields: Vec<[Vec<f64>; 2]> = (0..VARIANCE_DRAWS)
            .into_par_iter()
            .map(|draw| {
                let draw = ROUGHNESS_DRAWS + draw;
                let (of_errors, of_bends) = rayon::join(
                    || {
                        let errors_mm = self.drawn(&descriptions[draw % descriptions.len()], draw);
                        let wall_mm = smoother.wall(errors_mm.iter().copied())?;
                        match told {
                            Some(told) => smoother.wall(told.without_shifts(smoother, &errors_mm, &wall_mm)),
                            None => Ok(wall_mm),
                        }
                    },
                    || smoother.bends(draw, None),
                );
                Ok([of_errors?, of_bends?])
            })
            .collect::<Result<_>>()?;
        let reach_mm = VARIANCE_REACHES * self.reach_mm(echoes, wall);
        let [noise, bends] = [0, 1].map(|kind| mean_squares(fields.iter().map(|field| &field[kind])));
        let [noise, bends] = self.averaged([&noise, &bends], reach_mm);
        let WallGrid { nodes, rings, arc_mm, .. } = *self.grid;
        let roughness_of = |n: usize| of_nodes[n].max(MIN_NODE) / of_rings[n / nodes];
        let variance = |n: usize| noise[n] + bends[n] * roughness_of(n);
        // The variance of a ring's sum is that of its nodes, added up, times the number of nodes that err alike.
        let sums_of = |kind: usize| mean(fields.iter().map(|field| self.squared_sums(&field[kind])));
        let (noise_sums, bend_sums) = (sums_of(0), sums_of(1));
        let of_sum = |k: usize| noise_sums[k] + bend_sums[k] * of_sums[k] / of_rings[k];
        let of_each =
            |k: usize| (k * nodes..(k + 1) * nodes).filter(|&n| self.supported[n]).map(variance).sum::<f64>();
        let weights = gaussian(reach_mm / self.grid.step_mm, rings);
        let [of_sums, of_each] = [(0..rings).map(of_sum).collect(), (0..rings).map(of_each).collect()]
            .map(|rings: Vec<f64>| smoothed_along(&weights, &rings));
        let alike = |k: usize| {
            let count = of_sums[k] / of_each[k];
            if count.is_finite() { count.clamp(1.0, nodes as f64) } else { 1.0 }
        };
        Ok(NodeErrors {
            standard_error_mm: (0..noise.len()).map(|n| variance(n).sqrt()).collect(),
            reach_mm: (0..noise.len()).map(|n| arc_mm * alike(n / nodes)).collect(),
        })
    }

    /// The reach of an echo, mm: `(λ/ρ)^¼` for ρ echoes per area of supported wall.
    fn reach_mm(&self, echoes: &[Echo], wall: &Wall) -> f64 {
        let on_wall: f64 =
            echoes.iter().filter(|e| is_inlier(e, wall.noise_mm)).map(|e| f64::from(e.weight)).sum();
        let supported = self.supported.iter().filter(|s| **s).count().max(1);
        (wall.smoothness_mm2 * supported as f64 * self.grid.cell_mm2() / on_wall.max(1.0)).powf(0.25)
    }

    /// Means about every node, of supported nodes if it is one itself, with Gaussian weights of a standard deviation.
    fn averaged<const N: usize>(&self, fields: [&[f64]; N], sd_mm: f64) -> [Vec<f64>; N] {
        let weights: Vec<f64> = self.supported.iter().map(|&s| f64::from(u8::from(s))).collect();
        let smooth = |values: &[f64]| self.smoothed(values, sd_mm);
        let shares = smooth(&weights);
        fields.map(|values| {
            let of_supported: Vec<f64> = values.iter().zip(&weights).map(|(v, w)| v * w).collect();
            let (mut means, of_supported) = rayon::join(|| smooth(values), || smooth(&of_supported));
            for node in (0..means.len()).filter(|&n| self.supported[n]) {
                means[node] = of_supported[node] / shares[node];
            }
            means
        })
    }

    /// Sums with Gaussian weights of a standard deviation, which add up to 1 where rings do not end.
    fn smoothed(&self, values: &[f64], sd_mm: f64) -> Vec<f64> {
        let WallGrid { rings, nodes, step_mm, arc_mm } = *self.grid;
        let (along, around) = (gaussian(sd_mm / step_mm, rings), gaussian(sd_mm / arc_mm, nodes / 2));
        let mut columns = vec![0.0; values.len()];
        columns.par_chunks_exact_mut(nodes).enumerate().for_each(|(k, out)| {
            for (offset, weight) in along.iter().enumerate() {
                for other in both_sides(k, offset, rings) {
                    let ring = &values[other * nodes..(other + 1) * nodes];
                    out.iter_mut().zip(ring).for_each(|(out, value)| *out += weight * value);
                }
            }
        });
        let mut smoothed = vec![0.0; values.len()];
        // The weights of fewer nodes than half a ring's.
        let reach = around.len() - 1;
        let tasks = smoothed.par_chunks_exact_mut(nodes).zip(columns.par_chunks_exact(nodes));
        tasks.for_each_init(Vec::new, |round: &mut Vec<f64>, (out, ring)| {
            round.clear();
            round.extend(ring[nodes - reach..].iter().chain(ring).chain(&ring[..reach]));
            for (offset, weight) in around.iter().enumerate() {
                let (after, before) = (&round[reach + offset..], &round[reach - offset..]);
                for ((out, after), before) in out.iter_mut().zip(after).zip(before) {
                    *out += weight * if offset == 0 { *after } else { after + before };
                }
            }
        });
        smoothed
    }

    /// Means over the supported nodes of the rings about each one.
    fn averaged_rings(&self, values: &[f64], sd_mm: f64) -> Vec<f64> {
        let WallGrid { rings, nodes, step_mm, .. } = *self.grid;
        let sums: Vec<[f64; 2]> = (0..rings)
            .map(|k| {
                let nodes = (k * nodes..(k + 1) * nodes).filter(|&n| self.supported[n]);
                nodes.fold([0.0; 2], |[sum, count], n| [sum + values[n], count + 1.0])
            })
            .collect();
        let weights = gaussian(sd_mm / step_mm, rings);
        (0..rings)
            .map(|k| {
                let mut about = [0.0; 2];
                for (offset, weight) in weights.iter().enumerate() {
                    for other in both_sides(k, offset, rings) {
                        about.iter_mut().zip(sums[other]).for_each(|(a, b)| *a += weight * b);
                    }
                }
                about[0] / about[1]
            })
            .collect()
    }
}

/// Residuals of the echoes, of which those beyond [`MAX_SDS`] count as that many, mm.
fn clamped_residuals_mm(echoes: &[Echo], wall: &Wall) -> Vec<f64> {
    let most_mm = MAX_SDS * wall.noise_mm;
    echoes.iter().map(|echo| echo.residual_mm.clamp(-most_mm, most_mm)).collect()
}

/// The places at a distance from `k` on either side, of so many.
fn both_sides(k: usize, offset: usize, count: usize) -> impl Iterator<Item = usize> {
    let before = if offset > 0 { k.checked_sub(offset) } else { None };
    let after = Some(k + offset).filter(|&other| other < count);
    before.into_iter().chain(after)
}

/// Weighted sums about each value.
fn smoothed_along(weights: &[f64], values: &[f64]) -> Vec<f64> {
    let about = |k: usize| {
        let of = |(offset, weight): (usize, &f64)| {
            both_sides(k, offset, values.len()).map(|other| weight * values[other]).sum::<f64>()
        };
        weights.iter().enumerate().map(of).sum()
    };
    (0..values.len()).map(about).collect()
}

/// Weights of a Gaussian at 0, 1, … steps, up to three standard deviations or `most` steps; those of both sides add up to 1.
fn gaussian(sd: f64, most: usize) -> Vec<f64> {
    let reach = ((3.0 * sd).ceil() as usize).min(most.saturating_sub(1));
    let weight = |k: usize| (-0.5 * (k as f64 / sd).powi(2)).exp();
    let total: f64 = (0..=reach).map(|k| if k == 0 { 1.0 } else { 2.0 * weight(k) }).sum();
    (0..=reach).map(|k| if k == 0 { 1.0 / total } else { weight(k) / total }).collect()
}

/// Mean squares of fields, node by node.
fn mean_squares<'a>(fields: impl Iterator<Item = &'a Vec<f64>>) -> Vec<f64> {
    mean(fields.map(|field| field.iter().map(|x| x * x).collect()))
}

/// Means of lists, place by place.
fn mean(lists: impl Iterator<Item = Vec<f64>>) -> Vec<f64> {
    let (mut sums, mut count) = (Vec::new(), 0.0);
    for list in lists {
        sums.resize(list.len(), 0.0);
        sums.iter_mut().zip(list).for_each(|(sum, x): (&mut f64, f64)| *sum += x);
        count += 1.0;
    }
    sums.iter_mut().for_each(|sum| *sum /= count);
    sums
}

impl RecordingErrors {
    /// Standard deviation of the shifts of frames along each axis, all kinds together and without what was corrected, mm.
    pub(super) fn shift_mm(&self) -> f64 {
        let variance_mm2 = self.shifts.iter().map(|shift| shift.sd_mm * shift.sd_mm).sum::<f64>();
        let corrected_mm = self.corrected.map_or(0.0, |corrected| corrected.rms_mm);
        (variance_mm2 - corrected_mm * corrected_mm).max(0.0).sqrt()
    }

    /// How far the vessel lies beside the reconstructed wall, which is that of its mean place, at the ends of the way that a
    /// beat carries it, mm along each axis; `None` where no beat shows. A vessel that breath or heart moves rests at one of
    /// them.
    pub fn rest_mm(&self) -> Option<f64> {
        let squares =
            self.beats.iter().filter(|beat| beat.is_shift).map(|beat| 2.0 * beat.sd_mm * beat.sd_mm);
        let square: f64 = squares.sum();
        (square > 0.0).then(|| square.sqrt())
    }

    fn of(descriptions: &[Levels], roughness: f64) -> Self {
        let mut errors = Self { roughness, descriptions: descriptions.len(), ..Self::default() };
        for (process, variance_mm2) in descriptions.first().into_iter().flatten() {
            let sd_mm = variance_mm2.sqrt();
            match *process {
                Process::Ray => errors.rays_mm = sd_mm,
                Process::Shift { correlation_s } => {
                    errors.shifts.push(AlikeErrors { sd_mm, width_deg: None, correlation_s });
                }
                Process::Contour { width_rad, correlation_s } => {
                    let width_deg = Some(width_rad.to_degrees());
                    errors.contours.push(AlikeErrors { sd_mm, width_deg, correlation_s });
                }
                Process::Beat { order, frequency_hz } => {
                    errors.beats.push(Beat { sd_mm, frequency_hz, is_shift: order > 0 });
                }
                Process::Wall => (),
            }
        }
        errors
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn errors_that_smoothing_does_not_take_away_call_for_no_more_of_it() {
        // 200 frames of 48 rays, a quarter of a millimetre apart, along a tube of 8 mm radius.
        let axis = Axis::along(&[DVec3::ZERO, DVec3::Z * 25.0, DVec3::Z * 50.0], 1.0, 5.0);
        let (rings, nodes) = (axis.rings(), 48);
        let grid = WallGrid { rings, nodes, step_mm: axis.step_mm, arc_mm: TAU * 8.0 / nodes as f64 };
        let echo = |i: u32| {
            let (sin, cos) = (TAU * f64::from(i % 48) / 48.0).sin_cos();
            let point_mm = DVec3::new(8.0 * cos, 8.0 * sin, 0.25 * f64::from(i / 48));
            Echo::new(&axis.place(point_mm, 0).unwrap(), DVec3::Z, i / 48, nodes)
        };
        let echoes: Vec<Echo> = (0..9600).map(echo).collect();
        let wall = Wall { noise_mm: 1.0, smoothness_mm2: 64.0, ..Wall::tube(&grid, 8.0) };
        let linear = linearised(&grid, &echoes, &wall);
        let smoother = Smoother::of(&grid, &linear, wall.smoothness_mm2, 0.125).unwrap();
        let supported: Vec<bool> = (0..grid.node_count()).map(|n| (5..55).contains(&(n / nodes))).collect();
        let times_s: Vec<Option<f64>> = (0..200).map(|k| Some(0.1 * f64::from(k))).collect();
        let recording = Recorded::of(&grid, &times_s, &echoes, &supported);
        let reach_mm = recording.reach_mm(&echoes, &wall);
        let bends = Bends::drawn(&smoother, 1).unwrap();
        let found_mm = vec![0.0; grid.node_count()];
        let design_effect = |levels: Levels| {
            let roughness = recording.roughness(&smoother, &found_mm, &bends, reach_mm, &[levels]).unwrap();
            recording.design_effect(&roughness.smoothable, reach_mm, &wall)
        };
        let (ray, shift) = ((Process::Ray, 1.0), |correlation_s| (Process::Shift { correlation_s }, 1.0));
        let of_rays = design_effect(vec![ray]);
        assert!((of_rays - 1.0).abs() < 0.2, "{of_rays}");
        // 24 echoes err alike along an axis, but for the two directions that a shift may have.
        let of_frames = design_effect(vec![ray, shift(0.0)]);
        assert!(of_frames > 3.0, "{of_frames}");
        // Every ring is too wide or too narrow by as much.
        let lasting = design_effect(vec![ray, (Process::Beat { order: 0, frequency_hz: 1e-9 }, 1.0)]);
        assert!((lasting - of_rays).abs() < 0.3, "{lasting} {of_rays}");
    }

    #[test]
    fn an_echo_that_stands_for_several_has_their_mean_error() {
        let grid = WallGrid { rings: 4, nodes: 16, step_mm: 1.0, arc_mm: 1.0 };
        let recording = Recorded {
            grid: &grid,
            frames: vec![0],
            times_s: vec![0.0],
            seen: vec![Seen::new(1.0, 0); 2],
            own_errors: vec![1.0, 0.5],
            supported: &[],
        };
        let drawn = |process| {
            let mut errors_mm = [1.0; 2];
            recording.add_draw(process, 2.0, &mut random(0, 0), &mut errors_mm);
            errors_mm.map(|error| error - 1.0)
        };
        assert_eq!(drawn(Process::Ray).map(f64::abs), [2.0, 1.0]);
        for (correlation_s, share) in [(0.0, 0.5), (3.0, 1.0)] {
            for process in
                [Process::Shift { correlation_s }, Process::Contour { width_rad: 0.5, correlation_s }]
            {
                let [single, mean] = drawn(process);
                assert!(single != 0.0 && (mean - share * single).abs() < 1e-12, "{process:?}");
            }
        }
    }

    #[test]
    fn shifts_lie_in_all_directions_and_other_errors_in_the_image_plane() {
        let (ray, shift) = ((Process::Ray, 1.0), (Process::Shift { correlation_s: 0.0 }, 0.25));
        let contour = (Process::Contour { width_rad: 0.5, correlation_s: 0.0 }, 3.0);
        let beats = [0, 1].map(|order| (Process::Beat { order, frequency_hz: 1.0 }, 0.25));
        let share = |levels: &[(Process, f64)]| out_of_plane(&[levels.to_vec()]);
        assert_eq!(share(&[ray, shift]), 0.2);
        assert_eq!(share(&[ray, shift, contour, (Process::Wall, 9.0)]), 0.25 / 4.25);
        assert_eq!([share(&[ray, beats[0]]), share(&[ray, beats[1]])], [CONTOUR_OUT_OF_PLANE, 0.2]);
        assert_eq!(
            [share(&[ray]), share(&[shift]), share(&[])],
            [CONTOUR_OUT_OF_PLANE, MAX_OUT_OF_PLANE, OUT_OF_PLANE]
        );
        // All descriptions count.
        assert_eq!(out_of_plane(&[vec![ray, shift], vec![ray, shift, shift, shift]]), 1.0 / 3.0);
    }
}
