//! Kinds of errors that the echoes of a recording may have, and random draws of them.

use crate::numerics::vectorized;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::f64::consts::{SQRT_2, TAU};

/// A kind of error, of unit standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Process {
    /// Of every echo for itself.
    Ray,
    /// A shift of the whole frame. It is forgotten over `correlation_s`: in successive frames the correlation is
    /// `exp(-Δt/correlation_s)`, and there is none where it is 0.
    Shift { correlation_s: f64 },
    /// Of the contour, alike over a width about the lumen (the standard deviation of a Gaussian of that is `width_rad / √2`)
    /// and forgotten over `correlation_s` as above.
    Contour { width_rad: f64, correlation_s: f64 },
    /// An oscillation with a frequency: `order` 0 of the lumen's size, 1 of the place of the whole frame.
    Beat { order: u32, frequency_hz: f64 },
    /// Bends of the wall, as its prior expects them, which the fit smooths away.
    Wall,
}

impl Process {
    /// Whether successive frames have nothing of it in common.
    pub(super) fn is_white(self) -> bool {
        match self {
            Self::Ray => true,
            Self::Shift { correlation_s } | Self::Contour { correlation_s, .. } => correlation_s == 0.0,
            Self::Beat { .. } | Self::Wall => false,
        }
    }
}

/// Seed of all draws, so that equal recordings have equal standard errors.
const SEED: u64 = 0x1d3a_5e01;
/// Harmonics of a contour's errors are left out where they have less than this amplitude.
const MIN_AMPLITUDE: f64 = 0.01;

/// Random numbers of a draw; `stream` tells apart what must be independent.
pub(super) fn random(draw: usize, stream: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    rng.set_stream((draw * 64 + stream) as u64);
    rng
}

pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Random signs, for errors whose variances alone count: a variance that is linear in squares of draws is estimated with a
/// smaller error from signs than from normal numbers (M. F. Hutchinson, *A stochastic estimator of the trace of the influence
/// matrix for Laplacian smoothing splines*, Communications in Statistics 18, 1989).
pub(super) struct Signs<'a> {
    rng: &'a mut ChaCha8Rng,
    bits: u64,
    left: u32,
}

impl<'a> Signs<'a> {
    pub(super) fn of(rng: &'a mut ChaCha8Rng) -> Self {
        Self { rng, bits: 0, left: 0 }
    }

    /// 1 or -1.
    #[inline]
    pub(super) fn draw(&mut self) -> f64 {
        if self.left == 0 {
            (self.bits, self.left) = (self.rng.random(), u64::BITS);
        }
        let sign = if self.bits & 1 == 0 { 1.0 } else { -1.0 };
        self.bits >>= 1;
        self.left -= 1;
        sign
    }
}

/// Where and when an echo was seen: its angle about the axis, from 0 to a turn, with its cosine and sine, and its frame, counted
/// among those with echoes. In single precision: every draw passes over all of them, and waits for memory.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub theta_rad: f32,
    pub direction: [f32; 2],
    pub frame: u32,
}

impl Seen {
    pub(super) fn new(theta_rad: f64, frame: u32) -> Self {
        let theta_rad = theta_rad.rem_euclid(TAU) as f32;
        let (sin, cos) = theta_rad.sin_cos();
        Self { theta_rad, direction: [cos, sin], frame }
    }
}

/// Angles about the lumen at which the errors of a contour are computed; between them they are interpolated. The first one comes
/// last as well.
const ANGLES: usize = 128;
const ROW: usize = ANGLES + 1;

