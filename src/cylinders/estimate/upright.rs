//! The estimator's interface, and the cylinder that stands upright on its frame.

use crate::geometry::Pose;
use crate::numerics::robust::median;
use crate::recording::{CylinderModel, Frame, MAX_RADIUS_MM};
use glam::{DVec2, DVec3};

/// Finds the local cylinder of each frame from the contours and poses seen so far.
///
/// Frames are passed in the order of their arrival; an estimate uses that frame and earlier ones only, so that it is
/// available while the catheter still moves.
pub trait CylinderEstimator {
    /// Takes the next frame and returns its cylinder; `None` where the frame shows no wall, or one whose radius
    /// [`Recording::check`](crate::recording::Recording::check) would refuse.
    fn push(&mut self, frame: &Frame) -> Option<CylinderModel>;
}

/// A cylinder that stands upright on the frame: along the probe's z axis, about the area centroid of its contour
/// ([`Frame::centroid_mm`]). The radius is the median distance of its wall points from there.
///
/// For contours drawn across the vessel, as in pullbacks without measured poses, and for lumens so far from round that
/// their centres jump from frame to frame although the vessel does not turn.
#[derive(Debug, Clone, Copy)]
pub struct Upright {
    /// The calibration `eTi` (thesis, Eq. 11).
    pub sensor_from_probe: Pose,
}

impl CylinderEstimator for Upright {
    /// `None` also where the probe's axis is parallel to the plane z = 0 of `{e}`, which a [`CylinderModel`] cannot express.
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
    let radius_mm = median(&mut distances);

