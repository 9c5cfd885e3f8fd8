//! Periodic motions about a fitted wall: a step of least squares with the wall free.
//!
//! With the wall r free, an echo's residual is `y = P (e + G β)`: β are the parameters of the cycles, G their effects on the
//! echo, and P is what a fit of the wall leaves of the echoes' values. The likeliest change of β solves
//! `(GᵀW P G + σ²D⁻¹) δ = GᵀW y - σ²D⁻¹ β`, where W has the robust weights and D the variances that are expected of β.

use super::cycle::{Clock, PARTS, Rhythm, State, WAVES, waves_at};
use crate::numerics::cholesky::{Matrix, cholesky, dot, inverse_column, solve};
use crate::sweep::errors::smoother::{Smoother, linearised};
use crate::sweep::prepare::axis::Axis;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::WallGrid;
use crate::sweep::wall::fit::Wall;
use crate::sweep::wall::residual::TASK;
use crate::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;

/// Cycles of a recording: breath and heart.
pub(super) const CYCLES: usize = 2;
/// Parameters of a cycle: its waves, and the frequency.
pub(super) const OF_CYCLE: usize = WAVES * PARTS + 1;
pub(super) const PARAMETERS: usize = CYCLES * OF_CYCLE;
/// The parameters' expected standard deviations: of the place in contour radii, of the size as a share of the radius, and of
/// the frequency in cycles over the whole recording. What echoes do not tell, as shifts along a straight vessel, stays 0 with
/// this as its standard error.
const PLACE_SD_RADII: f64 = 0.25;
const SIZE_SD: f64 = 0.1;
const FREQUENCY_SD: f64 = 0.25;
/// Segments of the recording whose scatter tells by how much errors that neighbouring frames share add to standard errors.
const SEGMENTS: usize = 24;

/// A parameter of the cycles for each place in a list, or what belongs to it.
pub(super) type Parameters = [f64; PARAMETERS];

/// A step of the parameters, the covariance of their errors, and what the segments of the recording say of them.
pub(super) struct Step {
    pub change: Parameters,
    pub covariance: Covariance,
    segments: Vec<Segment>,
    prior: Parameters,
    now: Parameters,
}

impl Step {
    /// How well some parameters, as all segments of the recording but one tell them, explain the echoes of that one: the sum over
    /// the segments of what they gain in squares, in units of its own scatter. Noise gains nothing; a vessel's shape that
    /// looks like a motion in some places is not confirmed by the others.
    pub fn confirmation(&self, chosen: &[usize]) -> f64 {
        let of = |segment: &Segment| {
            let mut score = [0.0; PARAMETERS];
            let mut matrix: Matrix<PARAMETERS> = [[0.0; PARAMETERS]; PARAMETERS];
            for (i, &a) in chosen.iter().enumerate() {
                for (j, &b) in chosen.iter().enumerate() {
                    matrix[i][j] = 0.5 * (segment.information[a][b] + segment.information[b][a]);
                    score[i] += matrix[i][j] * self.now[b];
                }
                score[i] += segment.score[a];
            }
            (score, matrix)
        };
        let parts: Vec<(Parameters, Matrix<PARAMETERS>)> = self.segments.iter().map(of).collect();
        let gain = |held_out: usize| {
            let mut matrix: Matrix<PARAMETERS> = [[0.0; PARAMETERS]; PARAMETERS];
            let mut right = [0.0; PARAMETERS];
            (0..PARAMETERS).for_each(|i| matrix[i][i] = chosen.get(i).map_or(1.0, |&a| self.prior[a]));
            for (score, information) in
                parts.iter().enumerate().filter(|(s, _)| *s != held_out).map(|(_, p)| p)
            {
                add(&mut right, score);
                matrix.iter_mut().zip(information).for_each(|(line, other)| add(line, other));
            }
            let found = cholesky(&matrix).map_or([0.0; PARAMETERS], |factor| solve(&factor, right));
            let (score, information) = &parts[held_out];
            let explained =
                information.iter().zip(&found).map(|(line, x)| x * dot(line, &found)).sum::<f64>();
            2.0 * dot(score, &found) - explained
        };
        let gains: Vec<f64> = (0..parts.len()).map(gain).collect();
        let scatter = gains.iter().map(|gain| gain * gain).sum::<f64>().sqrt();
        if scatter > 0.0 { gains.iter().sum::<f64>() / scatter } else { 0.0 }
    }
}

