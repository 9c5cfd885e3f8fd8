//! Shifts of single frames, as far as residuals tell them, and whether the wall gains by taking them off the poses.
//!
//! Only a frame's shift against those about it can be told: one that all of them share moves the wall with them, and cannot be
//! told from the vessel's own course. `docs/method.md`, section "Shifts of single frames".

use super::process::Process;
use super::smoother::{Smoother, Term};
use super::{Levels, ROUGHNESS_DRAWS, Recorded, Seen, gaussian, smoothed_along};
use crate::Result;
use crate::numerics::robust::median;
use crate::sweep::prepare::axis::Axis;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::wall::fit::Wall;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Oscillations with at most this many frames in a period shift single frames; slower ones, of breath and heart, move the vessel.
const MAX_BEAT_FRAMES: f64 = 6.0;
/// Standard deviation of the weights of the frames about a frame, in reaches of an echo.
const ABOUT_REACHES: f64 = 2.0;
/// Shifts that are smaller than what the rays' own noise makes of a frame's place are not told, …
const MIN_RAY_SDS: f64 = 1.0;
/// … and so many times larger ones outweigh it: without them the echoes agree so much better that smoothing can be weaker.
const CLEAR_RAY_SDS: f64 = 4.0;
/// In between, the errors of the wall should lose at least a seventh of their variance.
const MAX_VARIANCE_LEFT: f64 = 0.85;

/// The linear map from residuals to shifts of single frames.
pub(super) struct ShiftEstimator {
    /// Echoes, one frame after the other, and the first of each frame; the end.
    order: Vec<u32>,
    starts: Vec<usize>,
    /// Number of the frame of each echo, its weight, and its residual for shifts of 1 mm along the world's axes.
    echoes: Vec<(u32, f64, DVec3)>,
    /// `(Σ w j jᵀ + (σ/s)² I)⁻¹` of each frame.
    inverses: Vec<DMat3>,
    /// Mean place of the echoes of each frame, in rings.
    places: Vec<f64>,
    rings: usize,
    /// Weights of the frames 0, 1, … rings away.
    weights: Vec<f64>,
}

impl ShiftEstimator {
    /// About a wall; `terms` are those of the echoes' equations.
    pub(super) fn of(
        told: &Told,
        recording: &Recorded,
        axis: &Axis,
        echoes: &[Echo],
        wall: &Wall,
        terms: &[Term],
    ) -> Self {
        let (grid, seen) = (recording.grid, &recording.seen);
        let mut starts = vec![0; recording.times_s.len() + 1];
        seen.iter().for_each(|seen| starts[seen.frame as usize + 1] += 1);
        (1..starts.len()).for_each(|k| starts[k] += starts[k - 1]);
        let mut next = starts.clone();
        let mut order = vec![0; seen.len()];
        for (i, seen) in (0..).zip(seen) {
            let slot = &mut next[seen.frame as usize];
            order[*slot] = i;
            *slot += 1;
        }
        let model = wall.residual_model(grid);
        let of_echo = |((echo, seen), term): ((&Echo, &Seen), &Term)| {
            let measured = model.measure(&mut { *echo }, false);
            let (_, directions) = axis.at(echo.ring, echo.theta_rad(grid.nodes), echo.radius_mm);
            let normal = directions * measured.normal;
            // Shifts along the vessel show at narrow places only, and frames would slide to where the wall is smoothest.
            let across = normal - directions.z_axis * normal.dot(directions.z_axis);
            // One that stands for several is in no frame alone.
            let is_single = echo.weight <= 1.0;
            let effect = if is_single { across * measured.weight.sqrt() } else { DVec3::ZERO };
            (seen.frame, term.weight(), effect)
        };
        let of_echoes: Vec<_> = echoes.par_iter().zip(seen).zip(terms).map(of_echo).collect();
        let of_frame = |range: &[usize]| order[range[0]..range[1]].iter().map(|&i| i as usize);
        let prior = DMat3::from_diagonal(DVec3::splat((wall.noise_mm / told.shift_mm).powi(2)));
        let information = |range: &[usize]| {
            of_frame(range).fold(prior, |sum, i| {
                let (_, weight, effect) = of_echoes[i];
                sum + DMat3::from_cols(effect * effect.x, effect * effect.y, effect * effect.z) * weight
            })
        };
        let place = |range: &[usize]| {
            of_frame(range).map(|i| echoes[i].ring).sum::<f64>() / (range[1] - range[0]).max(1) as f64
        };
        Self {
            inverses: starts.par_windows(2).map(|range| information(range).inverse()).collect(),
            places: starts.par_windows(2).map(place).collect(),
            rings: grid.rings,
            weights: gaussian(told.about_mm / grid.step_mm, grid.rings),
            order,
            starts,
            echoes: of_echoes,
        }
    }