/// Adds a draw of a process, times `sd_mm`, to the errors of the echoes. `times_s` are those of the frames. The bends of a
/// wall are drawn elsewhere: they are no errors of echoes.
pub(super) fn add_draw(
    process: Process,
    sd_mm: f64,
    rng: &mut ChaCha8Rng,
    echoes: &[Seen],
    times_s: &[f64],
    errors_mm: &mut [f64],
) {
    match process {
        Process::Ray => vectorized(
            #[inline(always)]
            || {
                for errors_mm in errors_mm.chunks_mut(u64::BITS as usize) {
                    let bits: u64 = rng.random();
                    for (i, error) in (0..).zip(errors_mm) {
                        *error += if bits >> i & 1 == 0 { sd_mm } else { -sd_mm };
                    }
                }
            },
        ),
        Process::Shift { correlation_s } => {
            let series = pair(rng, &memories(times_s, correlation_s));
            vectorized(
                #[inline(always)]
                || {
                    for (error, echo) in errors_mm.iter_mut().zip(echoes) {
                        let ([cos, sin], [a, b]) =
                            (echo.direction.map(f64::from), series[echo.frame as usize]);
                        *error += sd_mm * (cos * a + sin * b);
                    }
                },
            );
        }
        Process::Contour { width_rad, correlation_s } => {
            let amplitude = |m: usize| (-0.5 * (0.5 * m as f64 * width_rad).powi(2)).exp();
            let amplitudes: Vec<f64> = (0..).map(amplitude).take_while(|a| *a > MIN_AMPLITUDE).collect();
            let scale = sd_mm / amplitudes.iter().map(|a| a * a).sum::<f64>().sqrt();
            let memories = memories(times_s, correlation_s);
            let mut series = vec![0.0; times_s.len() * ROW];
            for (m, amplitude) in amplitudes.iter().enumerate() {
                add_harmonic(m, &pair(rng, &memories), (scale * amplitude) as f32, &mut series);
            }
            vectorized(
                #[inline(always)]
                || {
                    for (error, echo) in errors_mm.iter_mut().zip(echoes) {
                        let place = echo.theta_rad * (ANGLES as f32 / TAU as f32);
                        let below = (place as usize).min(ANGLES - 1);
                        let at = echo.frame as usize * ROW + below;
                        let [a, b] = [series[at], series[at + 1]];
                        *error += f64::from(a + (place - below as f32) * (b - a));
                    }
                },
            );
        }
        Process::Beat { order, frequency_hz } => {
            // A cosine and, but for the size, a sine about the lumen, each with a phase of its own.
            let series = [0; 2].map(|_| {
                let phase = TAU * rng.random::<f64>();
                let at = |t: &f64| SQRT_2 * (TAU * frequency_hz * t + phase).cos();
                times_s.iter().map(at).collect::<Vec<f64>>()
            });
            for (error, echo) in errors_mm.iter_mut().zip(echoes) {
                let [cos, sin] = if order == 0 { [1.0, 0.0] } else { echo.direction.map(f64::from) };
                let frame = echo.frame as usize;
                *error += sd_mm * (cos * series[0][frame] + sin * series[1][frame]);
            }
        }
        Process::Wall => (),
    }
}

/// Adds `size (a cos mθ + b sin mθ)` to the errors of contours at [`ROW`] angles; `series` has a and b, frame by frame.
fn add_harmonic(m: usize, series: &[[f64; 2]], size: f32, errors_mm: &mut [f32]) {
    let wave = |of: fn(f64) -> f64| -> [f32; ROW] {
        std::array::from_fn(|k| of(TAU * (m * k % ANGLES) as f64 / ANGLES as f64) as f32)
    };
    let (cos, sin) = (wave(f64::cos), wave(f64::sin));
    vectorized(
        #[inline(always)]
        || {
            for (row, pair) in errors_mm.chunks_exact_mut(ROW).zip(series) {
                let [a, b] = pair.map(|x| size * x as f32);
                for ((error, cos), sin) in row.iter_mut().zip(&cos).zip(&sin) {
                    *error += a * cos + b * sin;
                }
            }
        },
    );
}

/// The slowest breath, Hz: what is slower can also be a drift of the tracker, or a bend of the vessel.
pub(in crate::sweep) const SLOWEST_BREATH_HZ: f64 = 0.1;
/// Fewest periods of an oscillation in a recording, and how far its power exceeds the mean power at all frequencies: the
/// largest of a thousand powers of noise is about seven times the mean.
const MIN_PERIODS: f64 = 4.0;
const MIN_POWER: f64 = 20.0;
/// Frames that are looked at, from the middle of the recording: the work grows with their square.
const MAX_FRAMES: usize = 4096;
/// Frequencies of a parallel task, one after the other: waves are turned from one to the next.
const FREQUENCIES: usize = 64;
/// Frames whose parts of a sum are added up side by side.
const LANES: usize = 8;

/// The frequency at which values of the frames oscillate, Hz, at least `least_hz`, if one stands out in the sum of their powers.
pub(super) fn frequency_hz(times_s: &[f64], values: &[&[f64]], least_hz: f64) -> Option<f64> {
    let Spectrum { first, step_hz, powers } = Spectrum::of(times_s, values)?;
    let mean = powers.iter().sum::<f64>() / powers.len().max(1) as f64;
    let least = ((least_hz / step_hz).ceil() as usize).saturating_sub(first);
    let best = (least..powers.len()).max_by(|&a, &b| powers[a].total_cmp(&powers[b]).then(b.cmp(&a)))?;
    (powers[best] > MIN_POWER * mean).then(|| (first + best) as f64 * step_hz)
}

