//! Vessels that breathe and beat: periodic motions of the whole vessel, which carry the catheter along, and of its size.
//!
//! Frequencies stand out in the spectrum of what a wall leaves unexplained ([`candidate_hz`]). A [cycle](cycle) is a Fourier
//! series of place and size, and is fitted together with the wall ([`equations`]). The result is a recording of the vessel in
//! one state, which is then reconstructed like any other; or of the frames alone that were taken about one phase.

mod cycle;
mod equations;

pub use cycle::Cycle;

use super::errors::{self, process::SLOWEST_BREATH_HZ, process::Spectrum};
use super::prepare::Prepared;
use super::prepare::contour::Outlines;
use super::prepare::echo::{Echo, times_s};
use super::support::Support;
use super::wall::engine::{WallDevice, fit, refit};
use super::wall::fit::{Aim, Checkpoint, Wall};
use crate::numerics::cholesky::{Matrix, cholesky, forward};
use crate::numerics::robust::median;
use crate::recording::{Frame, Recording};
use crate::settings::{Backend, MotionState, Settings};
use crate::{Error, Result};
use cycle::{Clock, HARMONICS, PARTS, Rhythm, State, WAVES, place_mm, waves_at};
use equations::{
    CYCLES, Covariance, Effect, Fitted, PARAMETERS, Parameters, parameters, place_of, place_of_frequency,
};
use glam::{DMat3, DVec3};
use serde::Serialize;

/// The periodic motion of a vessel, as far as its recording shows it.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct Motion {
    /// The cycles that are significant, in ascending order of their frequencies; at most two.
    pub cycles: Vec<Cycle>,
    /// The state that is shown; `None` where frames of a window of phases were kept instead.
    pub shown: Option<MotionState>,
    /// Standard error of the vessel's place in that state, mm along x, y and z of the world. It is part of the nodes' own.
    pub place_standard_error_mm: [f64; 3],
    /// Standard error of the radii in that state, as a share of them. It is part of the nodes' own.
    pub size_standard_error: f64,
    /// Standard deviation of an echo about the wall of the recorded vessel, mm.
    pub noise_before_mm: f64,
    /// The same without the motion, mm.
    pub noise_mm: f64,
    /// Frames that were kept: all, or those of the window.
    pub frames: usize,
}

/// A recording of a vessel that stays as it is.
pub(crate) struct AtRest {
    /// `None` where nothing was to be changed.
    pub recording: Option<Recording>,
    pub motion: Motion,
    pub error: StateError,
}

/// The error of the state that is shown, as variances.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StateError {
    /// Of the place, mm².
    pub place_mm2: DMat3,
    /// Of the size, as a share of the radius, squared.
    pub size: f64,
}

impl StateError {
    /// Of a state that is known.
    const NONE: Self = Self { place_mm2: DMat3::ZERO, size: 0.0 };

    /// The variance of a node's place along the wall's unit normal, mm².
    pub(crate) fn variance_mm2(&self, normal: DVec3, radius_mm: f64) -> f64 {
        normal.dot(self.place_mm2 * normal) + self.size * radius_mm * radius_mm
    }
}

/// Fewest frames of a recording in which motion is looked for.
const MIN_FRAMES: usize = 48;
/// A frequency stands out where noise, whose powers have the median of so many to either side, exceeds its power with less than
/// this probability, as a logarithm: there are some thousand frequencies.
const ABOUT: usize = 24;
const MAX_LOG_PROBABILITY: f64 = -12.0;
/// Other cycles have frequencies that differ by this many cycles over the recording, also from the harmonics.
const APART: f64 = 1.5;
/// A motion is significant where `xᵀC⁻¹x` of its parameters exceeds what noise makes of it by this many standard deviations.
const SIGNIFICANT_SDS: f64 = 8.0;
/// Least [confirmation](equations::Step::confirmation) of a motion by parts of the recording that had no part in its estimate: of
/// 24 parts that gain alike it is 4.9, of one alone 1.
const MIN_CONFIRMATION: f64 = 2.5;
/// Larger motions than this share of the radius, or changes of it, are none of a vessel that is one: the estimate has run away.
const MAX_SHARE: f64 = 1.0;
/// Rounds of linearisation; they go on until a step is below this share of its standard error.
const MAX_ROUNDS: usize = 12;
const ENOUGH_ERRORS: f64 = 0.2;
/// Residuals beyond this many standard deviations of the noise count as that many.
const MAX_SDS: f64 = 3.0;
/// What is added to the information about a shift, as a share of its trace: along a straight vessel there is none.
const MIN_INFORMATION: f64 = 1e-3;

