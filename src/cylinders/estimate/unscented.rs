//! The local tube as the state of an unscented Kalman filter.

use super::CylinderEstimator;
use super::follow::{Follower, Ring, TubeFit, robust_sd};
use super::local_tube::{Change, LocalTube, PARAMETERS};
use crate::geometry::Pose;
use crate::numerics::cholesky::{Matrix, backward, cholesky, dot, forward};
use crate::recording::{CylinderModel, Frame};
use glam::DVec3;

/// A cylinder from an unscented Kalman filter that runs along the vessel, after Farola Barata et al., *IEEE Robotics
/// and Automation Letters* 2021; see `docs/method.md`, "Local cylinder estimate".
///
/// The state is the tube that [`WindowFit`](super::WindowFit) fits, in the world. It drifts with every millimetre that
/// the probe moves on; the distances of a frame's wall points from the tube are the measurement, and a shift of
/// the whole frame is the tracker's part of their noise. One frame takes constant time and memory.
///
/// On nearly all simulated vessels [`WindowFit`](super::WindowFit) is more accurate, most of all while the catheter turns
/// a bent tip: it weighs old frames anew where the filter trusts what it once made of them.
#[derive(Debug, Clone)]
pub struct UnscentedFilter(Follower<Filter>);

impl UnscentedFilter {
    /// A filter that has seen nothing yet. `sensor_from_probe` is the calibration `eTi` (thesis, Eq. 11).
    pub fn new(sensor_from_probe: Pose) -> Self {
        Self(Follower::new(sensor_from_probe))
    }
}

impl Default for UnscentedFilter {
    /// With the identity as calibration.
    fn default() -> Self {
        Self::new(Pose::IDENTITY)
    }
}

impl CylinderEstimator for UnscentedFilter {
    /// `None` also where the pose is not finite, or the axis runs along the plane z = 0 of `{e}`, which a
    /// [`CylinderModel`] cannot express.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        self.0.push(frame)
    }
}

/// Standard deviations of the first state, in the order of [`Change`], lengths in radii.
const FIRST_SD: Change = [0.02, 0.02, 0.15, 0.15, 0.15, 0.15, 0.1, 0.03, 0.1, 0.1, 0.03, 0.03];
/// Random walk over a way of one radius, lengths in radii.
const DRIFT_SD: Change = [0.003, 0.003, 0.01, 0.01, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0];
/// Ways, in radii, over which bend, taper, oval and lobes forget what they were and go back to [`FIRST_SD`] about 0; the
/// others do not.
const MEMORY_RADII: Change = [
    f64::INFINITY,
    f64::INFINITY,
    f64::INFINITY,
    f64::INFINITY,
    3.0,
    3.0,
    f64::INFINITY,
    2.0,
    5.0,
    5.0,
    5.0,
    5.0,
];
/// Lengths in the units of [`Change`]: what one radius is in each of them, as a power.
const RADIUS_POWERS: [i32; PARAMETERS] = [1, 1, 0, 0, -1, -1, 1, 0, 1, 1, 1, 1];

/// Noise of the tracked position: a probe that moves no farther than this has not moved, mm.
const SLACK_MM: f64 = 1.0;
/// Standard deviation of the error that all points of a frame share, mm.
const POSE_SD_MM: f64 = 0.3;
/// Standard deviation of a section's own oval, in radii; see `WindowFit`.
const SECTION_SD: f64 = 0.1;
/// Huber's constant, and the gate in radii beyond which a point is no wall.
const HUBER_SDS: f64 = 1.345;
const GATE_RADII: f64 = 0.25;
/// Tukey's constant; points nearer than this, in radii, are never outliers.
const TUKEY_SDS: f64 = 4.0;
const NEAR_RADII: f64 = 0.05;
const LEAST_NOISE: f64 = 0.02;
/// Share of a frame in the running estimate of the noise.
const NOISE_RATE: f64 = 0.1;
/// Rounds of reweighting.
const ROUNDS: usize = 3;

/// The tube's parameters, a shift of the frame across it, and an oval of the frame's own.
const STATES: usize = PARAMETERS + 4;
/// Sigma points lie this many standard deviations out (√3: the kurtosis of a normal distribution).
const SPREAD: f64 = 1.732_050_807_568_877_2;

