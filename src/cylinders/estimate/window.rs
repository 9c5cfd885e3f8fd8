//! The local tube as a robust fit to all wall seen nearby.

use super::CylinderEstimator;
use super::follow::{Follower, Ring, TubeFit, robust_sd};
use super::local_tube::{Change, LocalTube, PARAMETERS};
use crate::geometry::Pose;
use crate::numerics::cholesky::{Matrix, backward, cholesky, dot, forward};
use crate::recording::{CylinderModel, Frame};
use glam::DVec3;
use std::collections::VecDeque;

/// A cylinder from a robust fit to the wall that the last frames showed nearby; see `docs/method.md`,
/// "Local cylinder estimate".
///
/// The wall points within [`WINDOW_RADII`](Self::WINDOW_RADII) along the vessel, seen on the way there or back, are
/// fitted by a tube that bends, tapers and may be a little out of round; the cylinder is what touches its axis beside
/// the probe. Gauss and Newton's step is taken once a frame from the last estimate, under Tukey's weights.
///
/// One frame takes bounded time: at most [`MOST_FRAMES`](Self::MOST_FRAMES) frames are kept, those whose image
/// planes lie farthest from each other.
#[derive(Debug, Clone)]
pub struct WindowFit(Follower<Window>);

impl WindowFit {
    /// Half the length of the window, in radii of the vessel. Weights fall to 0 there.
    pub const WINDOW_RADII: f64 = 1.5;
    /// Half the length of the window at least, mm: small vessels drown in the noise of the same tracker.
    pub const LEAST_WINDOW_MM: f64 = 6.0;
    /// Frames that are kept at most.
    pub const MOST_FRAMES: usize = 128;

    /// An estimate that has seen nothing yet. `sensor_from_probe` is the calibration `eTi` (thesis, Eq. 11).
    pub fn new(sensor_from_probe: Pose) -> Self {
        Self(Follower::new(sensor_from_probe))
    }
}

impl Default for WindowFit {
    /// With the identity as calibration.
    fn default() -> Self {
        Self::new(Pose::IDENTITY)
    }
}

impl CylinderEstimator for WindowFit {
    /// `None` also where the pose is not finite, or the axis runs along the plane z = 0 of `{e}`, which a
    /// [`CylinderModel`] cannot express.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        self.0.push(frame)
    }
}

/// What vessels are like: standard deviations, about 0, of the parameters of [`Change`], lengths in radii. The wall seen
/// soon outweighs them; they hold what one or two frames cannot tell.
const SLOPE_SD: f64 = 0.15;
const BEND_SD: f64 = 0.25;
const TAPER_SD: f64 = 0.15;
const OVAL_SD: f64 = 0.1;
const LOBES_SD: f64 = 0.02;

/// Standard deviation of the error that all points of a frame share, mm: that of a usual tracker.
const POSE_SD_MM: f64 = 0.3;
/// Standard deviation of a section's own oval, in radii. A tilted section is an ellipse, but so are many vessels: without
/// this, a real one that is never quite round tips the tube over by 10 degrees and more.
const SECTION_SD: f64 = 0.1;

/// Tukey's constant: 95 % efficient where errors are normal.
const TUKEY_SDS: f64 = 4.0;
/// Points this near are never outliers, in radii: a wall that is rough where noise is little; a first guess.
const NEAR: f64 = 0.05;
const NEAR_AT_FIRST: f64 = 0.3;

/// Noise is taken to be no less than this, in radii: what a smooth tube leaves of any wall.
const LEAST_NOISE: f64 = 0.02;

/// Frames during which the fit takes more steps than one.
const YOUNG: usize = 10;
const STEPS_WHILE_YOUNG: usize = 5;

/// The rings of the window and the tube through them.
#[derive(Debug, Clone)]
struct Window {
    /// In the order in which they came.
    rings: VecDeque<Ring>,
    tube: LocalTube,
    noise_mm: f64,
    tangential_mm2: f64,
}

impl TubeFit for Window {
    fn start(ring: &Ring) -> Self {
        Self {
            rings: VecDeque::new(),
            tube: ring.tube(),
            noise_mm: ring.scatter_mm.clamp(LEAST_NOISE * ring.radius_mm, 0.3 * ring.radius_mm),
            tangential_mm2: 0.0,
        }
    }

    fn tube(&self) -> &LocalTube {
        &self.tube
    }

    fn tangential_mm2(&self) -> f64 {
        self.tangential_mm2
    }

    fn add(&mut self, ring: Ring) -> Option<()> {
        let newest = ring.clone();
        let beside = |tube: LocalTube| Some(newest.beside(&tube).0).filter(LocalTube::is_sound);
        self.tube = beside(self.tube)?;
        let near = if self.rings.is_empty() { NEAR_AT_FIRST } else { NEAR };
        self.remember(ring);
        let steps = if self.rings.len() < YOUNG { STEPS_WHILE_YOUNG } else { 1 };
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
        (WindowFit::WINDOW_RADII * self.tube.radius_mm).max(WindowFit::LEAST_WINDOW_MM)
    }