/// Estimates the motion of a recording's vessel and brings the vessel into one state, or keeps the frames of a window of phases.
/// `recording` passes [`Recording::check`]. Where some of its frames have phases, the others are left out.
///
/// # Errors
/// Where the contours cover no length of a vessel, the equations of the wall cannot be solved, a window of phases has no
/// frames, or it is none since no motion was found. Frames are named by their numbers.
pub(crate) fn at_rest(recording: &Recording, settings: &Settings, checkpoint: &Checkpoint) -> Result<AtRest> {
    let all_frames = recording.frames.len();
    let has_phases = recording.frames.iter().any(|frame| frame.phase.is_some());
    let numbered = |k: usize| recording.frames[k].clone().with_number(Some(recording.number(k)));
    let frames: Vec<Frame> = (0..recording.frames.len())
        .filter(|&k| !has_phases || recording.frames[k].phase.is_some())
        .map(numbered)
        .collect();
    let mut times_s = times_s(&frames);
    let middle_s = 0.5 * (times_s.first().unwrap_or(&0.0) + times_s.last().unwrap_or(&0.0));
    times_s.iter_mut().for_each(|time_s| *time_s -= middle_s);
    let phases = has_phases.then(|| frames.iter().filter_map(|frame| frame.phase).collect());
    let estimator = Estimator {
        frames: &frames,
        clock: Clock { times_s, phases },
        // The same frames have the same motion, whatever fits the vessel afterwards.
        settings: Settings { backend: Backend::Cpu, ..settings.clone() },
        checkpoint,
    };
    let estimate =
        || estimator.estimate().map_err(|error| error.with_number(|k| frames[k].number.unwrap_or(k)));
    match (settings.motion.shown, settings.motion.window) {
        (Some(shown), _) => {
            let found = estimate()?;
            let (state, error) = found.shown(shown, &estimator.clock);
            let moves = !found.rhythms.is_empty();
            let recording = moves.then(|| Recording { frames: estimator.moved(&found.rhythms, &state) });
            let motion = Motion {
                place_standard_error_mm: [0, 1, 2].map(|i| error.place_mm2.col(i)[i].sqrt()),
                size_standard_error: error.size.sqrt(),
                frames: if moves { frames.len() } else { all_frames },
                ..found.motion(Some(shown), &estimator.clock)
            };
            Ok(AtRest { recording, motion, error })
        }
        (None, Some(window)) => {
            // Phases of the recording need no estimate.
            let found = if has_phases { Found::nothing() } else { estimate()? };
            let Some(main) = estimator.clock.given().or_else(|| found.main()) else {
                return Err(Error::Recording {
                    field: "motion",
                    found: "no motion that is significant, and no phases".into(),
                    expected: "phases, or a vessel that moves with a period, for a window of phases".into(),
                });
            };
            let frames = estimator.within(&main, window);
            if frames.is_empty() {
                return Err(Error::Recording {
                    field: "phase",
                    found: format!("no frame from {} to {}", window[0], window[1]),
                    expected: "frames within motion.window".into(),
                });
            }
            let motion = Motion { frames: frames.len(), ..found.motion(None, &estimator.clock) };
            Ok(AtRest { recording: Some(Recording { frames }), motion, error: StateError::NONE })
        }
        (None, None) => Ok(AtRest { recording: None, motion: Motion::default(), error: StateError::NONE }),
    }
}

/// Estimates the motion of a vessel.
struct Estimator<'a> {
    frames: &'a [Frame],
    clock: Clock,
    settings: Settings,
    checkpoint: &'a Checkpoint<'a>,
}

/// The cycles that were found, and the covariance of their parameters.
struct Found {
    rhythms: Vec<Rhythm>,
    covariance: Option<Covariance>,
    noise_before_mm: f64,
    noise_mm: f64,
}

