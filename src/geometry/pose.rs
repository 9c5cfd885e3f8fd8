use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::ops::Mul;

/// A rigid transform `aTb`: takes a point's coordinates in `{b}` to its coordinates in `{a}`.
///
/// Written `a_from_b` in names, so that a product reads like the thesis's chains: `wTi = wTe · eTi` is
/// `world_from_sensor * sensor_from_probe`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation; its columns are `{b}`'s axes in `{a}`.
    pub rotation: DMat3,
    /// Origin of `{b}` in `{a}`, in mm.
    pub translation_mm: DVec3,
}

impl Pose {
    /// No motion at all.
    pub const IDENTITY: Pose = Pose { rotation: DMat3::IDENTITY, translation_mm: DVec3::ZERO };

    /// The pose of a sensor that the tracker did not see: all its numbers are NaN, so that it equals no pose,
    /// not even itself.
    pub const LOST: Pose = Pose { rotation: DMat3::NAN, translation_mm: DVec3::NAN };

    /// A pose from a position in mm and a unit quaternion.
    pub fn from_quaternion(translation_mm: DVec3, quaternion: DQuat) -> Self {
        Self { rotation: DMat3::from_quat(quaternion), translation_mm }
    }

    /// The pose of a 4×4 matrix, `m[row][column]`, such as trackers give it: the rotation at the left, the translation in
    /// mm in the last column, and 0 0 0 1 below. The rotation is taken as it is.
    ///
    /// # Errors
    /// The last row, where it is another one: then the matrix is transposed, or projective.
    pub fn from_matrix(m: &[[f64; 4]; 4]) -> Result<Self, [f64; 4]> {
        if m[3].map(|x| if x.abs() <= 1e-9 { 0.0 } else { x }) != [0.0, 0.0, 0.0, 1.0] {
            return Err(m[3]);
        }
        let column = |c: usize| DVec3::new(m[0][c], m[1][c], m[2][c]);
        Ok(Self { rotation: DMat3::from_cols(column(0), column(1), column(2)), translation_mm: column(3) })
    }

    /// The rotation as a unit quaternion with non-negative w, so that equal rotations print equal.
    pub fn quaternion(&self) -> DQuat {
        let q = DQuat::from_mat3(&self.rotation).normalize();
        if q.w < 0.0 { -q } else { q }
    }

    /// The opposite transform, `bTa`. The rotation is taken to be orthonormal.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation_mm: -(rotation * self.translation_mm) }
    }

    /// The coordinates in `{a}` of a point given in `{b}`, mm.
    pub fn transform_point(&self, point_mm: DVec3) -> DVec3 {
        self.rotation * point_mm + self.translation_mm
    }

    /// Largest element of |RᵀR − I|: 0 for a perfect rotation.
    pub fn orthogonality_error(&self) -> f64 {
        let e = self.rotation.transpose() * self.rotation - DMat3::IDENTITY;
        e.to_cols_array().iter().fold(0.0, |worst, x| x.abs().max(worst))
    }

    /// The pose with the rotation that is nearest to its own: what rounding took from its axes is made good.
    ///
    /// Newton's iteration for the orthogonal factor of a polar decomposition; it doubles the digits in each
    /// step, so that five are enough for a rotation with two good ones.
    #[must_use]
    pub fn orthonormalised(&self) -> Self {
        let step = |rotation: DMat3, _| (rotation + rotation.inverse().transpose()) * 0.5;
        Self { rotation: (0..5).fold(self.rotation, step), ..*self }
    }

    /// The angle of the rotation from this orientation to another, rad, from 0 to π.
    pub fn turn_rad(&self, other: &Self) -> f64 {
        let turn = self.rotation.transpose() * other.rotation;
        ((turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0) / 2.0).clamp(-1.0, 1.0).acos()
    }

    /// Whether all twelve numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation_mm.is_finite()
    }
}

impl Mul for Pose {
    type Output = Pose;
    fn mul(self, other: Pose) -> Pose {
        Pose {
            rotation: self.rotation * other.rotation,
            translation_mm: self.transform_point(other.translation_mm),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some_pose() -> Pose {
        Pose::from_quaternion(
            DVec3::new(-387.0, 32.0, -35.0),
            DQuat::from_xyzw(0.3, -0.5, 0.1, 0.8).normalize(),
        )
    }

    #[test]
    fn a_pose_times_its_inverse_is_the_identity() {
        let p = some_pose() * some_pose().inverse();
        assert!(p.rotation.abs_diff_eq(DMat3::IDENTITY, 1e-15));
        assert!(p.translation_mm.length() < 1e-12);
    }

    #[test]
    fn a_rounded_rotation_is_made_orthonormal_again() {
        let p = some_pose();
        let rounded = p.rotation.to_cols_array().map(|x| (x * 100.0).round() / 100.0);
        let rounded = Pose { rotation: DMat3::from_cols_array(&rounded), ..p };
        assert!(rounded.orthogonality_error() > 1e-3);
        assert!(rounded.orthonormalised().orthogonality_error() < 1e-15);
        assert!(rounded.orthonormalised().rotation.abs_diff_eq(p.rotation, 5e-3));
    }

    #[test]
    fn the_quaternion_gives_the_rotation_back() {
        let p = some_pose();
        let back = Pose::from_quaternion(p.translation_mm, p.quaternion());
        assert!(back.rotation.abs_diff_eq(p.rotation, 1e-15));
        assert!(p.orthogonality_error() < 1e-15);
    }
}