    let to_plane = -centre.z / axis.z;
    let on_plane = centre + axis * to_plane;
    let model = CylinderModel::from_axis(on_plane.x, on_plane.y, axis, radius_mm);
    (axis.z.abs() > 1e-3 && model.is_finite() && (0.0 < radius_mm && radius_mm <= MAX_RADIUS_MM))
        .then_some(model)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cylinders::estimate::{UnscentedFilter, WindowFit};
    use glam::{DMat3, DQuat};

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
        Frame::new(world_from_probe * sensor_from_probe.inverse(), (0..60).map(ray).collect())
    }

    fn world_axis(frame: &Frame, model: &CylinderModel) -> (DVec3, DVec3) {
        let pose = frame.world_from_sensor * model.sensor_from_cylinder();
        (pose.translation_mm, pose.rotation.x_axis)
    }

    /// Both estimators.
    fn both(calibration: Pose) -> [Box<dyn CylinderEstimator>; 2] {
        [Box::new(WindowFit::new(calibration)), Box::new(UnscentedFilter::new(calibration))]
    }

    #[test]
    fn a_straight_vessel_is_found_from_a_leaning_probe_under_any_calibration() {
        let turned = Pose::from_quaternion(DVec3::new(1.0, -2.0, 3.0), DQuat::from_rotation_y(0.4));
        for (calibration, mut estimate) in
            [Pose::IDENTITY, turned].into_iter().flat_map(|c| both(c).map(|e| (c, e)))
        {
            for k in 0..100 {
                let frame = frame(f64::from(k) * 0.2, 3.0, 0.3, calibration);
                let model = estimate.push(&frame).unwrap();
                if k < 45 {
                    continue;
                }
                let (point, axis) = world_axis(&frame, &model);
                assert!(axis.z > 0.04_f64.cos(), "frame {k}: {axis}");
                assert!(point.truncate().length() < 0.15, "frame {k}: {point}");
                assert!((model.radius_mm - 10.0).abs() < 0.1, "frame {k}: {}", model.radius_mm);
            }
        }
    }

    #[test]
    fn before_the_path_says_a_direction_the_probe_does() {
        for mut estimate in both(Pose::IDENTITY) {
            let frame = frame(0.0, 0.0, 0.0, Pose::IDENTITY);
            let (_, axis) = world_axis(&frame, &estimate.push(&frame).unwrap());
            assert!(axis.abs_diff_eq(DVec3::Z, 1e-6), "{axis}");
        }
    }

    #[test]
    fn an_axis_follows_the_probe_when_the_path_runs_backwards() {
        for mut estimate in both(Pose::IDENTITY) {
            for k in 0..100 {
                let frame = frame(-f64::from(k) * 0.2, 0.0, 0.1, Pose::IDENTITY);
                let (_, axis) = world_axis(&frame, &estimate.push(&frame).unwrap());
                assert!(axis.z > 0.99, "frame {k}: {axis}");
            }
        }
    }

    #[test]
    fn a_frame_that_the_tracker_lost_or_threw_away_leaves_the_others_alone() {
        for mut estimate in both(Pose::IDENTITY) {
            for k in 0..200 {
                let mut frame = frame(f64::from(k) * 0.2, 0.0, 0.3, Pose::IDENTITY);
                match k {
                    80 => frame.world_from_sensor.translation_mm.x = f64::NAN,
                    90 => frame.world_from_sensor.translation_mm += DVec3::new(20.0, 0.0, 30.0),
                    _ => {}
                }
                let model = estimate.push(&frame);
                assert_eq!(model.is_none(), k == 80, "frame {k}");
                if let Some(model) = model.filter(|_| k > 60 && k != 90) {
                    let (_, axis) = world_axis(&frame, &model);
                    assert!(axis.z > 0.04_f64.cos(), "frame {k}: {axis}");
                }
            }
        }
    }

    #[test]
    fn a_jump_for_good_is_followed() {
        for mut estimate in both(Pose::IDENTITY) {
            for k in 0..100 {
                let mut frame = frame(f64::from(k) * 0.2, 0.0, 0.1, Pose::IDENTITY);
                let away = if k < 50 { DVec3::ZERO } else { DVec3::new(100.0, 50.0, 0.0) };
                frame.world_from_sensor.translation_mm += away;
                let (point, _) = world_axis(&frame, &estimate.push(&frame).unwrap());
                assert!((point - away).truncate().length() < 0.15, "frame {k}: {point}");
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
        for mut estimate in both(Pose::IDENTITY) {
            let seen = frame(0.0, 0.0, 0.0, Pose::IDENTITY);
            for contour in [vec![], vec![DVec2::NAN; 60], vec![DVec2::ONE; 60]] {
                let blind = Frame { contour_mm: contour, ..seen.clone() };
                assert!(estimate.push(&seen).is_some());
                assert_eq!(estimate.push(&blind), None);
            }
            assert!(estimate.push(&seen).is_some());
        }
    }

    #[test]
    fn a_radius_beyond_any_vessel_is_no_estimate() {
        let scaled = |factor: f64| {
            let mut frame = frame(0.0, 0.0, 0.0, Pose::IDENTITY);
            frame.contour_mm.iter_mut().for_each(|p| *p *= factor);
            let upright = Upright { sensor_from_probe: Pose::IDENTITY }.push(&frame);
            let [window, filter] = both(Pose::IDENTITY).map(|mut e| e.push(&frame));
            [window, filter, upright]
        };
        for model in scaled(999.0) {
            // The filter knows that a probe may lean, and then sees a vessel wider than it is.
            assert!((model.unwrap().radius_mm / 9990.0 - 1.0).abs() < 0.02, "{model:?}");
        }
        // The last two overflow: areas, and then lengths too.
        for factor in [1001.0, 1e30, 1e160, 1e307] {
            assert_eq!(scaled(factor), [None; 3], "{factor}");
        }
    }

    #[test]
    fn nonsense_is_survived() {
        for mut estimate in both(Pose::IDENTITY) {
            for k in 0..300_u32 {
                let mut frame = frame(f64::from(k) * 0.2, 0.0, 0.3, Pose::IDENTITY);
                // Contours of three points, of all sizes, on one line, far away; probes that turn round.
                let scale = 10.0_f64.powi((k % 13) as i32 - 6);
                frame.contour_mm.truncate(if k % 3 == 0 { 3 } else { 60 });
                frame.contour_mm.iter_mut().for_each(|p| *p *= DVec2::new(scale, 1.0));
                frame.world_from_sensor.rotation *= DMat3::from_rotation_y(f64::from(k));
                frame.world_from_sensor.translation_mm *= f64::from(k % 7) * scale;
                let model = estimate.push(&frame);
                assert!(model.is_none_or(|m| m.is_finite() && m.radius_mm > 0.0), "frame {k}: {model:?}");
            }
        }
    }
}