impl Estimator<'_> {
    /// The frames of a window of a cycle's phases.
    fn within(&self, rhythm: &Rhythm, [from, to]: [f64; 2]) -> Vec<Frame> {
        let [start, _] = self.clock.start(rhythm);
        let width = (to - from).rem_euclid(1.0);
        let is_within = |k: &usize| {
            let [phase, _] = self.clock.phase(rhythm, *k);
            (phase - start - from).rem_euclid(1.0) <= width
        };
        (0..self.frames.len()).filter(is_within).map(|k| self.frames[k].clone()).collect()
    }

    /// The frames with the vessel in one state throughout.
    fn moved(&self, rhythms: &[Rhythm], shown: &State) -> Vec<Frame> {
        let moved = |(k, frame): (usize, &Frame)| {
            let state = sum(rhythms.iter().map(|rhythm| rhythm.at(self.clock.phase(rhythm, k)[0])[0]));
            let mut frame = frame.clone();
            frame.world_from_sensor.translation_mm -= place_mm(&state) - place_mm(shown);
            let scale = (1.0 + shown[3]) / (1.0 + state[3]);
            if scale != 1.0
                && let Some(middle) = frame.centroid_mm()
            {
                frame.contour_mm.iter_mut().for_each(|p| *p = middle + (*p - middle) * scale);
            }
            frame
        };
        self.frames.iter().enumerate().map(moved).collect()
    }

    fn estimate(&self) -> Result<Found> {
        let mut found = Found::nothing();
        if self.frames.len() < MIN_FRAMES {
            return Ok(found);
        }
        let mut given = self.clock.given();
        // The axis follows the vessel without the cycles that were found before.
        for number in 0.. {
            let recording = Recording { frames: self.moved(&found.rhythms, &[0.0; PARTS]) };
            let prepared = Prepared::of(&recording, Outlines::of(&recording.frames), &self.settings)?;
            let mut echoes = prepared.echoes(&prepared.sensors());
            let (aim, device) = (Aim::alone(self.settings.sweep.roughness), WallDevice::default());
            let (mut wall, _) =
                fit(&prepared.grid, &mut echoes, &self.settings, aim, &device, self.checkpoint)?;
            // Where a wall is rougher than expected, its bends would be taken for motion.
            let support = Support::of(&prepared.grid, &echoes, &wall);
            errors::estimate(
                &prepared.grid,
                errors::Frames {
                    times_s: &self.clock.times_s.iter().copied().map(Some).collect::<Vec<_>>(),
                    movable: None,
                    keeps_out_of_plane: true,
                },
                &self.settings.sweep,
                &mut echoes,
                &mut wall,
                &support,
                self.checkpoint,
            )?;
            if number == 0 {
                (found.noise_before_mm, found.noise_mm) = (wall.noise_mm, wall.noise_mm);
            }
            let next = match (given.take(), found.rhythms.len() < CYCLES) {
                (Some(given), _) => Some(given),
                (None, true) => self
                    .fitted(&prepared, &echoes, &wall)
                    .candidate_hz(&found.rhythms)
                    .map(|frequency_hz| Rhythm::new(frequency_hz, false)),
                (None, false) => None,
            };
            let rhythms: Vec<Rhythm> = found.rhythms.iter().copied().chain(next).collect();
            if rhythms.is_empty() {
                break;
            }
            let before = found.rhythms.len();
            let (rhythms, covariance, noise_mm) = self.converge(&prepared, rhythms, wall)?;
            if !rhythms.is_empty() {
                found.noise_mm = noise_mm;
            }
            found.covariance = (!rhythms.is_empty()).then_some(covariance);
            found.rhythms = rhythms;
            // A candidate that is not significant ends the search.
            if next.is_none_or(|next| !next.is_given && found.rhythms.len() <= before) {
                break;
            }
        }
        Ok(found)
    }

    fn fitted<'b>(&'b self, prepared: &'b Prepared, echoes: &'b [Echo], wall: &'b Wall) -> Fitted<'b> {
        Fitted {
            grid: &prepared.grid,
            axis: &prepared.axis,
            echoes,
            wall,
            roughness: self.settings.sweep.roughness,
            clock: &self.clock,
            radius_mm: prepared.contour_radius_mm,
        }
    }

    /// The likeliest cycles and the covariance of their parameters, of those whose motion is significant; and the noise of the
    /// echoes without them.
    fn converge(
        &self,
        prepared: &Prepared,
        mut rhythms: Vec<Rhythm>,
        mut wall: Wall,
    ) -> Result<(Vec<Rhythm>, Covariance, f64)> {
        let span_s = self.clock.span_s();
        let newest = rhythms.len();
        loop {
            let mut round = 0;
            let (step, has_settled) = loop {
                let frames = self.moved(&rhythms, &[0.0; PARTS]);
                let moved = prepared.with_contours(&frames);
                let mut echoes = moved.echoes(&moved.sensors());
                wall.residual_model(&prepared.grid).project_all(&mut echoes);
                wall =
                    refit(&prepared.grid, &mut echoes, self.settings.sweep.roughness, wall, self.checkpoint)?;
                let step = self.fitted(prepared, &echoes, &wall).step(&rhythms)?;
                for (cycle, rhythm) in rhythms.iter_mut().enumerate() {
                    for (wave, state) in rhythm.waves.iter_mut().enumerate() {
                        state.iter_mut().enumerate().for_each(|(part, x)| {
                            *x += step.change[place_of(cycle, wave, part)];
                        });
                    }
                    rhythm.frequency_hz += step.change[place_of_frequency(cycle)] / span_s;
                }
                round += 1;
                let is_small = |i: usize| {
                    let mut factors = [0.0; PARAMETERS];
                    factors[i] = 1.0;
                    step.change[i].abs() <= ENOUGH_ERRORS * step.covariance.variance(&factors).sqrt()
                };
                let has_settled = (0..PARAMETERS).all(is_small);
                if round >= MAX_ROUNDS || (round > 1 && has_settled) {
                    break (step, has_settled);
                }
            };
            let values = parameters(&rhythms);
            let count = rhythms.len();
            let before: Vec<[bool; 2]> = rhythms.iter().map(|r| [r.moves, r.beats]).collect();
            for (cycle, rhythm) in rhythms.iter_mut().enumerate() {
                let of = |parts: std::ops::Range<usize>| -> Vec<usize> {
                    (0..WAVES)
                        .flat_map(|wave| parts.clone().map(move |part| place_of(cycle, wave, part)))
                        .collect()
                };
                let is_significant = |chosen: &[usize]| {
                    let freedom = chosen.len() as f64;
                    let excess = step.covariance.chi_squared(&values, chosen) - freedom;
                    excess > SIGNIFICANT_SDS * (2.0 * freedom).sqrt()
                        && step.confirmation(chosen) > MIN_CONFIRMATION
                };
                rhythm.moves &= is_significant(&of(0..3));
                rhythm.beats &= is_significant(&of(3..4));
                // The newest cycle is none if it does not settle: frequencies wander where there is nothing to be found.
                if !has_settled && count == newest && cycle + 1 == newest {
                    (rhythm.moves, rhythm.beats) = (false, false);
                }
                let [way_mm, change] = rhythm.ways();
                rhythm.moves &= way_mm <= MAX_SHARE * 2.0 * prepared.contour_radius_mm;
                rhythm.beats &= change <= MAX_SHARE;
                for state in &mut rhythm.waves {
                    if !rhythm.moves {
                        state[..3].fill(0.0);
                    }
                    if !rhythm.beats {
                        state[3] = 0.0;
                    }
                }
            }
            let after: Vec<[bool; 2]> = rhythms.iter().map(|r| [r.moves, r.beats]).collect();
            rhythms.retain(|rhythm| rhythm.moves || rhythm.beats);
            if before == after || rhythms.is_empty() {
                return Ok((rhythms, step.covariance, wall.noise_mm));
            }
        }
    }
}

