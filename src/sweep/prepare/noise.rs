//! Noise of contours along the wall, and the bias that it causes.

use crate::numerics::robust::{SD_PER_MAD, median_size};
use crate::recording::echo_error::angle_jumps_mm;
use glam::DVec2;
use rayon::prelude::*;

/// Standard deviation of the noise along the wall in units of the median [angle jump](angle_jumps_mm): jumps have six
/// times its variance.
pub(in crate::sweep) const TANGENTIAL_PER_JUMP: f64 = SD_PER_MAD / 2.449_489_742_783_178;

/// Points whose jumps tell the noise along the wall to half a percent.
const ENOUGH_POINTS: usize = 100_000;

/// Standard deviation of the contours' noise along the wall, mm; from evenly chosen ones, where there are more than enough.
pub(in crate::sweep) fn tangential_noise_mm(contours_mm: &[&[DVec2]]) -> f64 {
    let points: usize = contours_mm.iter().map(|contour_mm| contour_mm.len()).sum();
    let chosen = contours_mm.par_iter().step_by((points / ENOUGH_POINTS).max(1));
    let jumps: Vec<f64> = chosen.flat_map_iter(|contour_mm| angle_jumps_mm(contour_mm)).collect();
    TANGENTIAL_PER_JUMP * median_size(&jumps)
}

/// The most that [`tangential_noise_mm`] is believed: what it finds on a round wall of `radius_mm` where noise is as large in all
/// directions, and echoes have the standard deviation `noise_mm` about the wall. Points without even angles show more.
///
/// For a noise that is not small against the radius, angles exaggerate it and distances from the wall understate it; the ratio of
/// the two was found from simulated circles.
pub(in crate::sweep) fn most_tangential_mm(noise_mm: f64, radius_mm: f64) -> f64 {
    let square = (noise_mm / radius_mm).min(MAX_NOISE_RADII).powi(2);
    noise_mm * (1.0 + 0.5 * square + 1.25 * square * square)
}

/// Noise is corrected as if it were this share of the radius where it is more.
const MAX_NOISE_RADII: f64 = 0.6;

/// How far noise along a round wall moves its echoes out, mm, where they lie about `radius_mm`.
///
/// With a noise σ in all directions, echoes of a circle of radius r lie about √(r² + σ²), so σ²/2r outside it while σ is small.
/// The noise is the [tangential one](tangential_noise_mm), whose square counts k = 1 + 0.63 (σ/radius)² times: found from simulated
/// circles, on which 0.4 % of the radius is left at most for σ up to half of it.
pub(crate) fn outward_bias_mm(radius_mm: f64, tangential_noise_mm: f64) -> f64 {
    let square = (tangential_noise_mm / radius_mm.abs().max(f64::MIN_POSITIVE)).min(MAX_NOISE_RADII).powi(2);
    let wider = (1.0 + (1.0 + 0.63 * square) * square).sqrt();
    radius_mm.abs() * (1.0 - wider.recip())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::robust::{huber_weight, median};
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    const RADIUS_MM: f64 = 2.0;

    /// Noisy contours of a circle: noise along the wall, noise about it and the radius about which a robust fit finds them, mm.
    fn noisy_circle(noise_mm: f64) -> [f64; 3] {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let contours_mm: Vec<Vec<DVec2>> = (0..800)
            .map(|_| {
                let wall = |j: i32| DVec2::from_angle(f64::from(j) / 90.0 * TAU) * RADIUS_MM;
                (0..90).map(|j| wall(j) + DVec2::new(normal(), normal()) * noise_mm).collect()
            })
            .collect();
        let of_frames: Vec<&[DVec2]> = contours_mm.iter().map(|contour| &contour[..]).collect();
        let radii: Vec<f64> = contours_mm.iter().flatten().map(|p| p.length()).collect();
        let mut radius = median(&mut radii.clone());
        let mut about = 0.0;
        for _ in 0..40 {
            about = SD_PER_MAD * median(&mut radii.iter().map(|r| (r - radius).abs()).collect::<Vec<_>>());
            let weighted = radii.iter().map(|r| (huber_weight(about, (r - radius).abs()), r));
            let [sum, weights] = weighted.fold([0.0; 2], |[sum, weights], (w, r)| [sum + w * r, weights + w]);
            radius = sum / weights;
        }
        [tangential_noise_mm(&of_frames), about, radius]
    }

    #[test]
    fn noise_up_to_half_of_the_radius_leaves_no_bias() {
        for share in [0.05, 0.1, 0.2, 0.3, 0.4, 0.5] {
            let [along_mm, about_mm, radius_mm] = noisy_circle(share * RADIUS_MM);
            let most_mm = most_tangential_mm(about_mm, RADIUS_MM);
            assert!(
                (most_mm / along_mm - 1.0).abs() < 0.02,
                "{share}: {along_mm} mm along, {most_mm} mm at most"
            );
            let left_mm = radius_mm - outward_bias_mm(radius_mm, along_mm.min(most_mm)) - RADIUS_MM;
            assert!(left_mm.abs() < 0.004 * RADIUS_MM, "{share}: {left_mm} mm left");
            // The first order alone leaves more where noise is large.
            let first_mm = radius_mm - along_mm.powi(2) / (2.0 * radius_mm) - RADIUS_MM;
            assert!(
                share < 0.35 || left_mm.abs() < 0.5 * first_mm.abs(),
                "{share}: {left_mm}, {first_mm} mm"
            );
        }
    }

    #[test]
    fn without_noise_or_radius_there_is_no_bias() {
        assert_eq!(outward_bias_mm(3.0, 0.0), 0.0);
        assert_eq!(outward_bias_mm(0.0, 1.0), 0.0);
        assert_eq!(outward_bias_mm(0.0, 0.0), 0.0);
        assert!(outward_bias_mm(1.0, 50.0) < 1.0 && outward_bias_mm(-1.0, 0.2) > 0.0);
        assert_eq!(most_tangential_mm(0.0, 2.0), 0.0);
    }
}
