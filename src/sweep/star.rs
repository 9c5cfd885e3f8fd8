//! Whether a contour can be held by radii about its centre.

use super::median;
use glam::DVec2;
use std::f64::consts::TAU;

/// Folded shares up to this are borne: the carina of a bifurcation pokes past the centre of the contour about it.
pub(super) const MOST_FOLDED: f64 = 0.2;

/// By how much a contour turns back about its centroid: the area swept backwards by the ray from there to the contour,
/// as a share of that swept forwards. 0 where the lumen is star-shaped about it: every ray from there meets the wall
/// once.
///
/// Noise makes every contour of many points turn back from point to point; so points are first averaged with as many
/// neighbours as their noise asks for.
pub(super) fn folded_share(contour_mm: &[DVec2], centroid_mm: DVec2) -> f64 {
    let points: Vec<DVec2> = contour_mm.iter().filter(|p| !p.is_nan()).map(|&p| p - centroid_mm).collect();
    let count = points.len();
    if count < 3 {
        return 0.0;
    }
    let around = |i: usize, offset: usize| points[(i + offset) % count];
    // Second differences of noise have six times its variance; those of a smooth curve are next to nothing.
    let mut bends: Vec<f64> =
        (0..count).map(|i| (points[i] + around(i, 2) - around(i, 1) * 2.0).length()).collect();
    // Of two normal numbers of variance one, the median length is 1.18.
    let noise = median(&mut bends) / 1.18 / 6.0_f64.sqrt();
    // From point to point the mean of 2h + 1 points moves by noise·√2/(2h + 1); the contour, if it were a circle, by its
    // length over the number of points. Let the former be a quarter of the latter.
    let twice_area: f64 = (0..count).map(|i| points[i].perp_dot(around(i, 1))).sum();
    let step = (twice_area.abs() / TAU).sqrt() * TAU / count as f64;
    let width = 4.0 * 2.0_f64.sqrt() * noise / step.max(f64::MIN_POSITIVE);
    let reach = ((width - 1.0) / 2.0).ceil().clamp(0.0, count as f64 / 8.0);
    let reach = reach as usize;
    let smooth: Vec<DVec2> = (0..count)
        .map(|i| {
            (0..=2 * reach).map(|k| around(i, count - reach + k)).sum::<DVec2>() / (2 * reach + 1) as f64
        })
        .collect();
    let (mut forwards, mut backwards) = (0.0, 0.0);
    for i in 0..count {
        let area = smooth[i].perp_dot(smooth[(i + 1) % count]);
        if area > 0.0 { forwards += area } else { backwards -= area }
    }
    forwards.min(backwards) / forwards.max(backwards).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// 120 points at `r(θ)`, each moved by noise.
    fn contour(r: impl Fn(f64) -> f64, noise: f64) -> Vec<DVec2> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut shake =
            || (rng.random::<f64>() + rng.random::<f64>() + rng.random::<f64>() - 1.5) * 2.0 * noise;
        (0..120)
            .map(|i| f64::from(i) / 120.0 * TAU)
            .map(|a| DVec2::from_angle(a) * r(a) + DVec2::new(shake(), shake()))
            .collect()
    }

    /// A lumen bent round the origin, from 2 to 3 mm away from it, over `angle` rad.
    fn horseshoe(angle: f64) -> Vec<DVec2> {
        let arc = |radius: f64, j: i32| DVec2::from_angle(f64::from(j) / 60.0 * angle) * radius;
        (0..60).map(|j| arc(3.0, j)).chain((0..60).rev().map(|j| arc(2.0, j))).collect()
    }

    fn share(contour: &[DVec2]) -> f64 {
        let frame = crate::recording::Frame {
            world_from_sensor: crate::geometry::Pose::IDENTITY,
            time_s: None,
            contour_mm: contour.to_vec(),
            cylinder: None,
        };
        folded_share(contour, frame.centroid_mm().unwrap())
    }

    #[test]
    fn what_is_star_shaped_is_not_folded() {
        let slit = |a: f64| 1.0 / (a.cos() / 3.5).hypot(a.sin() / 0.5);
        let lobes = |a: f64| 3.0 + (3.0 * a).cos();
        assert_eq!(share(&contour(|_| 3.0, 0.0)), 0.0);
        assert_eq!(share(&contour(slit, 0.0)), 0.0);
        assert_eq!(share(&contour(lobes, 0.0)), 0.0);
        let mut reversed = contour(lobes, 0.0);
        reversed.reverse();
        assert_eq!(share(&reversed), 0.0);
    }

    #[test]
    fn noise_folds_no_contour() {
        // Points 0.16 mm apart that noise moves by up to three times that.
        for noise in [0.05, 0.2, 0.5] {
            let share = share(&contour(|_| 3.0, noise));
            assert!(share < MOST_FOLDED / 4.0, "{noise}: {share}");
        }
    }

    #[test]
    fn a_horseshoe_is_folded_whichever_way_it_is_drawn() {
        for angle in [4.0, 5.0, 6.0] {
            let mut contour = horseshoe(angle);
            assert!(share(&contour) > MOST_FOLDED, "{angle}: {}", share(&contour));
            contour.reverse();
            assert!(share(&contour) > MOST_FOLDED, "{angle}");
        }
    }

    #[test]
    fn too_few_points_fold_nowhere() {
        assert_eq!(folded_share(&[], DVec2::ZERO), 0.0);
        assert_eq!(folded_share(&[DVec2::X, DVec2::Y, DVec2::NAN], DVec2::ZERO), 0.0);
        assert_eq!(folded_share(&[DVec2::X; 9], DVec2::X), 0.0);
    }
}