impl Fitted<'_> {
    /// The frequency that stands out most in what the wall leaves unexplained, Hz, beside those of some cycles.
    fn candidate_hz(&self, known: &[Rhythm]) -> Option<f64> {
        let most_mm = MAX_SDS * self.wall.noise_mm;
        let effects: Vec<Effect> = self.effects();
        let mut scores = vec![[0.0; PARTS]; self.clock.times_s.len()];
        let mut information: Matrix<3> = Matrix::default();
        for (effect, echo) in effects.iter().zip(self.echoes) {
            let residual = echo.residual_mm.clamp(-most_mm, most_mm);
            let score = &mut scores[echo.frame as usize];
            score.iter_mut().zip(effect).for_each(|(sum, effect)| *sum += effect * residual);
            for (line, a) in information.iter_mut().zip(effect) {
                line.iter_mut().zip(effect).for_each(|(sum, b)| *sum += a * b);
            }
        }
        let least = MIN_INFORMATION * (0..3).map(|i| information[i][i]).sum::<f64>();
        (0..3).for_each(|i| information[i][i] += least);
        // Shifts that noise makes are equally large along all axes of this factor's inverse.
        let factor = cholesky(&information)?;
        let shifts: Vec<[f64; 3]> =
            scores.iter().map(|[x, y, z, _]| forward(&factor, [*x, *y, *z])).collect();
        let series = |of: &dyn Fn(usize) -> f64| (0..scores.len()).map(of).collect::<Vec<f64>>();
        let [x, y, z] = [0, 1, 2].map(|i| series(&|k| shifts[k][i]));
        let size = series(&|k| scores[k][3]);
        let place = self.standing_out(&[&x, &y, &z], known);
        let size = self.standing_out(&[&size], known);
        let least = place.into_iter().chain(size).min_by(|a, b| a[0].total_cmp(&b[0]));
        least.map(|[_, frequency_hz]| frequency_hz)
    }

    /// The logarithm of the probability of the power that stands out most, and its frequency, Hz.
    fn standing_out(&self, series: &[&[f64]], known: &[Rhythm]) -> Option<[f64; 2]> {
        let Spectrum { first, step_hz, powers } = Spectrum::of(&self.clock.times_s, series)?;
        let apart_hz = APART / self.clock.span_s();
        let is_known = |frequency_hz: f64| {
            known.iter().any(|rhythm| {
                (1..=HARMONICS).any(|h| (frequency_hz - h as f64 * rhythm.frequency_hz).abs() < apart_hz)
            })
        };
        let excess = |k: usize| {
            let frequency_hz = (first + k) as f64 * step_hz;
            if frequency_hz < SLOWEST_BREATH_HZ || is_known(frequency_hz) {
                return None;
            }
            let about = k.saturating_sub(ABOUT)..(k + ABOUT + 1).min(powers.len());
            let usual = median(&mut powers[about].to_vec());
            Some([log_probability(powers[k] / usual, series.len()), frequency_hz])
        };
        let least = (0..powers.len()).filter_map(excess).min_by(|a, b| a[0].total_cmp(&b[0]))?;
        (least[0] < MAX_LOG_PROBABILITY).then_some(least)
    }
}

