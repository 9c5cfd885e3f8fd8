//! The local tube as a robust fit to the wall points of a window of frames.

use super::CylinderEstimator;
use super::follow::{Follower, FrameWall, TubeFit};
use super::local_tube::{Change, LocalTube, PARAMETERS};
use crate::geometry::Pose;
use crate::numerics::cholesky::{Matrix, cholesky, dot, forward, solve};
use crate::numerics::robust::{robust_sd, tukey_weight};
use crate::recording::{CylinderModel, Frame};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A cylinder from a robust fit to the wall points of nearby frames; see `docs/method.md`, "Local cylinder estimate".
///
/// The wall points within [`WINDOW_RADII`](Self::WINDOW_RADII) along the vessel, whenever they were seen, are fitted by a
/// tube that bends, tapers and may be slightly out of round; the cylinder is tangent to its axis beside the probe. Each
/// frame takes one Gauss-Newton step with Tukey's weights from the last estimate.
///
/// One frame takes bounded time: at most [`MAX_FRAMES`](Self::MAX_FRAMES) frames are kept, those whose image
/// planes lie farthest from each other.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct WindowFit(Follower<Window>);

impl WindowFit {
    /// Half the length of the window, in radii of the vessel. Weights decrease to 0 there.
    pub const WINDOW_RADII: f64 = 1.5;
    /// Smallest half length of the window, mm: in small vessels the tracker's noise is larger than the window in radii.
    pub const MIN_WINDOW_MM: f64 = 6.0;
    /// Largest number of frames that are kept.
    pub const MAX_FRAMES: usize = 128;

    /// An estimate without any frames. `sensor_from_probe` is the calibration `eTi` (thesis, Eq. 11).
    pub fn new(sensor_from_probe: Pose) -> Self {
        Self(Follower::new(sensor_from_probe))
    }

    /// Whether it can go on after it was read from a file.
    pub(in crate::cylinders) fn is_sound(&self) -> bool {
        self.0.fits().all(|window| {
            window.walls.iter().all(FrameWall::is_sound)
                && window.walls.len() <= Self::MAX_FRAMES
                && window.tube.is_sound()
                && 0.0 < window.noise_mm
                && window.noise_mm.is_finite()
                && 0.0 <= window.tangential_mm2
                && window.tangential_mm2.is_finite()
        })
    }
}

impl Default for WindowFit {
    /// With the identity as calibration.
    fn default() -> Self {
        Self::new(Pose::IDENTITY)
    }
}

impl CylinderEstimator for WindowFit {
    /// `None` also where the pose is not finite, or the axis is parallel to the plane z = 0 of `{e}`, which a
    /// [`CylinderModel`] cannot express.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        self.0.push(frame)
    }
}

/// Prior standard deviations of the parameters of [`Change`] about 0, lengths in radii. After a few frames the data
/// outweigh them; they determine what one or two frames cannot.
const SLOPE_SD: f64 = 0.15;
const BEND_SD: f64 = 0.25;
const TAPER_SD: f64 = 0.15;
const OVAL_SD: f64 = 0.1;
const LOBES_SD: f64 = 0.02;

/// Standard deviation of the error that all points of a frame share, mm: that of a typical tracker.
const POSE_SD_MM: f64 = 0.3;
/// Standard deviation of a section's own oval, in radii. A tilted section is an ellipse, but so are many vessels: without
/// this term, real vessels, which are never quite round, tilt the tube by 10 degrees and more.
const SECTION_SD: f64 = 0.1;

/// Tukey's constant: 95 % efficient where errors are normal.
const TUKEY_SDS: f64 = 4.0;
/// Points nearer to the wall than this, in radii, are never outliers, even where the noise is small; the second value
/// applies to the first frame.
const NEAR: f64 = 0.05;
const NEAR_AT_FIRST: f64 = 0.3;

/// Smallest noise, in radii: the residual of any real wall from a smooth tube.
const MIN_NOISE: f64 = 0.02;

/// While the window has fewer frames than this, the fit takes several steps per frame.
const FIRST_FRAMES: usize = 10;
const FIRST_STEPS: usize = 5;

/// The frames of the window and the tube through them.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Window {
    /// In the order of arrival.
    walls: VecDeque<FrameWall>,
    tube: LocalTube,
    noise_mm: f64,
    tangential_mm2: f64,
}

impl TubeFit for Window {
    fn start(wall: &FrameWall) -> Self {
        Self {
            walls: VecDeque::new(),
            tube: wall.tube(),
            noise_mm: wall.scatter_mm.clamp(MIN_NOISE * wall.radius_mm, 0.3 * wall.radius_mm),
            tangential_mm2: 0.0,
        }
    }

