//! The faults of a recording over time.

use super::faults::{Burst, Faults, PointOrder, ShadowFill};
use super::noise::{Noise, normal, normal3};
use crate::geometry::Pose;
use glam::{DMat3, DQuat, DVec2, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// What the faults of a recording are at every tick of the recorder's clock.
///
/// Every fault has a stream of random numbers of its own: switching one on changes nothing of another.
#[derive(Debug)]
pub(super) struct Course<'a> {
    faults: &'a Faults,
    noise: &'a Noise,
    /// Amplitude of every harmonic of the smooth contour error, mm, from the 0th on.
    amplitudes_mm: Vec<f64>,
    /// Of every tick and harmonic, the parts of cosine and sine.
    harmonics: Vec<Vec<DVec2>>,
    /// Of every tick, position (mm) and rotation vector (rad) by which the tracker is off.
    slow: Vec<(DVec3, DVec3)>,
    /// Of every tick, how far its pose is thrown aside, mm.
    thrown_mm: Vec<DVec3>,
    /// Of every tick, the one that its pose is from.
    pose_of: Vec<usize>,
    in_burst: Vec<bool>,
    shake: DVec3,
}

/// Streams of random numbers, apart from those of frames and of the drift.
const SMOOTH: u64 = u64::MAX - 1;
const SLOW: u64 = u64::MAX - 2;
const GLITCHES: u64 = u64::MAX - 3;
const FREEZES: u64 = u64::MAX - 4;
const BURSTS: u64 = u64::MAX - 5;
const SHAKE: u64 = u64::MAX - 6;
/// The first of the streams of frames: ring-down and the order of points.
const OF_FRAMES: u64 = 1 << 62;

impl<'a> Course<'a> {
    pub fn new(faults: &'a Faults, noise: &'a Noise, ticks: usize, tick_s: f64) -> Self {
        let Faults { contour, artefacts, tracker, .. } = faults;
        let (amplitudes_mm, harmonics) = if contour.smooth_sd_mm > 0.0 {
            let amplitudes_mm = amplitudes_mm(contour.smooth_sd_mm, contour.smooth_angle_deg.to_radians());
            let mut rng = noise.stream(SMOOTH);
            let mut draw =
                || amplitudes_mm.iter().map(|_| DVec2::new(normal(&mut rng), normal(&mut rng))).collect();
            let harmonics = forgetting(
                ticks,
                tick_s,
                contour.smooth_time_s,
                &mut draw,
                |was: &Vec<DVec2>, new, keep, fresh| {
                    was.iter().zip(new).map(|(was, new)| *was * keep + *new * fresh).collect()
                },
            );
            (amplitudes_mm, harmonics)
        } else {
            (Vec::new(), vec![Vec::new(); ticks])
        };
        let mut rng = noise.stream(SLOW);
        let mut draw = || (normal3(&mut rng), normal3(&mut rng));
        let slow = forgetting(
            ticks,
            tick_s,
            tracker.memory_s,
            &mut draw,
            |was: &(DVec3, DVec3), new, keep, fresh| {
                (was.0 * keep + new.0 * fresh, was.1 * keep + new.1 * fresh)
            },
        );
        let turn = tracker.slow_rotation_sd_deg.to_radians();
        let slow = slow.into_iter().map(|(p, r)| (p * tracker.slow_position_sd_mm, r * turn)).collect();

        let mut rng = noise.stream(GLITCHES);
        let mut thrown_mm = vec![DVec3::ZERO; ticks];
        for tick in chosen(ticks, tracker.glitches, &mut rng) {
            thrown_mm[tick] = normal3(&mut rng).normalize_or(DVec3::X) * tracker.glitch_mm;
        }
        let slower = |tick: usize| match tracker.rate_hz > 0.0 {
            // The last tick at which the tracker had a new pose.
            true => {
                let sample_s = (tick as f64 * tick_s * tracker.rate_hz + 1e-9).floor() / tracker.rate_hz;
                ((sample_s / tick_s - 1e-9).ceil().max(0.0) as usize).min(tick)
            }
            false => tick,
        };
        let mut pose_of: Vec<usize> = (0..ticks).map(slower).collect();
        let mut rng = noise.stream(FREEZES);
        let frozen = (tracker.freeze_s / tick_s).round() as usize;
        for start in chosen(ticks, tracker.freezes, &mut rng) {
            for tick in start..ticks.min(start + frozen + 1) {
                pose_of[tick] = pose_of[start];
            }
        }
        Self {
            faults,
            noise,
            amplitudes_mm,
            harmonics,
            slow,
            thrown_mm,
            pose_of,
            in_burst: bursts(
                ticks,
                artefacts.burst_share,
                artefacts.burst_s / tick_s,
                &mut noise.stream(BURSTS),
            ),
            shake: normal3(&mut noise.stream(SHAKE)).normalize_or(DVec3::X) * tracker.shake_mm,
        }
    }

