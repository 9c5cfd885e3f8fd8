//! The local tube as the state of an unscented Kalman filter.

use super::CylinderEstimator;
use super::follow::{Follower, FrameWall, TubeFit};
use super::local_tube::{Change, LocalTube, PARAMETERS};
use crate::geometry::Pose;
use crate::numerics::cholesky::{Matrix, cholesky, dot, forward, solve};
use crate::numerics::robust::{huber_weight, robust_sd, tukey_weight};
use crate::recording::{CylinderModel, Frame};
use glam::DVec3;

/// A cylinder from an unscented Kalman filter that runs along the vessel, after Farola Barata et al., *IEEE Robotics
/// and Automation Letters* 2021; see `docs/method.md`, "Local cylinder estimate".
///
/// The state is the tube that [`WindowFit`](super::WindowFit) fits, in the world. It drifts with every millimetre that
/// the probe advances. The measurement consists of the distances of a frame's wall points from the tube, and a shift of
/// the whole frame is the tracker's part of their noise. One frame takes constant time and memory.
///
/// On nearly all simulated vessels [`WindowFit`](super::WindowFit) is more accurate, especially while the catheter turns
/// a bent tip: it reweights old frames, whereas the filter cannot revise them.
#[derive(Debug, Clone)]
pub struct UnscentedFilter(Follower<Filter>);

impl UnscentedFilter {
    /// A filter without any frames. `sensor_from_probe` is the calibration `eTi` (thesis, Eq. 11).
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
    /// `None` also where the pose is not finite, or the axis is parallel to the plane z = 0 of `{e}`, which a
    /// [`CylinderModel`] cannot express.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        self.0.push(frame)
    }
}

/// Standard deviations of the initial state, in the order of [`Change`], lengths in radii.
const FIRST_SD: Change = [0.02, 0.02, 0.15, 0.15, 0.15, 0.15, 0.1, 0.03, 0.1, 0.1, 0.03, 0.03];
/// Standard deviations of the random walk over a path of one radius, lengths in radii.
const DRIFT_SD: Change = [0.003, 0.003, 0.01, 0.01, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0];
/// Correlation lengths, in radii: over them bend, taper, oval and lobes return to [`FIRST_SD`] about 0. The other
/// parameters do not.
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
/// The power of length in the unit of each parameter of [`Change`].
const RADIUS_POWERS: [i32; PARAMETERS] = [1, 1, 0, 0, -1, -1, 1, 0, 1, 1, 1, 1];

/// Noise of the tracked position: a probe that moves no farther than this counts as still, mm.
const SLACK_MM: f64 = 1.0;
/// Standard deviation of the error that all points of a frame share, mm.
const POSE_SD_MM: f64 = 0.3;
/// Standard deviation of a section's own oval, in radii; see `WindowFit`.
const SECTION_SD: f64 = 0.1;
/// Points farther from the wall than this, in radii, are outliers in the first round.
const GATE_RADII: f64 = 0.25;
/// Tukey's constant; points nearer to the wall than the second value, in radii, are never outliers.
const TUKEY_SDS: f64 = 4.0;
const NEAR_RADII: f64 = 0.05;
/// Smallest noise, in radii.
const MIN_NOISE: f64 = 0.02;
/// Weight of a new frame in the running estimate of the noise.
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
    /// How far the probe is ahead of the modelled drift, mm: at most the slack.
    ahead_mm: f64,
}

impl TubeFit for Filter {
    fn start(wall: &FrameWall) -> Self {
        let mut covariance = [[0.0; PARAMETERS]; PARAMETERS];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = variance(&FIRST_SD, i, wall.radius_mm);
        }
        Self {
            tube: wall.tube(),
            covariance,
            noise_mm: wall.scatter_mm.clamp(MIN_NOISE * wall.radius_mm, 0.3 * wall.radius_mm),
            tangential_mm2: wall.tangential_mm2,
            ahead_mm: 0.0,
        }
    }

    fn tube(&self) -> &LocalTube {
        &self.tube
    }

    fn tangential_mm2(&self) -> f64 {
        // At most what isotropic noise can have; see `WindowFit`.
        self.tangential_mm2.min(2.25 * self.noise_mm * self.noise_mm)
    }

    fn add(&mut self, wall: FrameWall) -> Option<()> {
        let s = wall.beside(&self.tube).1;
        self.predict(s);
        self.tangential_mm2 += NOISE_RATE * (wall.tangential_mm2 - self.tangential_mm2);
        self.tube.is_sound().then_some(())?;
        self.correct(&wall)?;
        self.tube.is_sound().then_some(())
    }
}

fn variance(sd: &Change, i: usize, radius_mm: f64) -> f64 {
    (sd[i] * radius_mm.powi(RADIUS_POWERS[i])).powi(2)
}

