//! The local cylinder of a frame.

use crate::geometry::Pose;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Larger than any vessel's radius, and small enough that squares of lengths stay within f32, mm.
pub(crate) const MAX_RADIUS_MM: f64 = 10_000.0;

/// A cylinder in the tracker sensor's frame `{e}`: the point where its axis meets the plane z = 0, the direction of the
/// axis, and the radius (thesis, Eq. 4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CylinderModel {
    /// x of the axis in the plane z = 0 of `{e}`, mm.
    pub px_mm: f64,
    /// y of the axis in the plane z = 0 of `{e}`, mm.
    pub py_mm: f64,
    /// Angle between the axis and x of `{e}`, rad.
    pub theta_rad: f64,
    /// Angle of the axis about x of `{e}`, from y towards z, rad.
    pub phi_rad: f64,
    /// Radius, mm.
    pub radius_mm: f64,
}

impl CylinderModel {
    /// The model of a cylinder with a given axis: a point on it in the plane z = 0 of `{e}` and its direction.
    pub fn from_axis(px_mm: f64, py_mm: f64, axis: DVec3, radius_mm: f64) -> Self {
        let axis = axis.normalize();
        Self {
            px_mm,
            py_mm,
            theta_rad: axis.x.clamp(-1.0, 1.0).acos(),
            phi_rad: axis.z.atan2(axis.y),
            radius_mm,
        }
    }

    /// `eTcyl`: the long axis is the first column, the origin is (px, py, 0) (thesis, Eq. 4).
    pub fn sensor_from_cylinder(&self) -> Pose {
        let (st, ct) = self.theta_rad.sin_cos();
        let (sp, cp) = self.phi_rad.sin_cos();
        Pose {
            rotation: DMat3::from_cols(
                DVec3::new(ct, st * cp, st * sp),
                DVec3::new(-st, ct * cp, ct * sp),
                DVec3::new(0.0, -sp, cp),
            ),
            translation_mm: DVec3::new(self.px_mm, self.py_mm, 0.0),
        }
    }

    /// Whether all five numbers are finite.
    pub fn is_finite(&self) -> bool {
        [self.px_mm, self.py_mm, self.theta_rad, self.phi_rad, self.radius_mm].iter().all(|x| x.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_long_axis_is_the_first_column() {
        let axis = DVec3::new(0.2, -0.4, 0.7).normalize();
        let model = CylinderModel::from_axis(1.0, 2.0, axis, 12.0);
        let pose = model.sensor_from_cylinder();
        assert!(pose.rotation.x_axis.abs_diff_eq(axis, 1e-15));
        assert!((pose.rotation.determinant() - 1.0).abs() < 1e-15);
        assert!(pose.orthogonality_error() < 1e-15);
    }
}