    /// The shift of each frame that residuals of the echoes show, less the mean of those about it, mm.
    pub(super) fn shifts_mm(&self, residuals_mm: &[f64]) -> Vec<DVec3> {
        let of_frame = |(range, inverse): (&[usize], &DMat3)| {
            *inverse
                * self.order[range[0]..range[1]].iter().fold(DVec3::ZERO, |sum, &i| {
                    let (_, weight, effect) = self.echoes[i as usize];
                    sum + effect * (weight * residuals_mm[i as usize])
                })
        };
        let mut shifts: Vec<DVec3> = self.starts.par_windows(2).zip(&self.inverses).map(of_frame).collect();
        // Sums over the frames, on the two rings beside each, and about every ring: the work grows with the frames, not with
        // their pairs.
        let mut sums = [0; 4].map(|_| vec![0.0; self.rings]);
        for (shift, &place) in shifts.iter().zip(&self.places) {
            for (ring, share) in self.beside(place) {
                let parts = [shift.x, shift.y, shift.z, 1.0];
                sums.iter_mut().zip(parts).for_each(|(sums, part)| sums[ring] += share * part);
            }
        }
        let [x, y, z, count] = sums.map(|sums| smoothed_along(&self.weights, &sums));
        for (shift, &place) in shifts.iter_mut().zip(&self.places) {
            let at =
                |of: &[f64]| self.beside(place).map(|(ring, share)| share * of[ring]).iter().sum::<f64>();
            *shift -= DVec3::new(at(&x), at(&y), at(&z)) / at(&count);
        }
        shifts
    }

    /// The rings beside a place, and their shares of it.
    fn beside(&self, place: f64) -> [(usize, f64); 2] {
        let below = (place.max(0.0) as usize).min(self.rings - 2);
        let up = (place - below as f64).clamp(0.0, 1.0);
        [(below, 1.0 - up), (below + 1, up)]
    }

    /// Errors of the echoes without the shifts that the residuals from the wall through them show.
    pub(super) fn without_shifts(&self, smoother: &Smoother, errors_mm: &[f64], wall_mm: &[f64]) -> Vec<f64> {
        let residuals_mm: Vec<f64> = smoother.residuals(errors_mm, wall_mm).collect();
        let shifts = self.shifts_mm(&residuals_mm);
        let left = |(error, (frame, _, effect)): (&f64, &(u32, f64, DVec3))| {
            error - effect.dot(shifts[*frame as usize])
        };
        errors_mm.iter().zip(&self.echoes).map(left).collect()
    }

    /// What the rays' own noise makes of the place of a frame, mm along each axis across the vessel: the median.
    fn of_rays_mm(&self, rays_mm: f64) -> f64 {
        let of_frame = |range: &[usize]| {
            let weights = self.order[range[0]..range[1]].iter().map(|&i| {
                let (_, weight, effect) = self.echoes[i as usize];
                weight * effect.length_squared()
            });
            rays_mm * (2.0 / weights.sum::<f64>()).sqrt()
        };
        median(&mut self.starts.windows(2).map(of_frame).collect::<Vec<_>>())
    }
}

/// What the shifts of single frames are estimated from.
pub(super) struct Told {
    /// The errors without those that move the vessel.
    descriptions: Vec<Levels>,
    /// Standard deviation of the shifts along each axis, mm.
    shift_mm: f64,
    /// That of the errors that every echo has for itself, mm.
    rays_mm: f64,
    /// Standard deviation of the weights of the frames about a frame, mm.
    about_mm: f64,
}

impl Told {
    /// `None` where no frame is shifted, or none of the errors is the rays' own.
    pub(super) fn of(descriptions: &[Levels], interval_s: f64, reach_mm: f64) -> Option<Self> {
        let of_frames = |process: Process| match process {
            Process::Beat { order, frequency_hz } => {
                order > 0 && frequency_hz * MAX_BEAT_FRAMES * interval_s >= 1.0
            }
            _ => true,
        };
        let told =
            |levels: &Levels| levels.iter().filter(|(process, _)| of_frames(*process)).copied().collect();
        let descriptions: Vec<Levels> = descriptions.iter().map(told).collect();
        let sd_mm = |of: fn(&Process) -> bool| {
            let levels = descriptions.iter().flatten().filter(|(process, _)| of(process));
            (levels.map(|(_, variance_mm2)| variance_mm2).sum::<f64>() / descriptions.len() as f64).sqrt()
        };
        let shift_mm = sd_mm(|process| matches!(process, Process::Shift { .. } | Process::Beat { .. }));
        let rays_mm = sd_mm(|process| matches!(process, Process::Ray));
        let about_mm = ABOUT_REACHES * reach_mm;
        (shift_mm > 0.0 && rays_mm > 0.0).then_some(Self { descriptions, shift_mm, rays_mm, about_mm })
    }

