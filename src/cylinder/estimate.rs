use super::{CylinderModel, MOST_RADIUS_MM};
use crate::geometry::Pose;
use crate::recording::Frame;
use glam::{DMat3, DVec2, DVec3};
use std::collections::VecDeque;

/// Finds the local cylinder of each frame from the contours and poses seen so far.
///
/// Frames are shown in the order in which they arrive; an estimate uses that frame and earlier ones only, so
/// that it is there while the catheter still moves.
pub trait CylinderEstimator {
    /// Takes the next frame and returns its cylinder; `None` where the frame shows no wall, or one whose radius
    /// [`Recording::check`](crate::recording::Recording::check) would refuse.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel>;
}

/// A cylinder from the centres of the last few contours.
///
/// - **Centre**: the area centroid of this frame's contour ([`Frame::centroid_mm`]).
/// - **Axis**: the principal direction of the centres, in the world, of this frame and the earlier ones up to
///   [`SPAN_MM`](Self::SPAN_MM) away, pointing along the probe's +z. While they span less, or where the direction
///   leans more than [`MOST_LEAN_RAD`](Self::MOST_LEAN_RAD) from the probe's z axis, that axis stands in.
/// - **Radius**: the median distance of this frame's wall points from the axis.
///
/// One frame takes bounded time: at most [`MOST_FRAMES`](Self::MOST_FRAMES) centres are looked at.
#[derive(Debug, Clone)]
pub struct LocalEstimate {
    sensor_from_probe: Pose,
    /// Recent centres in the world, mm, oldest first.
    centres_mm: VecDeque<DVec3>,
}

impl LocalEstimate {
    /// Distance between the first and last centre that an axis is fitted to, mm: long enough that tracking noise
    /// of half a millimetre turns the axis by a few degrees only, short enough to follow a bend, behind which the
    /// axis lags by half of it. A step longer than this starts the path afresh.
    pub const SPAN_MM: f64 = 8.0;
    /// Centres that are kept at most, so that a catheter at rest costs no more than a moving one.
    pub const MOST_FRAMES: usize = 512;
    /// The largest angle between axis and probe, rad: centres that move further to the side show the catheter
    /// swinging, not the way of the vessel.
    pub const MOST_LEAN_RAD: f64 = std::f64::consts::FRAC_PI_3;

    /// An estimate that has seen nothing yet. `sensor_from_probe` is the calibration `eTi` (thesis, Eq. 11).
    pub fn new(sensor_from_probe: Pose) -> Self {
        Self { sensor_from_probe, centres_mm: VecDeque::new() }
    }

    /// The axis in the world through the centres kept, if they say one.
    fn axis(&self, probe_z: DVec3) -> Option<DVec3> {
        let chord = *self.centres_mm.back()? - *self.centres_mm.front()?;
        if chord.length() < Self::SPAN_MM {
            return None;
        }
        let direction = principal_direction(&self.centres_mm, chord)?;
        let direction = if direction.dot(probe_z) < 0.0 { -direction } else { direction };
        (direction.dot(probe_z) >= Self::MOST_LEAN_RAD.cos()).then_some(direction)
    }

    fn remember(&mut self, centre_mm: DVec3) {
        if self.centres_mm.back().is_some_and(|last| last.distance(centre_mm) > Self::SPAN_MM) {
            self.centres_mm.clear();
        }
        self.centres_mm.push_back(centre_mm);
        let spans = |oldest: Option<&DVec3>| oldest.is_some_and(|c| c.distance(centre_mm) >= Self::SPAN_MM);
        while self.centres_mm.len() > Self::MOST_FRAMES || spans(self.centres_mm.get(1)) {
            self.centres_mm.pop_front();
        }
    }
}

impl Default for LocalEstimate {
    /// With the identity as calibration.
    fn default() -> Self {
        Self::new(Pose::IDENTITY)
    }
}

impl CylinderEstimator for LocalEstimate {
    /// `None` also where the pose is not finite, or the axis runs along the plane z = 0 of `{e}`, which a [`CylinderModel`] cannot express.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        let centroid = frame.centroid_mm()?;
        let world_from_probe = frame.world_from_sensor * self.sensor_from_probe;
        let world_centre = world_from_probe.transform_point(centroid.extend(0.0));
        if !(world_from_probe.is_finite() && world_centre.is_finite()) {
            return None;
        }
        self.remember(world_centre);
        let probe_z = world_from_probe.rotation.z_axis;
        let world_axis = self.axis(probe_z).unwrap_or(probe_z);
        let axis = frame.world_from_sensor.rotation.transpose() * world_axis;
        about(frame, centroid, axis, &self.sensor_from_probe)
    }
}

/// A cylinder that stands upright on the frame: along the probe's z axis, about the area centroid of its contour
/// ([`Frame::centroid_mm`]). The radius is the median distance of its wall points from there.
///
/// For contours drawn across the vessel, as in pullbacks whose poses nobody measured, and lumens so far from round that
/// their centres jump from frame to frame without the vessel turning.
#[derive(Debug, Clone, Copy)]
pub struct Upright {
    /// The calibration `eTi` (thesis, Eq. 11).
    pub sensor_from_probe: Pose,
}