    fn tube(&self) -> &LocalTube {
        &self.tube
    }

    fn tangential_mm2(&self) -> f64 {
        self.tangential_mm2
    }

    fn add(&mut self, wall: FrameWall) -> Option<()> {
        let newest = wall.clone();
        let beside = |tube: LocalTube| Some(newest.beside(&tube).0).filter(LocalTube::is_sound);
        self.tube = beside(self.tube)?;
        let near = if self.walls.is_empty() { NEAR_AT_FIRST } else { NEAR };
        self.remember(wall);
        let steps = if self.walls.len() < FIRST_FRAMES { FIRST_STEPS } else { 1 };
        for _ in 0..steps {
            let change = self.step(near)?;
            let changed = self.tube.changed(&change);
            self.tube = Some(changed).filter(LocalTube::is_sound).and_then(beside)?;
        }
        Some(())
    }
}

impl Window {
    fn half_length_mm(&self) -> f64 {
        (WindowFit::WINDOW_RADII * self.tube.radius_mm).max(WindowFit::MIN_WINDOW_MM)
    }

    /// Keeps a frame and drops frames out of reach. Beyond the largest number it drops those that add least: whose
    /// neighbours in time, on either side, are nearest to each other.
    fn remember(&mut self, wall: FrameWall) {
        // A tilted frame reaches into the window from outside.
        let reach = self.half_length_mm() + self.tube.radius_mm;
        let to_axis = self.tube.world_from_axis.inverse();
        self.walls.retain(|wall| to_axis.transform_point(wall.centre_mm).length() <= reach);
        self.walls.push_back(wall);
        while self.walls.len() > WindowFit::MAX_FRAMES {
            let apart = |a: &FrameWall, b: &FrameWall| {
                let turned = a.world_from_probe.rotation.z_axis.distance(b.world_from_probe.rotation.z_axis);
                a.centre_mm.distance(b.centre_mm) + self.tube.radius_mm * turned
            };
            let neighbours = self.walls.iter().zip(self.walls.iter().skip(2));
            let gaps = neighbours.map(|(a, b)| apart(a, b)).enumerate();
            let least = gaps.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(before, _)| before + 1);
            self.walls.remove(least);
        }
    }

    /// A Gauss-Newton step towards the maximum a posteriori; also updates the noise.
    fn step(&mut self, near: f64) -> Option<Change> {
        let tube = &self.tube;
        let to_axis = tube.world_from_axis.inverse();
        let half_length = self.half_length_mm();
        let gate = (TUKEY_SDS * self.noise_mm).max(near * tube.radius_mm);
        let precision = 1.0 / (self.noise_mm * self.noise_mm);
        let mut normal: Matrix<PARAMETERS> = [[0.0; PARAMETERS]; PARAMETERS];
        let mut right: Change = [0.0; PARAMETERS];
        let mut sizes = Vec::new();
        let (mut direction, mut tangential, mut total) = (DVec3::ZERO, 0.0, 0.0);
        for wall in &self.walls {
            let image_normal = to_axis.rotation * wall.world_from_probe.rotation.z_axis;
            let mut shared = Shared::new(tube.radius_mm);
            for &p in &wall.points_mm {
                let p = to_axis.transform_point(p);
                let residual = tube.residual_of(p, image_normal, 3.0 * self.noise_mm);
                let along = residual.s_mm / half_length;
                if along.abs() >= 1.0 {
                    continue;
                }
                let size = residual.residual_mm().abs();
                sizes.push(size);
                if size >= gate {
                    continue;
                }
                let weight = tukey_weight(along) * tukey_weight(size / gate) * precision / residual.variance;
                for i in 0..PARAMETERS {
                    let g = weight * residual.gain[i];
                    for (sum, other) in normal[i][..=i].iter_mut().zip(&residual.gain) {
                        *sum += g * other;
                    }
                    right[i] += g * residual.distance_mm;
                }
                shared.add(weight, &residual.gain, residual.distance_mm);
            }
            shared.eliminate(&mut normal, &mut right)?;
            direction += image_normal * shared.weight;
            tangential += wall.tangential_mm2 * shared.weight;
            total += shared.weight;
        }
        // The catheter lies roughly along the vessel.
        let lean = direction / direction.z;
        let r = tube.radius_mm;
        let priors = [
            (2, lean.x, SLOPE_SD),
            (3, lean.y, SLOPE_SD),
            (4, -tube.bend_per_mm.x, BEND_SD / r),
            (5, -tube.bend_per_mm.y, BEND_SD / r),
            (7, -tube.taper, TAPER_SD),
            (8, -tube.oval_mm.x, OVAL_SD * r),
            (9, -tube.oval_mm.y, OVAL_SD * r),
            (10, -tube.lobes_mm.x, LOBES_SD * r),
            (11, -tube.lobes_mm.y, LOBES_SD * r),
        ];
        for (i, expected, sd) in priors {
            normal[i][i] += 1.0 / (sd * sd);
            right[i] += expected / (sd * sd);
        }
        let root = cholesky(&normal)?;
        self.noise_mm = robust_sd(&mut sizes).max(MIN_NOISE * r);
        // At most what isotropic noise can have: contours drawn by hand have points at uneven angles. The points used are
        // medians of a few, which scatter less along the rays than across.
        self.tangential_mm2 = (tangential / total).min(2.25 * self.noise_mm * self.noise_mm);
        Some(solve(&root, right))
    }
}