impl Filter {
    /// Predicts the state `s` mm farther along the axis.
    fn predict(&mut self, s: f64) {
        let radius = self.tube.radius_mm;
        self.ahead_mm += s;
        let travelled = (self.ahead_mm.abs() - SLACK_MM).max(0.0);
        self.ahead_mm -= travelled.copysign(self.ahead_mm);
        let radii = travelled / radius;
        let keep: Change = MEMORY_RADII.map(|memory| (-radii / memory).exp());
        for (i, row) in self.covariance.iter_mut().enumerate() {
            for (j, c) in row.iter_mut().enumerate() {
                *c *= keep[i] * keep[j];
            }
            row[i] += variance(&DRIFT_SD, i, radius) * radii
                + variance(&FIRST_SD, i, radius) * (1.0 - keep[i] * keep[i]);
        }
        self.tube.bend_per_mm *= keep[4];
        self.tube.taper *= keep[7];
        self.tube.oval_mm *= keep[8];
        self.tube.lobes_mm *= keep[10];

        // The origin moves along the axis: centre and slope change with slope and bend, the radius with the taper.
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

    /// Updates the state with a frame. The states are whitened by a root of their covariance, so that sigma points are
    /// steps along its columns and the prior is the identity.
    fn correct(&mut self, wall: &FrameWall) -> Option<()> {
        let mut prior = [[0.0; STATES]; STATES];
        for (row, of) in prior.iter_mut().zip(&self.covariance) {
            row[..PARAMETERS].copy_from_slice(of);
        }
        let section_mm = SECTION_SD * self.tube.radius_mm;
        for (i, sd) in [POSE_SD_MM, POSE_SD_MM, section_mm, section_mm].into_iter().enumerate() {
            prior[PARAMETERS + i][PARAMETERS + i] = sd * sd;
        }
        let root = cholesky(&prior)?;
        let middle = self.residuals(wall, &[0.0; STATES]);
        let mut mean = middle.clone();
        let mut slopes = vec![[0.0; STATES]; middle.len()];
        let mut curved = vec![0.0; middle.len()];
        for column in 0..STATES {
            let step: [f64; STATES] = std::array::from_fn(|i| SPREAD * root[i][column]);
            let (plus, minus) = (self.residuals(wall, &step), self.residuals(wall, &step.map(|x| -x)));
            for i in 0..middle.len() {
                slopes[i][column] = (plus[i] - minus[i]) / (2.0 * SPREAD);
                let bow = (plus[i] + minus[i] - 2.0 * middle[i]) / (2.0 * SPREAD);
                mean[i] += bow / SPREAD;
                curved[i] += bow * bow;
            }
        }
        // The variance that curvature adds is common to all points: averaging over them must not reduce it.
        curved.iter_mut().for_each(|c| *c *= middle.len() as f64);

        let noise = self.noise_mm;
        let radius = self.tube.radius_mm;
        let far = (6.0 * noise).max(GATE_RADII * radius);
        let near = (TUKEY_SDS * noise).max(NEAR_RADII * radius);
        let mut residual = mean.clone();
        let (mut factor, mut solution) = (root, [0.0; STATES]);
        for round in 0..ROUNDS {
            // Tukey's weights need residuals that are roughly right.
            let weight_of = |size: f64| match round {
                0 if size < far => huber_weight(noise, size),
                1.. if size < near => tukey_weight(size / near),
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
            solution = solve(&factor, right);
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
        let noise = robust_sd(&mut residual).max(MIN_NOISE * self.tube.radius_mm);
        self.noise_mm += NOISE_RATE * (noise - self.noise_mm);
        Some(())
    }

    /// The standardised residuals of a frame's points from the tube after a step, mm ([`TubeResidual::residual_mm`]).
    ///
    /// [`TubeResidual::residual_mm`]: super::local_tube::TubeResidual::residual_mm
    fn residuals(&self, wall: &FrameWall, step: &[f64; STATES]) -> Vec<f64> {
        let mut change: Change = std::array::from_fn(|i| step[i]);
        let [shift_x, shift_y, oval_x, oval_y]: [f64; 4] = std::array::from_fn(|i| step[PARAMETERS + i]);
        change[8] += oval_x;
        change[9] += oval_y;
        let shift = DVec3::new(shift_x, shift_y, 0.0);
        let shift = self.tube.world_from_axis.rotation * shift;
        let tube = self.tube.changed(&change);
        let to_axis = tube.world_from_axis.inverse();
        let image_normal = to_axis.rotation * wall.world_from_probe.rotation.z_axis;
        let residual = |&p: &DVec3| {
            tube.residual_of(to_axis.transform_point(p - shift), image_normal, 0.0).residual_mm()
        };
        wall.points_mm.iter().map(residual).collect()
    }
}