impl CylinderEstimator for Upright {
    /// `None` also where the probe's axis runs along the plane z = 0 of `{e}`, which a [`CylinderModel`] cannot express.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel> {
        about(frame, frame.centroid_mm()?, self.sensor_from_probe.rotation.z_axis, &self.sensor_from_probe)
    }
}

/// The cylinder about a point in the probe's plane with an axis given in `{e}`.
fn about(frame: &Frame, centre_mm: DVec2, axis: DVec3, sensor_from_probe: &Pose) -> Option<CylinderModel> {
    let centre = sensor_from_probe.transform_point(centre_mm.extend(0.0));
    let mut distances: Vec<f64> = frame
        .echoes_mm()
        .map(|p| sensor_from_probe.transform_point(p.extend(0.0)) - centre)
        .map(|p| p.reject_from_normalized(axis).length())
        .collect();
    let middle = distances.len() / 2;
    let radius_mm = *distances.select_nth_unstable_by(middle, f64::total_cmp).1;

    let to_plane = -centre.z / axis.z;
    let foot = centre + axis * to_plane;
    let model = CylinderModel::from_axis(foot.x, foot.y, axis, radius_mm);
    (axis.z.abs() > 1e-3 && model.is_finite() && (0.0 < radius_mm && radius_mm <= MOST_RADIUS_MM))
        .then_some(model)
}