/// Errors that the points of one frame share: a shift across the axis (2) and an oval (2).
const SHARED: usize = 4;
/// The parameters with the same effect.
const ACTS_LIKE: [usize; SHARED] = [0, 1, 8, 9];

/// The normal equations of the errors that the points of one frame share.
struct Shared {
    weight: f64,
    normal: Matrix<SHARED>,
    right: [f64; SHARED],
    with: [[f64; SHARED]; PARAMETERS],
}

impl Shared {
    fn new(radius_mm: f64) -> Self {
        let mut normal = [[0.0; SHARED]; SHARED];
        for (i, sd) in
            [POSE_SD_MM, POSE_SD_MM, SECTION_SD * radius_mm, SECTION_SD * radius_mm].iter().enumerate()
        {
            normal[i][i] = 1.0 / (sd * sd);
        }
        Self { weight: 0.0, normal, right: [0.0; SHARED], with: [[0.0; SHARED]; PARAMETERS] }
    }

    fn add(&mut self, weight: f64, gain: &Change, distance_mm: f64) {
        let own = ACTS_LIKE.map(|i| gain[i]);
        self.weight += weight;
        for i in 0..SHARED {
            let g = weight * own[i];
            for (sum, other) in self.normal[i][..=i].iter_mut().zip(&own) {
                *sum += g * other;
            }
            self.right[i] += g * distance_mm;
        }
        for (sums, g) in self.with.iter_mut().zip(gain) {
            let g = weight * g;
            for (sum, own) in sums.iter_mut().zip(&own) {
                *sum += g * own;
            }
        }
    }

    /// Eliminates the shared errors from the normal equations of the tube (Schur complement).
    fn eliminate(&self, normal: &mut Matrix<PARAMETERS>, right: &mut Change) -> Option<()> {
        let root = cholesky(&self.normal)?;
        let own = forward(&root, self.right);
        let with = self.with.map(|with| forward(&root, with));
        for i in 0..PARAMETERS {
            for (sum, other) in normal[i][..=i].iter_mut().zip(&with) {
                *sum -= dot(&with[i], other);
            }
            right[i] -= dot(&with[i], &own);
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec2};
    use std::f64::consts::TAU;

    /// A cylinder of radius 10 about z, seen from its axis by a probe that leans as it turns.
    fn frame(z: f64, turn: f64) -> Frame {
        let rotation = DMat3::from_rotation_z(turn) * DMat3::from_rotation_x(0.3);
        let point = |j: i32| {
            let ray = DVec2::from_angle(f64::from(j) / 60.0 * TAU);
            ray * (10.0 / (rotation * ray.extend(0.0)).truncate().length())
        };
        let pose = Pose { rotation, translation_mm: DVec3::new(0.0, 0.0, z) };
        Frame::new(pose, (0..60).map(point).collect())
    }

    #[test]
    fn a_catheter_at_rest_keeps_a_bounded_memory_and_what_it_saw_on_the_way() {
        let mut estimate = WindowFit::default();
        for k in 0..1000 {
            estimate.push(&frame(f64::from(k).min(50.0) * 0.2, 0.0)).unwrap();
        }
        let walls = &estimate.0.known().unwrap().walls;
        assert_eq!(walls.len(), WindowFit::MAX_FRAMES);
        let moving = walls.iter().filter(|wall| wall.centre_mm.z < 9.9).count();
        assert!(moving >= 45, "{moving} of 50");
    }

    #[test]
    fn a_turning_tip_is_remembered_all_round() {
        let mut estimate = WindowFit::default();
        for k in 0..1000 {
            estimate.push(&frame(0.0, f64::from(k) / 1000.0 * TAU)).unwrap();
        }
        let walls = &estimate.0.known().unwrap().walls;
        let sum: DVec3 = walls.iter().map(|wall| wall.world_from_probe.rotation.z_axis).sum();
        let mean = sum / walls.len() as f64;
        assert!(mean.truncate().length() < 0.02, "{mean}");
    }
}