/// Adds one list to another.
fn add(sums: &mut Parameters, others: &Parameters) {
    sums.iter_mut().zip(others).for_each(|(sum, other)| *sum += other);
}

/// The covariance of the parameters' errors.
pub(super) struct Covariance(Vec<Parameters>);

impl Covariance {
    /// The variance of a sum of parameters with these factors.
    pub fn variance(&self, factors: &Parameters) -> f64 {
        self.of(factors, factors).max(0.0)
    }

    /// The covariance of two sums of parameters.
    pub fn of(&self, a: &Parameters, b: &Parameters) -> f64 {
        let of_line = |line: &Parameters| line.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        self.0.iter().zip(a).map(|(line, factor)| factor * of_line(line)).sum()
    }

    /// `xᵀC⁻¹x` over some parameters: as χ² with as many degrees of freedom if x is noise.
    pub fn chi_squared(&self, values: &Parameters, chosen: &[usize]) -> f64 {
        let mut matrix: Matrix<PARAMETERS> = [[0.0; PARAMETERS]; PARAMETERS];
        (0..PARAMETERS).for_each(|i| matrix[i][i] = 1.0);
        let mut of_chosen = [0.0; PARAMETERS];
        for (i, &a) in chosen.iter().enumerate() {
            of_chosen[i] = values[a];
            chosen.iter().enumerate().for_each(|(j, &b)| matrix[i][j] = self.0[a][b]);
        }
        let factor = cholesky(&matrix);
        factor.map_or(0.0, |l| solve(&l, of_chosen).iter().zip(of_chosen).map(|(a, b)| a * b).sum())
    }
}

/// The place in the parameters of a wave's effect on a part, and of a cycle's frequency.
pub(super) fn place_of(cycle: usize, wave: usize, part: usize) -> usize {
    cycle * OF_CYCLE + wave * PARTS + part
}

pub(super) fn place_of_frequency(cycle: usize) -> usize {
    (cycle + 1) * OF_CYCLE - 1
}

/// The echoes of a recording without the motion of its cycles, about the wall that was fitted to them.
pub(super) struct Fitted<'a> {
    pub grid: &'a WallGrid,
    pub axis: &'a Axis,
    pub echoes: &'a [Echo],
    pub wall: &'a Wall,
    pub roughness: f64,
    pub clock: &'a Clock,
    /// Median radius of the contours, mm.
    pub radius_mm: f64,
}

/// What a unit of each part of a state does to the residual of an echo, mm.
pub(super) type Effect = State;