#[derive(Debug, Clone)]
struct Filter {
    tube: LocalTube,
    covariance: Matrix<PARAMETERS>,
    noise_mm: f64,
    tangential_mm2: f64,
    /// How far the probe has run ahead of the drift, mm: at most the slack.
    ahead_mm: f64,
}

impl TubeFit for Filter {
    fn start(ring: &Ring) -> Self {
        let mut covariance = [[0.0; PARAMETERS]; PARAMETERS];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = variance(&FIRST_SD, i, ring.radius_mm);
        }
        Self {
            tube: ring.tube(),
            covariance,
            noise_mm: ring.scatter_mm.clamp(LEAST_NOISE * ring.radius_mm, 0.3 * ring.radius_mm),
            tangential_mm2: ring.tangential_mm2,
            ahead_mm: 0.0,
        }
    }

    fn tube(&self) -> &LocalTube {
        &self.tube
    }

    fn tangential_mm2(&self) -> f64 {
        // No more than noise all round can have; see `WindowFit`.
        self.tangential_mm2.min(2.25 * self.noise_mm * self.noise_mm)
    }

    fn add(&mut self, ring: Ring) -> Option<()> {
        let s = ring.beside(&self.tube).1;
        self.predict(s);
        self.tangential_mm2 += NOISE_RATE * (ring.tangential_mm2 - self.tangential_mm2);
        self.tube.is_sound().then_some(())?;
        self.correct(&ring)?;
        self.tube.is_sound().then_some(())
    }
}

fn variance(sd: &Change, i: usize, radius_mm: f64) -> f64 {
    (sd[i] * radius_mm.powi(RADIUS_POWERS[i])).powi(2)
}

impl Filter {
    /// Goes on by `s` mm along the axis.
    fn predict(&mut self, s: f64) {
        let radius = self.tube.radius_mm;
        self.ahead_mm += s;
        let travelled = (self.ahead_mm.abs() - SLACK_MM).max(0.0);
        self.ahead_mm -= travelled.copysign(self.ahead_mm);
        let way = travelled / radius;
        let keep: Change = MEMORY_RADII.map(|memory| (-way / memory).exp());
        for (i, row) in self.covariance.iter_mut().enumerate() {
            for (j, c) in row.iter_mut().enumerate() {
                *c *= keep[i] * keep[j];
            }
            row[i] += variance(&DRIFT_SD, i, radius) * way
                + variance(&FIRST_SD, i, radius) * (1.0 - keep[i] * keep[i]);
        }
        self.tube.bend_per_mm *= keep[4];
        self.tube.taper *= keep[7];
        self.tube.oval_mm *= keep[8];
        self.tube.lobes_mm *= keep[10];

        // The place moves along: centre and slope go on with slope and bend, the radius with the taper.
        let moves =
            [(0, 2, s), (1, 3, s), (0, 4, 0.5 * s * s), (1, 5, 0.5 * s * s), (2, 4, s), (3, 5, s), (6, 7, s)];
        let before = self.covariance;
        for (to, from, by) in moves {
            for (c, of) in self.covariance[to].iter_mut().zip(&before[from]) {
                *c += by * of;
            }
        }
        let half = self.covariance;
        for (to, from, by) in moves {
            for (row, of) in self.covariance.iter_mut().zip(&half) {
                row[to] += by * of[from];
            }
        }
        self.tube = self.tube.moved(s);
    }