impl Found {
    /// The cycle with the longest way; of sizes alone, that with the largest change.
    fn main(&self) -> Option<Rhythm> {
        self.rhythms.iter().copied().max_by(|a, b| {
            let ([a_mm, a], [b_mm, b]) = (a.ways(), b.ways());
            a_mm.total_cmp(&b_mm).then(a.total_cmp(&b))
        })
    }

    /// Nothing, of a vessel that does not move.
    fn nothing() -> Self {
        Self { rhythms: Vec::new(), covariance: None, noise_before_mm: 0.0, noise_mm: 0.0 }
    }

    /// The phase of each cycle in a state, and what a cycle more over the recording adds to it; none in the mean of the cycle.
    /// Where the recording has phases, the other cycles are shown in their mean.
    fn phases(&self, shown: Option<MotionState>, clock: &Clock) -> Vec<Option<[f64; 2]>> {
        let has_given = self.rhythms.iter().any(|rhythm| rhythm.is_given);
        let of = |rhythm: &Rhythm| match shown {
            Some(MotionState::Phase(phase)) if rhythm.is_given || !has_given => {
                let [start, by_frequency] = clock.start(rhythm);
                Some([start + phase, by_frequency])
            }
            _ => None,
        };
        self.rhythms.iter().map(of).collect()
    }

    /// The state that is shown, and its error.
    fn shown(&self, shown: MotionState, clock: &Clock) -> (State, StateError) {
        let phases = self.phases(Some(shown), clock);
        let state = sum(self.rhythms.iter().zip(&phases).filter_map(|(rhythm, phase)| {
            let [phase, _] = (*phase)?;
            Some(rhythm.at(phase)[0])
        }));
        let Some(covariance) = &self.covariance else { return (state, StateError::NONE) };
        let mut error = StateError::NONE;
        let mut add = |phases: &[Option<[f64; 2]>], share: f64| {
            let factors = self.factors(phases);
            let of = |a: usize, b: usize| share * covariance.of(&factors[a], &factors[b]);
            let of_column = |b: usize| DVec3::new(of(0, b), of(1, b), of(2, b));
            error.place_mm2 += DMat3::from_cols(of_column(0), of_column(1), of_column(2));
            error.size += of(3, 3);
        };
        add(&phases, 1.0);
        // A place of the wall was seen at some phases, from which it is brought into the state.
        let frames = clock.times_s.len();
        for k in 0..frames {
            let phases: Vec<_> = self.rhythms.iter().map(|rhythm| Some(clock.phase(rhythm, k))).collect();
            add(&phases, 1.0 / frames as f64);
        }
        (state, error)
    }