impl Fitted<'_> {
    /// Of every echo, what place and size do to its residual.
    pub fn effects(&self) -> Vec<Effect> {
        let Self { grid, axis, wall, .. } = *self;
        let model = wall.residual_model(grid);
        let effect = |echo: &Echo| {
            let mut echo = *echo;
            let (_, directions) = axis.at(echo.ring, echo.theta_rad(grid.nodes), echo.radius_mm);
            let measured = model.measure(&mut echo, false);
            let scale = measured.weight.sqrt();
            let DVec3 { x, y, z } = directions * measured.normal * scale;
            [x, y, z, scale * measured.wall_mm]
        };
        self.echoes.par_iter().map(effect).collect()
    }

    /// The factors of the parameters in a state, of each frame: of its waves, and of the frequency in cycles over the
    /// recording.
    fn frame_factors(&self, rhythms: &[Rhythm]) -> Vec<Vec<([f64; WAVES], State)>> {
        let of_frame = |frame: usize| {
            let of_rhythm = |rhythm: &Rhythm| {
                let [phase, by_frequency] = self.clock.phase(rhythm, frame);
                let waves = waves_at(phase).map(|[value, _]| value);
                let [_, by_phase] = rhythm.at(phase);
                (waves, by_phase.map(|by_phase| by_phase * by_frequency))
            };
            rhythms.iter().map(of_rhythm).collect()
        };
        (0..self.clock.times_s.len()).map(of_frame).collect()
    }

    /// A step towards the likeliest parameters of the cycles.
    ///
    /// # Errors
    /// Where the equations of the wall cannot be solved.
    pub fn step(&self, rhythms: &[Rhythm]) -> Result<Step> {
        let Self { grid, echoes, wall, roughness, clock, .. } = *self;
        let effects = self.effects();
        let factors = self.frame_factors(rhythms);
        let of_echo = |effect: &Effect, frame: usize, out: &mut Parameters| {
            for (cycle, (rhythm, (waves, by_frequency))) in rhythms.iter().zip(&factors[frame]).enumerate() {
                for part in (0..PARTS).filter(|&part| rhythm.is_free(part)) {
                    for (wave, factor) in waves.iter().enumerate() {
                        out[place_of(cycle, wave, part)] = effect[part] * factor;
                    }
                    out[place_of_frequency(cycle)] += effect[part] * by_frequency[part];
                }
            }
        };
        let terms = linearised(grid, echoes, wall);
        let smoother = Smoother::of(grid, &terms, wall.smoothness_mm2, roughness)?;
        let used = rhythms.len() * OF_CYCLE;
        // What the wall takes up of each parameter's effects.
        let walls: Vec<Vec<f64>> = (0..used)
            .into_par_iter()
            .map(|parameter| {
                let value = |(effect, echo): (&Effect, &Echo)| {
                    let mut values = [0.0; PARAMETERS];
                    of_echo(effect, echo.frame as usize, &mut values);
                    values[parameter]
                };
                smoother.wall(effects.iter().zip(echoes).map(value))
            })
            .collect::<Result<_>>()?;
        let noise_mm2 = wall.noise_mm * wall.noise_mm;
        let segment = clock.times_s.len().div_ceil(SEGMENTS);
        let tasks: Vec<Sums> = effects
            .par_chunks(TASK)
            .zip(echoes.par_chunks(TASK))
            .zip(terms.0.par_chunks(TASK))
            .map(|((effects, echoes), terms)| {
                let mut sums = Sums::new();
                for ((effect, echo), term) in effects.iter().zip(echoes).zip(terms) {
                    let weight = term.weight();
                    if weight > 0.0 {
                        let mut values = [0.0; PARAMETERS];
                        of_echo(effect, echo.frame as usize, &mut values);
                        let mut left = [0.0; PARAMETERS];
                        for (left, (value, wall)) in left.iter_mut().zip(values.iter().zip(&walls)) {
                            *left = term.left(*value, wall);
                        }
                        sums.segments[echo.frame as usize / segment].add(
                            weight,
                            &values,
                            &left,
                            echo.residual_mm,
                        );
                    }
                }
                sums
            })
            .collect();
        let sums = tasks.into_iter().reduce(Sums::plus).unwrap_or_else(Sums::new);
        let prior = self.prior(noise_mm2);
        let now = parameters(rhythms);
        let mut matrix: Matrix<PARAMETERS> = [[0.0; PARAMETERS]; PARAMETERS];
        let mut right = [0.0; PARAMETERS];
        for segment in &sums.segments {
            add(&mut right, &segment.score);
            // The solver is not exact, so the two halves differ.
            for (i, j) in (0..PARAMETERS).flat_map(|i| (0..PARAMETERS).map(move |j| (i, j))) {
                matrix[i][j] += 0.5 * (segment.information[i][j] + segment.information[j][i]);
            }
        }
        for i in 0..PARAMETERS {
            matrix[i][i] += prior[i];
            right[i] -= prior[i] * now[i];
        }
        let factor = cholesky(&matrix).ok_or_else(|| Error::Solver {
            what: "information about the vessel's motion",
            found: "a matrix that is not positive definite".into(),
            expected: "finite echoes about a wall with noise",
        })?;
        let inverse: Vec<Parameters> = (0..PARAMETERS).map(|i| inverse_column(&factor, i)).collect();
        let shared = shared_errors(&inverse, &sums.segments, noise_mm2, rhythms.len());
        let scaled = |line: &Parameters| line.map(|x| x * noise_mm2 * shared);
        let covariance = Covariance(inverse.iter().map(scaled).collect());
        Ok(Step { change: solve(&factor, right), covariance, segments: sums.segments, prior, now })
    }

    /// The inverse variances that are expected of the parameters, in units of the noise.
    fn prior(&self, noise_mm2: f64) -> Parameters {
        let of = |sd: f64| noise_mm2 / (sd * sd);
        let place = of(PLACE_SD_RADII * self.radius_mm);
        std::array::from_fn(|i| match i % OF_CYCLE {
            k if k + 1 == OF_CYCLE => of(FREQUENCY_SD),
            k if k % PARTS == 3 => of(SIZE_SD),
            _ => place,
        })
    }
}