/// Powers of values of the frames, from [`MIN_PERIODS`] in the recording to half the frame rate.
pub(in crate::sweep) struct Spectrum {
    /// The first frequency, in steps.
    pub first: usize,
    /// From one frequency to the next, Hz.
    pub step_hz: f64,
    /// At each frequency the sum over the values.
    pub powers: Vec<f64>,
}

impl Spectrum {
    /// `None` where the frames span no time.
    pub(in crate::sweep) fn of(times_s: &[f64], values: &[&[f64]]) -> Option<Self> {
        let from = times_s.len().saturating_sub(MAX_FRAMES) / 2;
        let times_s = &times_s[from..times_s.len().min(from + MAX_FRAMES)];
        let (first, last) = (times_s.first()?, times_s.last()?);
        let span_s = last - first;
        let count = times_s.len() as f64;
        // Up to half the frame rate.
        let steps = count as usize;
        if span_s.is_nan() || span_s <= 0.0 {
            return None;
        }
        // Zeros behind the last frame, up to whole rows of lanes, add nothing.
        let filled = |values: &[f64]| -> Vec<f64> {
            let mut values = values[..times_s.len()].to_vec();
            values.resize(times_s.len().next_multiple_of(LANES), 0.0);
            values
        };
        let (times_s, values) =
            (filled(times_s), values.iter().map(|values| filled(&values[from..])).collect::<Vec<_>>());
        let wave = |turns: f64| {
            let (sines, cosines) = times_s.iter().map(|t| (TAU * turns * t).sin_cos()).unzip();
            [cosines, sines]
        };
        let least = (2.0 * MIN_PERIODS) as usize;
        let of_step = wave(0.5 / span_s);
        let powers_of = |first: usize| -> Vec<f64> {
            let mut waves = wave(0.5 * first as f64 / span_s);
            let mut powers = vec![0.0; (first + FREQUENCIES).min(steps) - first];
            vectorized(
                #[inline(always)]
                || {
                    for power in &mut powers {
                        for values in &values {
                            *power += power_of(&waves, values);
                        }
                        turn_on(&mut waves, &of_step);
                    }
                },
            );
            powers
        };
        let firsts: Vec<usize> = (least..steps).step_by(FREQUENCIES).collect();
        let powers: Vec<f64> = firsts.into_par_iter().flat_map_iter(powers_of).collect();
        Some(Self { first: least, step_hz: 0.5 / span_s, powers })
    }
}

/// The squares of the sums of values, times each wave.
#[inline(always)]
fn power_of(waves: &[Vec<f64>; 2], values: &[f64]) -> f64 {
    let mut power = 0.0;
    for wave in waves {
        let mut sums = [0.0; LANES];
        for (wave, values) in wave.chunks_exact(LANES).zip(values.chunks_exact(LANES)) {
            for ((sum, wave), value) in sums.iter_mut().zip(wave).zip(values) {
                *sum += value * wave;
            }
        }
        power += sums.iter().sum::<f64>().powi(2);
    }
    power
}

/// Adds to the angles of waves, of which they are cosines and sines, those of a step.
#[inline(always)]
fn turn_on([cosines, sines]: &mut [Vec<f64>; 2], [step_cosines, step_sines]: &[Vec<f64>; 2]) {
    for ((cos, sin), (x, y)) in cosines.iter_mut().zip(sines).zip(step_cosines.iter().zip(step_sines)) {
        (*cos, *sin) = (*cos * x - *sin * y, *sin * x + *cos * y);
    }
}

/// Of every frame: what remains of the error before, `exp(-Δt/correlation_s)`, and the standard deviation of what is new.
fn memories(times_s: &[f64], correlation_s: f64) -> Vec<[f64; 2]> {
    let mut before = None;
    let memory = |&time_s: &f64| {
        let kept = match before {
            Some(before) if correlation_s > 0.0 => (-f64::max(time_s - before, 0.0) / correlation_s).exp(),
            _ => 0.0,
        };
        before = Some(time_s);
        [kept, (1.0 - kept * kept).sqrt()]
    };
    times_s.iter().map(memory).collect()
}

/// A stationary series of unit variance.
fn series(rng: &mut ChaCha8Rng, memories: &[[f64; 2]]) -> impl Iterator<Item = f64> {
    let mut value = 0.0;
    memories.iter().map(move |[kept, new]| {
        value = kept * value + new * normal(rng);
        value
    })
}