    /// Whether the wall gains by taking the shifts off: they outweigh the rays' noise by far, or draws of the errors say so.
    pub(super) fn pays(
        &self,
        estimator: &ShiftEstimator,
        recording: &Recorded,
        smoother: &Smoother,
    ) -> Result<bool> {
        let ray_sds = self.shift_mm / estimator.of_rays_mm(self.rays_mm);
        if ray_sds.is_nan() || ray_sds < MIN_RAY_SDS {
            return Ok(false);
        }
        if ray_sds > CLEAR_RAY_SDS {
            return Ok(true);
        }
        let variances: Vec<[f64; 2]> = (0..ROUGHNESS_DRAWS)
            .into_par_iter()
            .map(|draw| {
                let errors_mm = recording.drawn(&self.descriptions[draw % self.descriptions.len()], draw);
                let wall_mm = smoother.wall(errors_mm.iter().copied())?;
                let left_mm = estimator.without_shifts(smoother, &errors_mm, &wall_mm);
                let after_mm = smoother.wall(left_mm)?;
                Ok([wall_mm, after_mm].map(|of_nodes| {
                    let supported = of_nodes.iter().zip(recording.supported).filter(|(_, s)| **s);
                    supported.map(|(x, _)| x * x).sum()
                }))
            })
            .collect::<Result<_>>()?;
        let [before, after] = variances.iter().fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
        Ok(after < MAX_VARIANCE_LEFT * before)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 frames of 16 echoes along a tube of 20 rings, two frames at each place.
    fn estimator() -> ShiftEstimator {
        let effect = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i % 16) / 16.0).sin_cos();
            DVec3::new(cos, sin, 0.0)
        };
        let information = DMat3::from_diagonal(DVec3::new(8.0, 8.0, 0.0) + DVec3::splat(0.5));
        ShiftEstimator {
            order: (0..640).collect(),
            starts: (0..=40).map(|k| 16 * k).collect(),
            echoes: (0..640).map(|i| (i / 16, 1.0, effect(i))).collect(),
            inverses: vec![information.inverse(); 40],
            places: (0..40).map(|k| f64::from(k / 2)).collect(),
            rings: 20,
            weights: gaussian(3.0, 20),
        }
    }

    #[test]
    fn a_frame_is_shifted_against_those_about_it() {
        let estimator = estimator();
        let residuals = |of: &dyn Fn(u32) -> DVec3| -> Vec<f64> {
            estimator.echoes.iter().map(|(frame, _, effect)| effect.dot(of(*frame))).collect()
        };
        // What all frames share is the vessel's, and so is nearly all that changes slowly along it.
        let common = estimator.shifts_mm(&residuals(&|_| DVec3::new(1.0, -2.0, 0.0)));
        assert!(common.iter().all(|shift| shift.length() < 1e-12));
        let slow = estimator.shifts_mm(&residuals(&|k| DVec3::X * (0.05 * f64::from(k)).sin()));
        assert!(slow[18..22].iter().all(|shift| shift.length() < 0.05), "{slow:?}");
        // 8 echoes' worth of information against half a one of the prior.
        let alternating = |k: u32| DVec3::new(1.0, 0.5, 0.0) * if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let found = estimator.shifts_mm(&residuals(&alternating));
        for (k, shift) in (0..).zip(&found) {
            assert!(shift.distance(alternating(k) * 8.0 / 8.5) < 1e-12, "{k}: {shift}");
        }
    }

    #[test]
    fn slow_beats_and_rays_alone_shift_no_frames() {
        let beat = |frequency_hz| (Process::Beat { order: 1, frequency_hz }, 0.04);
        let (ray, white) = ((Process::Ray, 1.0), (Process::Shift { correlation_s: 0.0 }, 0.09));
        let shift_mm = |levels: Levels| Told::of(&[levels], 0.1, 2.0).map(|told| told.shift_mm);
        // At ten frames per second, a beat of 1 Hz moves a vessel, one of 3 Hz shakes the catheter.
        assert_eq!(shift_mm(vec![ray, beat(1.0)]), None);
        assert_eq!(shift_mm(vec![ray]), None);
        assert_eq!(shift_mm(vec![white]), None);
        assert!((shift_mm(vec![ray, white, beat(1.0)]).unwrap() - 0.3).abs() < 1e-12);
        assert!((shift_mm(vec![ray, white, beat(3.0)]).unwrap() - 0.13_f64.sqrt()).abs() < 1e-12);
    }
}