    /// The factors of the parameters in each part of a state at these phases.
    fn factors(&self, phases: &[Option<[f64; 2]>]) -> [Parameters; PARTS] {
        let mut factors = [[0.0; PARAMETERS]; PARTS];
        for (cycle, (rhythm, phase)) in self.rhythms.iter().zip(phases).enumerate() {
            let Some([phase, by_frequency]) = *phase else { continue };
            let [_, by_phase] = rhythm.at(phase);
            for (part, factors) in factors.iter_mut().enumerate().filter(|(part, _)| rhythm.is_free(*part)) {
                for (wave, [value, _]) in waves_at(phase).into_iter().enumerate() {
                    factors[place_of(cycle, wave, part)] = value;
                }
                factors[place_of_frequency(cycle)] = by_phase[part] * by_frequency;
            }
        }
        factors
    }

    /// What is reported of the cycles.
    fn motion(&self, shown: Option<MotionState>, clock: &Clock) -> Motion {
        let phases = self.phases(shown, clock);
        let mut cycles: Vec<Cycle> = Vec::new();
        for (cycle, (rhythm, phase)) in self.rhythms.iter().zip(phases).enumerate() {
            let [start, _] = clock.start(rhythm);
            let from = phase.map_or([0.0; PARTS], |[phase, _]| rhythm.at(phase)[0]);
            let [farthest_mm, largest_difference] = rhythm.farthest(&from);
            let [way_mm, size_change] = rhythm.ways();
            let standard_error = |fill: &dyn Fn(&mut Parameters)| {
                let mut factors = [0.0; PARAMETERS];
                fill(&mut factors);
                self.covariance.as_ref().map_or(0.0, |covariance| covariance.variance(&factors).sqrt())
            };
            let apart = |[a, b]: [f64; 2], direction: State| {
                let (a, b) = (waves_at(a), waves_at(b));
                standard_error(&|factors: &mut Parameters| {
                    for wave in 0..WAVES {
                        for (part, along) in
                            direction.iter().enumerate().filter(|(part, _)| rhythm.is_free(*part))
                        {
                            factors[place_of(cycle, wave, part)] = (a[wave][0] - b[wave][0]) * along;
                        }
                    }
                })
            };
            let [of_place, of_size] = rhythm.extremes();
            let [a, b] = of_place.map(|phase| place_mm(&rhythm.at(phase)[0]));
            let DVec3 { x, y, z } = (a - b).normalize_or_zero();
            let of_frequency = standard_error(&|factors| factors[place_of_frequency(cycle)] = 1.0);
            cycles.push(Cycle {
                has_phases: rhythm.is_given,
                frequency_hz: rhythm.frequency_hz,
                frequency_standard_error_hz: if rhythm.is_given {
                    0.0
                } else {
                    of_frequency / clock.span_s()
                },
                way_mm,
                way_standard_error_mm: apart(of_place, [x, y, z, 0.0]),
                size_change,
                size_change_standard_error: apart(of_size, [0.0, 0.0, 0.0, 1.0]),
                farthest_mm,
                largest_difference,
                rest_phase: rhythm.rest_phase(start),
                harmonics: rhythm.harmonics_from(start),
            });
        }
        cycles.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
        let Self { noise_before_mm, noise_mm, .. } = *self;
        Motion { cycles, shown, noise_before_mm, noise_mm, ..Motion::default() }
    }
}

/// The logarithm of the probability with which a sum of so many powers of noise exceeds its median by a factor.
fn log_probability(factor: f64, powers: usize) -> f64 {
    // Half of χ² of two degrees of freedom a power, with its median.
    let half = factor * (powers as f64 - 1.0 / 3.0 + 0.02 / powers as f64);
    let terms = (1..powers).scan(1.0, |term, j| {
        *term *= half / j as f64;
        Some(*term)
    });
    (1.0 + terms.sum::<f64>()).ln() - half
}

/// The sum of some states.
fn sum(states: impl Iterator<Item = State>) -> State {
    states.fold([0.0; PARTS], |sum, state| std::array::from_fn(|i| sum[i] + state[i]))
}
