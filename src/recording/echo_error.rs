//! The errors of an echo: their covariance, and how a contour shows the part across the probe's rays.

use glam::{DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// Share of an echo's variance that lies across its image plane: contours are uncertain within their plane, poses in
/// every direction. At the thesis's noise levels 0.09 mm² of 1.09 mm².
pub(crate) const OUT_OF_PLANE: f64 = 0.1;
/// The same without the errors of the pose. The contours' own noise lies within the plane; the share bounds the weight of a wall
/// that runs along the plane.
pub(crate) const CONTOUR_OUT_OF_PLANE: f64 = 0.02;

/// The direction `Σn` from an echo to the likeliest point of a wall with the normal `n`, and the variance `nᵀΣn` of the
/// echo's distance along `n`, times the length of `n`, in units of its variance within the image plane.
///
/// An echo's errors have the covariance `Σ ∝ I - (1 - ε) z zᵀ`, z being the unit normal of its image plane and ε
/// `out_of_plane`.
#[inline(always)]
pub(crate) fn likeliest_direction(normal: DVec3, image_normal: DVec3, out_of_plane: f64) -> (DVec3, f64) {
    let likeliest = normal - image_normal * ((1.0 - out_of_plane) * normal.dot(image_normal));
    (likeliest, normal.dot(likeliest))
}

/// Absolute second differences of the angle from point to point of a contour, as lengths at the wall, mm; none at
/// missing echoes.
///
/// A probe looks along rays at even angles, and so do points that were drawn on its image, piece by piece. Second
/// differences of the angle therefore show the noise across the rays alone, with six times its variance.
pub(crate) fn angle_jumps_mm(contour_mm: &[DVec2]) -> impl Iterator<Item = f64> + '_ {
    let turn = |d: f64| (d + PI).rem_euclid(TAU) - PI;
    // The turn to the point before, and that point's angle; NaN at a missing echo, and so are the jumps about it.
    let mut before = [f64::NAN, contour_mm.first().map_or(f64::NAN, |p| p.y.atan2(p.x))];
    let jump = move |(here, next): (&DVec2, &DVec2)| {
        let angle = next.y.atan2(next.x);
        let turned = turn(angle - before[1]);
        let jump_mm = (turned - before[0]).abs() * here.length();
        before = [turned, angle];
        (!jump_mm.is_nan()).then_some(jump_mm)
    };
    contour_mm.iter().zip(contour_mm.iter().skip(1)).filter_map(jump)
}

/// Variance of [`angle_jumps_mm`] in units of the variance of the noise across the rays.
pub(crate) const ANGLE_JUMP_VARIANCE: f64 = 6.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likeliest_point_lies_along_the_image_plane() {
        let (across, variance) = likeliest_direction(DVec3::X, DVec3::Z, OUT_OF_PLANE);
        assert_eq!((across, variance), (DVec3::X, 1.0));
        let slanting = DVec3::new(0.6, 0.0, 0.8);
        let (likeliest, variance) = likeliest_direction(DVec3::X, slanting, OUT_OF_PLANE);
        assert!((variance - (1.0 - 0.9 * 0.36)).abs() < 1e-12, "{variance}");
        assert!(likeliest.z < 0.0, "{likeliest}");
    }

    #[test]
    fn even_rays_have_no_jumps_whatever_the_radius() {
        let point = |j: i32| DVec2::from_angle(f64::from(j) / 40.0 * TAU) * (5.0 + f64::from(j % 3));
        let mut contour: Vec<DVec2> = (0..40).map(point).collect();
        assert!(angle_jumps_mm(&contour).all(|jump| jump < 1e-12));
        assert_eq!(angle_jumps_mm(&contour).count(), 38);
        contour[7] = DVec2::NAN;
        assert_eq!(angle_jumps_mm(&contour).count(), 35);
    }
}