    /// The tick whose pose a frame has.
    pub fn pose_of(&self, tick: usize) -> usize {
        self.pose_of[tick]
    }

    /// Where the vessel and the catheter in it are, as a shift from rest, mm.
    pub fn shift_mm(&self, time_s: f64) -> DVec3 {
        let motion = &self.faults.motion;
        let way = |rate_hz: f64| 0.5 - 0.5 * (TAU * rate_hz * time_s).cos();
        DVec3::from(motion.breathing_mm) * way(motion.breathing_hz)
            + DVec3::from(motion.heart_beat_mm) * way(self.noise.pulsation_rate_hz)
    }

    /// The pose of a tick with the tracker's slow errors; `tracked` has its noise.
    pub fn slow(&self, tracked: Pose, tick: usize, time_s: f64) -> Pose {
        let (shift, turn) = self.slow[tick];
        let shake = self.shake * (TAU * self.faults.tracker.shake_hz * time_s).sin();
        Pose {
            rotation: tracked.rotation * turned(turn),
            translation_mm: tracked.translation_mm + shift + shake,
        }
    }

    /// The pose that is stored in the frame of a tick.
    pub fn stored(&self, pose: Pose, tick: usize) -> Pose {
        let calibration = &self.faults.calibration;
        let thrown = Pose { translation_mm: pose.translation_mm + self.thrown_mm[tick], ..pose };
        thrown
            * Pose {
                rotation: turned(DVec3::from(calibration.rotation_deg.map(f64::to_radians))),
                translation_mm: DVec3::from(calibration.offset_mm),
            }
    }

    /// The smooth error of a ray at `angle_rad`, mm.
    pub fn smooth_mm(&self, tick: usize, angle_rad: f64) -> f64 {
        let harmonics = self.amplitudes_mm.iter().zip(&self.harmonics[tick]).enumerate();
        harmonics
            .map(|(k, (amplitude, part))| amplitude * part.dot(DVec2::from_angle(k as f64 * angle_rad)))
            .sum()
    }

    /// The contour that is stored in the frame of a tick; point j of `contour_mm` is the echo of the ray at
    /// `angles_rad[j]`, NaN where there is none.
    pub fn contour_mm(
        &self,
        tick: usize,
        time_s: f64,
        angles_rad: &[f64],
        mut contour_mm: Vec<DVec2>,
    ) -> Vec<DVec2> {
        let Faults { artefacts, calibration, sampling, .. } = self.faults;
        if self.in_burst[tick] {
            burst(artefacts.burst, &mut contour_mm);
        }
        let within = |width_deg: f64, start_deg: f64, turn_deg_s: f64, angle_rad: f64| {
            // A ray at the very beginning belongs to the sector in spite of rounding.
            (angle_rad.to_degrees() - start_deg - turn_deg_s * time_s + 1e-9).rem_euclid(360.0) < width_deg
        };
        if artefacts.shadow_deg > 0.0 {
            let hidden = |angle| within(artefacts.shadow_deg, 120.0, artefacts.shadow_turn_deg_s, angle);
            shadow(
                &angles_rad.iter().map(|&angle| hidden(angle)).collect::<Vec<_>>(),
                artefacts.shadow_fill,
                &mut contour_mm,
            );
        }
        let mut rng = self.noise.stream(OF_FRAMES + tick as u64);
        if artefacts.ring_down_deg > 0.0 {
            for (point, &angle) in contour_mm.iter_mut().zip(angles_rad) {
                let radius_mm = artefacts.ring_down_mm * (1.0 + 0.03 * normal(&mut rng)).max(0.0);
                if within(artefacts.ring_down_deg, 90.0, artefacts.ring_down_turn_deg_s, angle) {
                    *point = DVec2::from_angle(angle) * radius_mm;
                }
            }
        }
        contour_mm.iter_mut().for_each(|p| *p *= calibration.sound_speed);
        match sampling.point_order {
            PointOrder::Scan => (),
            PointOrder::Reversed => contour_mm.reverse(),
            // Fisher and Yates.
            PointOrder::Shuffled => {
                for last in (1..contour_mm.len()).rev() {
                    contour_mm.swap(last, rng.random_range(0..=last));
                }
            }
        }
        contour_mm
    }
}