/// The direction along which points spread most, by power iteration from a guess.
fn principal_direction(points: &VecDeque<DVec3>, guess: DVec3) -> Option<DVec3> {
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let mut spread = DMat3::ZERO;
    for p in points.iter().map(|&p| p - mean) {
        spread += DMat3::from_cols(p * p.x, p * p.y, p * p.z);
    }
    // The guess is the chord of a curve that bends little: a few steps are plenty.
    (0..8).try_fold(guess.try_normalize()?, |direction, _| (spread * direction).try_normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// A straight vessel of radius 10 about the world's z axis, seen by a probe `aside` mm from its axis and
    /// `lean` rad tilted about x, at z mm.
    fn frame(z: f64, aside: f64, lean: f64, sensor_from_probe: Pose) -> Frame {
        let rotation = DQuat::from_rotation_x(lean);
        let world_from_probe = Pose::from_quaternion(DVec3::new(aside, 0.0, z), rotation);
        let ray = |j: i32| {
            // The ray r·u meets x² + y² = 100.
            let angle = f64::from(j) / 60.0 * std::f64::consts::TAU;
            let u = rotation * DVec3::new(angle.cos(), angle.sin(), 0.0);
            let (a, b, c) = (u.x * u.x + u.y * u.y, aside * u.x, aside * aside - 100.0);
            let r = (-b + (b * b - a * c).sqrt()) / a;
            DVec2::new(angle.cos(), angle.sin()) * r
        };
        Frame {
            world_from_sensor: world_from_probe * sensor_from_probe.inverse(),
            time_s: None,
            contour_mm: (0..60).map(ray).collect(),
            cylinder: None,
        }
    }

    fn world_axis(frame: &Frame, model: &CylinderModel) -> (DVec3, DVec3) {
        let pose = frame.world_from_sensor * model.sensor_from_cylinder();
        (pose.translation_mm, pose.rotation.x_axis)
    }

    #[test]
    fn a_straight_vessel_is_found_from_a_leaning_probe_under_any_calibration() {
        let turned = Pose::from_quaternion(DVec3::new(1.0, -2.0, 3.0), DQuat::from_rotation_y(0.4));
        for calibration in [Pose::IDENTITY, turned] {
            let mut estimate = LocalEstimate::new(calibration);
            for k in 0..100 {
                let frame = frame(f64::from(k) * 0.2, 3.0, 0.3, calibration);
                let model = estimate.push(&frame).unwrap();
                if k < 45 {
                    continue;
                }
                let (point, axis) = world_axis(&frame, &model);
                assert!(axis.z > 1.0 - 1e-9, "frame {k}: {axis}");
                // 60 rays from off-centre: the polygon's centroid is not the ellipse's to the last digit.
                assert!(point.truncate().length() < 0.05, "frame {k}: {point}");
                assert!((model.radius_mm - 10.0).abs() < 0.05, "frame {k}: {}", model.radius_mm);
            }
        }
    }

    #[test]
    fn before_the_path_says_a_direction_the_probe_does() {
        let mut estimate = LocalEstimate::default();
        for k in 0..39 {
            let frame = frame(f64::from(k) * 0.2, 0.0, 0.3, Pose::IDENTITY);
            let (_, axis) = world_axis(&frame, &estimate.push(&frame).unwrap());
            assert!(axis.abs_diff_eq(frame.world_from_sensor.rotation.z_axis, 1e-12), "frame {k}");
        }
    }

    #[test]
    fn a_path_across_the_probe_is_not_taken_for_the_vessel() {
        let mut estimate = LocalEstimate::default();
        for k in 0..100 {
            let mut frame = frame(0.0, 0.0, 0.0, Pose::IDENTITY);
            frame.world_from_sensor.translation_mm.x = f64::from(k);
            let (_, axis) = world_axis(&frame, &estimate.push(&frame).unwrap());
            assert!(axis.abs_diff_eq(DVec3::Z, 1e-12), "frame {k}");
        }
    }

    #[test]
    fn an_axis_follows_the_probe_when_the_path_runs_backwards() {
        let mut estimate = LocalEstimate::default();
        for k in 0..100 {
            let frame = frame(-f64::from(k) * 0.2, 0.0, 0.1, Pose::IDENTITY);
            let (_, axis) = world_axis(&frame, &estimate.push(&frame).unwrap());
            assert!(axis.z > 0.99, "frame {k}: {axis}");
        }
    }

    #[test]
    fn a_frame_that_the_tracker_lost_or_threw_away_leaves_the_others_alone() {
        let mut estimate = LocalEstimate::default();
        for k in 0..200 {
            let mut frame = frame(f64::from(k) * 0.2, 0.0, 0.3, Pose::IDENTITY);
            match k {
                80 => frame.world_from_sensor.translation_mm.x = f64::NAN,
                90 => frame.world_from_sensor.translation_mm += DVec3::new(20.0, 0.0, 30.0),
                _ => {}
            }
            let model = estimate.push(&frame);
            assert_eq!(model.is_none(), k == 80, "frame {k}");
            if let Some(model) = model {
                let (_, axis) = world_axis(&frame, &model);
                assert!(axis.z >= 0.3_f64.cos() - 1e-9, "frame {k}: {axis}");
                assert!(k < 140 || axis.z > 1.0 - 1e-9, "frame {k}: {axis}");
            }
        }
    }

    #[test]
    fn an_upright_cylinder_follows_the_probe_whatever_the_path() {
        let turned = Pose::from_quaternion(DVec3::new(1.0, -2.0, 3.0), DQuat::from_rotation_y(0.4));
        for calibration in [Pose::IDENTITY, turned] {
            let mut upright = Upright { sensor_from_probe: calibration };
            for k in 0..60 {
                let frame = frame(f64::from(k) * 0.2, f64::from(k) * 0.1, 0.3, calibration);
                let model = upright.push(&frame).unwrap();
                let (point, axis) = world_axis(&frame, &model);
                let probe = frame.world_from_sensor * calibration;
                assert!(axis.abs_diff_eq(probe.rotation.z_axis, 1e-12), "frame {k}: {axis}");
                let centre = probe.transform_point(frame.centroid_mm().unwrap().extend(0.0));
                assert!((point - centre).reject_from(axis).length() < 1e-9, "frame {k}: {point}");
                assert!((10.0..10.0 / 0.3_f64.cos()).contains(&model.radius_mm), "{}", model.radius_mm);
            }
        }
        let mut nothing = frame(0.0, 0.0, 0.0, Pose::IDENTITY);
        nothing.contour_mm.clear();
        assert_eq!(Upright { sensor_from_probe: Pose::IDENTITY }.push(&nothing), None);
    }

    #[test]
    fn no_wall_no_cylinder() {
        let mut estimate = LocalEstimate::default();
        let mut frame = frame(0.0, 0.0, 0.0, Pose::IDENTITY);
        frame.contour_mm = vec![DVec2::NAN; 60];
        assert_eq!(estimate.push(&frame), None);
        frame.contour_mm.clear();
        assert_eq!(estimate.push(&frame), None);
        frame.contour_mm = vec![DVec2::ONE; 60];
        assert_eq!(estimate.push(&frame), None);
    }

    #[test]
    fn a_radius_beyond_any_vessel_is_no_estimate() {
        let scaled = |factor: f64| {
            let mut frame = frame(0.0, 0.0, 0.0, Pose::IDENTITY);
            frame.contour_mm.iter_mut().for_each(|p| *p *= factor);
            let upright = Upright { sensor_from_probe: Pose::IDENTITY }.push(&frame);
            [LocalEstimate::default().push(&frame), upright]
        };
        for model in scaled(999.0) {
            assert!((model.unwrap().radius_mm - 9990.0).abs() < 1e-6, "{model:?}");
        }
        // The last two overflow: areas, and then lengths too.
        for factor in [1001.0, 1e30, 1e160, 1e307] {
            assert_eq!(scaled(factor), [None, None], "{factor}");
        }
    }

    #[test]
    fn a_catheter_at_rest_keeps_a_bounded_memory() {
        let mut estimate = LocalEstimate::default();
        for _ in 0..2000 {
            estimate.push(&frame(0.0, 0.0, 0.0, Pose::IDENTITY));
        }
        assert_eq!(estimate.centres_mm.len(), LocalEstimate::MOST_FRAMES);
    }
}