    /// Keeps a ring and drops what is too much: rings out of reach, and then those that say least: whose neighbours in
    /// time, on either side, are nearest to each other.
    fn remember(&mut self, ring: Ring) {
        // A tilted ring reaches into the window from outside.
        let reach = self.half_length_mm() + self.tube.radius_mm;
        let to_axis = self.tube.world_from_axis.inverse();
        self.rings.retain(|ring| to_axis.transform_point(ring.centre_mm).length() <= reach);
        self.rings.push_back(ring);
        while self.rings.len() > WindowFit::MOST_FRAMES {
            let apart = |a: &Ring, b: &Ring| {
                let turned = a.world_from_probe.rotation.z_axis.distance(b.world_from_probe.rotation.z_axis);
                a.centre_mm.distance(b.centre_mm) + self.tube.radius_mm * turned
            };
            let neighbours = self.rings.iter().zip(self.rings.iter().skip(2));
            let gaps = neighbours.map(|(a, b)| apart(a, b)).enumerate();
            let least = gaps.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(before, _)| before + 1);
            self.rings.remove(least);
        }
    }

    /// Gauss and Newton's step, by maximum a posteriori; measures the noise on the way.
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
        for ring in &self.rings {
            let image_normal = to_axis.rotation * ring.world_from_probe.rotation.z_axis;
            let mut shared = Shared::new(tube.radius_mm);
            for &p in &ring.points_mm {
                let p = to_axis.transform_point(p);
                let held = tube.hold(p, image_normal, 3.0 * self.noise_mm);
                let along = held.s_mm / half_length;
                if along.abs() >= 1.0 {
                    continue;
                }
                let size = held.miss_mm.abs() / held.variance.sqrt();
                sizes.push(size);
                if size >= gate {
                    continue;
                }
                let weight = bisquare(along) * bisquare(size / gate) * precision / held.variance;
                for i in 0..PARAMETERS {
                    let g = weight * held.gain[i];
                    for (sum, other) in normal[i][..=i].iter_mut().zip(&held.gain) {
                        *sum += g * other;
                    }
                    right[i] += g * held.miss_mm;
                }
                shared.add(weight, &held.gain, held.miss_mm);
            }
            shared.take_out(&mut normal, &mut right)?;
            direction += image_normal * shared.weight;
            tangential += ring.tangential_mm2 * shared.weight;
            total += shared.weight;
        }
        // The catheter lies along the vessel, by and large.
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
        self.noise_mm = robust_sd(&mut sizes).max(LEAST_NOISE * r);
        // No more than noise all round can have: contours drawn by hand have points at uneven angles. The points kept
        // are the middle ones of a few, which scatter less along the rays than across.
        self.tangential_mm2 = (tangential / total).min(2.25 * self.noise_mm * self.noise_mm);
        Some(backward(&root, forward(&root, right)))
    }
}

/// Tukey's biweight.
fn bisquare(u: f64) -> f64 {
    (1.0 - u * u).powi(2)
}

/// Errors that the points of one ring share: a shift across the axis (2) and an oval (2).
const SHARED: usize = 4;
/// Which of the parameters act alike.
const ACTS_LIKE: [usize; SHARED] = [0, 1, 8, 9];

/// What the points of one ring say about the errors that they share.
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

    fn add(&mut self, weight: f64, gain: &Change, miss_mm: f64) {
        let own = ACTS_LIKE.map(|i| gain[i]);
        self.weight += weight;
        for i in 0..SHARED {
            let g = weight * own[i];
            for (sum, other) in self.normal[i][..=i].iter_mut().zip(&own) {
                *sum += g * other;
            }
            self.right[i] += g * miss_mm;
        }
        for (sums, g) in self.with.iter_mut().zip(gain) {
            let g = weight * g;
            for (sum, own) in sums.iter_mut().zip(&own) {
                *sum += g * own;
            }
        }
    }

    /// Integrates the shared errors out of the sums over the points.
    fn take_out(&self, normal: &mut Matrix<PARAMETERS>, right: &mut Change) -> Option<()> {
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
        Frame {
            world_from_sensor: Pose { rotation, translation_mm: DVec3::new(0.0, 0.0, z) },
            time_s: None,
            contour_mm: (0..60).map(point).collect(),
            cylinder: None,
        }
    }

    #[test]
    fn a_catheter_at_rest_keeps_a_bounded_memory_and_what_it_saw_on_the_way() {
        let mut estimate = WindowFit::default();
        for k in 0..1000 {
            estimate.push(&frame(f64::from(k).min(50.0) * 0.2, 0.0)).unwrap();
        }
        let rings = &estimate.0.known().unwrap().rings;
        assert_eq!(rings.len(), WindowFit::MOST_FRAMES);
        let moving = rings.iter().filter(|ring| ring.centre_mm.z < 9.9).count();
        assert!(moving >= 45, "{moving} of 50");
    }

    #[test]
    fn a_turning_tip_is_remembered_all_round() {
        let mut estimate = WindowFit::default();
        for k in 0..1000 {
            estimate.push(&frame(0.0, f64::from(k) / 1000.0 * TAU)).unwrap();
        }
        let rings = &estimate.0.known().unwrap().rings;
        let sum: DVec3 = rings.iter().map(|ring| ring.world_from_probe.rotation.z_axis).sum();
        let mean = sum / rings.len() as f64;
        assert!(mean.truncate().length() < 0.02, "{mean}");
    }
}