/// Amplitudes of the harmonics of a periodic field with the correlation exp(-(angle/reach)²/2), from the 0th
/// on.
fn amplitudes_mm(sd_mm: f64, reach_rad: f64) -> Vec<f64> {
    // Beyond 5/reach their variances are below 1e-5 of the first.
    let weights: Vec<f64> = (0..=(5.0 / reach_rad).ceil() as usize)
        .map(|k| if k == 0 { 1.0 } else { 2.0 * (-0.5 * (k as f64 * reach_rad).powi(2)).exp() })
        .collect();
    let whole: f64 = weights.iter().sum();
    weights.iter().map(|weight| sd_mm * (weight / whole).sqrt()).collect()
}

/// A stationary series: every value keeps a part of the one before, forgotten over `memory_s`, and takes a new
/// draw.
fn forgetting<T>(
    ticks: usize,
    tick_s: f64,
    memory_s: f64,
    draw: &mut dyn FnMut() -> T,
    mix: impl Fn(&T, &T, f64, f64) -> T,
) -> Vec<T> {
    let keep = if memory_s > 0.0 { (-tick_s / memory_s).exp() } else { 0.0 };
    let fresh = (1.0 - keep * keep).sqrt();
    let mut series: Vec<T> = Vec::with_capacity(ticks);
    for _ in 0..ticks {
        let new = draw();
        series.push(match series.last() {
            Some(was) => mix(was, &new, keep, fresh),
            None => new,
        });
    }
    series
}

/// `count` different ticks after the first one, in order of their draw; all where there are fewer.
fn chosen(ticks: usize, count: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut others: Vec<usize> = (1..ticks).collect();
    let count = count.min(others.len());
    for i in 0..count {
        let with = rng.random_range(i..others.len());
        others.swap(i, with);
    }
    others.truncate(count);
    others
}

/// Which ticks lie in bursts of `mean` ticks, `share` of all.
fn bursts(ticks: usize, share: f64, mean: f64, rng: &mut ChaCha8Rng) -> Vec<bool> {
    let mut in_burst = vec![false; ticks];
    if share <= 0.0 {
        return in_burst;
    }
    let mut tick = 0.0;
    loop {
        let gap = -(1.0 - rng.random::<f64>()).ln() * mean * (1.0 - share) / share;
        let length = mean * (0.5 + rng.random::<f64>());
        let (from, until) = ((tick + gap).round(), (tick + gap + length).round());
        if from >= ticks as f64 {
            return in_burst;
        }
        in_burst[from as usize..(until as usize).min(ticks)].fill(true);
        // Bursts shorter than a tick must not keep the loop from its end.
        tick = (tick + gap + length).max(tick + 1e-3);
    }
}

fn burst(kind: Burst, contour_mm: &mut [DVec2]) {
    let echoes = || contour_mm.iter().copied().filter(|p| !p.is_nan());
    let count = echoes().count().max(1) as f64;
    let centre = echoes().sum::<DVec2>() / count;
    let mean_mm = echoes().map(|p| p.distance(centre)).sum::<f64>() / count;
    for p in contour_mm {
        let out = *p - centre;
        *p = centre
            + match kind {
                Burst::Small => out * 0.55,
                Burst::Large => out * 1.45,
                Burst::Shape => out * (1.0 + 0.4 * (2.0 * (out.to_angle() - 0.5)).cos()),
                Burst::Media => out + out.normalize_or_zero() * 0.15 * mean_mm,
            };
    }
}

/// Replaces what is hidden by nothing, or by the chord between the echoes on both sides.
fn shadow(hidden: &[bool], fill: ShadowFill, contour_mm: &mut [DVec2]) {
    let rays = hidden.len();
    let seen = contour_mm.to_vec();
    // From ray j on, the first one that is not hidden and has an echo, and how many rays away it is.
    let beside = |j: usize, back: bool| {
        (1..rays)
            .map(|n| (n, if back { (j + rays - n) % rays } else { (j + n) % rays }))
            .find(|&(_, i)| !hidden[i] && !seen[i].is_nan())
            .map(|(n, i)| (n as f64, seen[i]))
    };
    for (j, point) in contour_mm.iter_mut().enumerate().filter(|&(j, _)| hidden[j]) {
        *point = match (fill, beside(j, true), beside(j, false)) {
            (ShadowFill::Chord, Some((m, a)), Some((n, b))) => a.lerp(b, m / (m + n)),
            _ => DVec2::NAN,
        };
    }
}

fn turned(vector_rad: DVec3) -> DMat3 {
    DMat3::from_quat(DQuat::from_scaled_axis(vector_rad))
}