    /// Takes in what a ring shows. The states are whitened by a root of their covariance, so that sigma points are
    /// steps along its columns and the prior is the identity.
    fn correct(&mut self, ring: &Ring) -> Option<()> {
        let mut prior = [[0.0; STATES]; STATES];
        for (row, of) in prior.iter_mut().zip(&self.covariance) {
            row[..PARAMETERS].copy_from_slice(of);
        }
        let section_mm = SECTION_SD * self.tube.radius_mm;
        for (i, sd) in [POSE_SD_MM, POSE_SD_MM, section_mm, section_mm].into_iter().enumerate() {
            prior[PARAMETERS + i][PARAMETERS + i] = sd * sd;
        }
        let root = cholesky(&prior)?;
        let middle = self.misses(ring, &[0.0; STATES]);
        let mut mean = middle.clone();
        let mut slopes = vec![[0.0; STATES]; middle.len()];
        let mut curved = vec![0.0; middle.len()];
        for column in 0..STATES {
            let step: [f64; STATES] = std::array::from_fn(|i| SPREAD * root[i][column]);
            let (plus, minus) = (self.misses(ring, &step), self.misses(ring, &step.map(|x| -x)));
            for i in 0..middle.len() {
                slopes[i][column] = (plus[i] - minus[i]) / (2.0 * SPREAD);
                let bow = (plus[i] + minus[i] - 2.0 * middle[i]) / (2.0 * SPREAD);
                mean[i] += bow / SPREAD;
                curved[i] += bow * bow;
            }
        }
        // What curvature adds to the variance is common to all points: as many of them make it no smaller.
        curved.iter_mut().for_each(|c| *c *= middle.len() as f64);

        let noise = self.noise_mm;
        let radius = self.tube.radius_mm;
        let far = (6.0 * noise).max(GATE_RADII * radius);
        let near = (TUKEY_SDS * noise).max(NEAR_RADII * radius);
        let mut residual = mean.clone();
        let (mut factor, mut solution) = (root, [0.0; STATES]);
        for round in 0..ROUNDS {
            // Tukey's weights need a residual that is about right.
            let weight_of = |size: f64| match round {
                0 if size < far => (HUBER_SDS * noise / size).min(1.0),
                1.. if size < near => (1.0 - (size / near).powi(2)).powi(2),
                _ => 0.0,
            };
            let mut normal = [[0.0; STATES]; STATES];
            let mut right = [0.0; STATES];
            for (i, row) in normal.iter_mut().enumerate() {
                row[i] = 1.0;
            }
            for (i, slope) in slopes.iter().enumerate() {
                let weight = weight_of(residual[i].abs()) / (noise * noise + curved[i]);
                for a in 0..STATES {
                    let g = weight * slope[a];
                    for (sum, other) in normal[a][..=a].iter_mut().zip(slope) {
                        *sum += g * other;
                    }
                    right[a] -= g * mean[i];
                }
            }
            factor = cholesky(&normal)?;
            solution = backward(&factor, forward(&factor, right));
            for (r, (m, slope)) in residual.iter_mut().zip(mean.iter().zip(&slopes)) {
                *r = m + dot(slope, &solution);
            }
        }
        let change: Change = std::array::from_fn(|i| dot(&root[i], &solution));
        let after: [[f64; STATES]; PARAMETERS] = std::array::from_fn(|i| forward(&factor, root[i]));
        for (row, a) in self.covariance.iter_mut().zip(&after) {
            for (c, b) in row.iter_mut().zip(&after) {
                *c = dot(a, b);
            }
        }
        self.tube = self.tube.changed(&change);
        residual.iter_mut().for_each(|r| *r = r.abs());
        let noise = robust_sd(&mut residual).max(LEAST_NOISE * self.tube.radius_mm);
        self.noise_mm += NOISE_RATE * (noise - self.noise_mm);
        Some(())
    }

    /// The distances of a ring's points from the tube after a step, in standard deviations of an echo.
    fn misses(&self, ring: &Ring, step: &[f64; STATES]) -> Vec<f64> {
        let mut change: Change = std::array::from_fn(|i| step[i]);
        let [shift_x, shift_y, oval_x, oval_y]: [f64; 4] = std::array::from_fn(|i| step[PARAMETERS + i]);
        change[8] += oval_x;
        change[9] += oval_y;
        let shift = DVec3::new(shift_x, shift_y, 0.0);
        let shift = self.tube.world_from_axis.rotation * shift;
        let tube = self.tube.changed(&change);
        let to_axis = tube.world_from_axis.inverse();
        let image_normal = to_axis.rotation * ring.world_from_probe.rotation.z_axis;
        let miss = |&p: &DVec3| {
            let held = tube.hold(to_axis.transform_point(p - shift), image_normal, 0.0);
            held.miss_mm / held.variance.sqrt()
        };
        ring.points_mm.iter().map(miss).collect()
    }
}