/// The parameters as rhythms have them; their frequencies count as 0.
pub(super) fn parameters(rhythms: &[Rhythm]) -> Parameters {
    let mut parameters = [0.0; PARAMETERS];
    for (cycle, rhythm) in rhythms.iter().enumerate() {
        for (wave, state) in rhythm.waves.iter().enumerate() {
            (0..PARTS).for_each(|part| parameters[place_of(cycle, wave, part)] = state[part]);
        }
    }
    parameters
}

/// Sums over the echoes of each segment of the recording.
struct Sums {
    segments: Vec<Segment>,
}

/// Sums over some echoes.
#[derive(Clone)]
struct Segment {
    /// `GᵀW P G`.
    information: Matrix<PARAMETERS>,
    /// `GᵀW y`.
    score: Parameters,
    /// `(P G)ᵀW y`: the noise in it is that of these echoes.
    own: Parameters,
}

impl Segment {
    const NONE: Self = Self {
        information: [[0.0; PARAMETERS]; PARAMETERS],
        score: [0.0; PARAMETERS],
        own: [0.0; PARAMETERS],
    };

    fn add(&mut self, weight: f64, values: &Parameters, left: &Parameters, residual_mm: f64) {
        for (i, value) in values.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            let weighted = weight * value;
            self.information[i].iter_mut().zip(left).for_each(|(sum, left)| *sum += weighted * left);
            self.score[i] += weighted * residual_mm;
        }
        self.own.iter_mut().zip(left).for_each(|(sum, left)| *sum += weight * left * residual_mm);
    }
}

impl Sums {
    fn new() -> Self {
        Self { segments: vec![Segment::NONE; SEGMENTS] }
    }

    fn plus(mut self, other: Self) -> Self {
        for (segment, other) in self.segments.iter_mut().zip(&other.segments) {
            segment.information.iter_mut().zip(&other.information).for_each(|(a, b)| add(a, b));
            add(&mut segment.score, &other.score);
            add(&mut segment.own, &other.own);
        }
        self
    }
}

/// By how much errors that neighbouring frames share make the variances of the parameters larger than independent ones do: the
/// largest factor of a part of a cycle, as the scatter of the segments shows it, and at least 1.
fn shared_errors(inverse: &[Parameters], segments: &[Segment], noise_mm2: f64, cycles: usize) -> f64 {
    let count = segments.len() as f64;
    let mean: Parameters = std::array::from_fn(|i| segments.iter().map(|s| s.own[i]).sum::<f64>() / count);
    let moved: Vec<Parameters> = segments
        .iter()
        .map(|segment| {
            let centred: Parameters = std::array::from_fn(|i| segment.own[i] - mean[i]);
            std::array::from_fn(|i| inverse[i].iter().zip(&centred).map(|(a, b)| a * b).sum())
        })
        .collect();
    let of_part = |cycle: usize, part: usize| {
        let ratio = |wave: usize| {
            let i = place_of(cycle, wave, part);
            let scatter: f64 = moved.iter().map(|change| change[i] * change[i]).sum();
            scatter * count / (count - 1.0) / (noise_mm2 * inverse[i][i])
        };
        (0..WAVES).map(ratio).sum::<f64>() / WAVES as f64
    };
    let parts = (0..cycles).flat_map(|cycle| (0..PARTS).map(move |part| (cycle, part)));
    parts.map(|(cycle, part)| of_part(cycle, part)).fold(1.0, f64::max)
}