/// Two such series.
fn pair(rng: &mut ChaCha8Rng, memories: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut both: Vec<[f64; 2]> = series(rng, memories).map(|first| [first, 0.0]).collect();
    both.iter_mut().zip(series(rng, memories)).for_each(|(both, second)| both[1] = second);
    both
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_oscillation_is_found_in_noise_and_none_in_noise_alone() {
        let times_s: Vec<f64> = (0..600).map(|k| f64::from(k) / 12.0).collect();
        let rng = &mut random(1, 5);
        let noise: Vec<f64> = times_s.iter().map(|_| normal(rng)).collect();
        assert_eq!(frequency_hz(&times_s, &[&noise], 0.0), None);
        for expected_hz in [0.25, 1.2, 3.0] {
            let beating = |(t, noise): (&f64, &f64)| (TAU * expected_hz * t + 1.0).sin() + noise;
            let beating: Vec<f64> = times_s.iter().zip(&noise).map(beating).collect();
            let found_hz = frequency_hz(&times_s, &[&noise, &beating], 0.0).unwrap();
            assert!((found_hz - expected_hz).abs() < 0.011, "{found_hz}");
            assert_eq!(frequency_hz(&times_s, &[&noise, &beating], 1.1 * expected_hz), None);
        }
        assert_eq!(frequency_hz(&[], &[&[]], 0.0), None);
        assert_eq!(frequency_hz(&[1.0; 9], &[&[0.3; 9]], 0.0), None);
    }

    #[test]
    fn errors_of_contours_have_unit_variance_and_their_width() {
        // Echoes of 400 frames at the angles 0, 0.3 rad, …, 2.7 rad.
        let seen: Vec<Seen> = (0..4000).map(|i| Seen::new(0.3 * f64::from(i % 10), i / 10)).collect();
        let times_s: Vec<f64> = (0..400).map(f64::from).collect();
        for width_rad in [0.35, 0.7] {
            let mut errors_mm = vec![0.0; 4000];
            let kind = Process::Contour { width_rad, correlation_s: 0.0 };
            add_draw(kind, 2.0, &mut random(0, 3), &seen, &times_s, &mut errors_mm);
            let covariance = |apart: usize| {
                let products = errors_mm.chunks_exact(10).map(|frame| frame[0] * frame[apart]);
                products.sum::<f64>() / 400.0
            };
            for apart in [0, 1, 9] {
                // Amplitudes exp(-(mw)²/8) are a Gaussian covariance exp(-(θ/w)²).
                let expected = 4.0 * (-(0.3 * apart as f64 / width_rad).powi(2)).exp();
                assert!((covariance(apart) - expected).abs() < 0.7, "{apart}: {}", covariance(apart));
            }
        }
        // At the angles of the table they are the harmonics themselves.
        let mut errors_mm = vec![0.0; 2 * ROW];
        add_harmonic(5, &[[1.0, 0.5], [0.0, 2.0]], 2.0, &mut errors_mm);
        for (frame, [a, b]) in [[1.0, 0.5], [0.0, 2.0]].into_iter().enumerate() {
            for k in 0..ROW {
                let angle = 5.0 * TAU * k as f64 / ANGLES as f64;
                let expected = 2.0 * (a * angle.cos() + b * angle.sin());
                assert!((f64::from(errors_mm[frame * ROW + k]) - expected).abs() < 1e-5, "{frame} {k}");
            }
        }
    }

    #[test]
    fn a_series_forgets_over_its_correlation_time() {
        let times_s: Vec<f64> = (0..200_000).map(|k| 0.1 * f64::from(k)).collect();
        for correlation_s in [0.0, 0.2, 1.0] {
            let series: Vec<f64> = series(&mut random(0, 3), &memories(&times_s, correlation_s)).collect();
            let covariance = |lag: usize| {
                let products = series.iter().zip(&series[lag..]).map(|(a, b)| a * b);
                products.sum::<f64>() / (series.len() - lag) as f64
            };
            assert!((covariance(0) - 1.0).abs() < 0.05, "{correlation_s}");
            for lag in [2, 10] {
                let expected =
                    if correlation_s > 0.0 { (-0.1 * lag as f64 / correlation_s).exp() } else { 0.0 };
                assert!(
                    (covariance(lag) - expected).abs() < 0.04,
                    "{correlation_s} {lag}: {}",
                    covariance(lag)
                );
            }
        }
    }
}
