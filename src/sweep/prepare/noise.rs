//! Noise of contours along the wall, and the bias that it causes.

use crate::numerics::robust::{SD_PER_MAD, median};
use crate::recording::echo_error::angle_jumps_mm;
use glam::DVec2;
use rayon::prelude::*;

/// Standard deviation of the noise along the wall in units of the median [angle jump](angle_jumps_mm): jumps have six
/// times its variance.
pub(in crate::sweep) const TANGENTIAL_PER_JUMP: f64 = SD_PER_MAD / 2.449_489_742_783_178;

/// Standard deviation of the contours' noise along the wall, mm.
pub(in crate::sweep) fn tangential_noise_mm(contours_mm: &[&[DVec2]]) -> f64 {
    let jumps = contours_mm.par_iter().flat_map_iter(|contour_mm| angle_jumps_mm(contour_mm));
    TANGENTIAL_PER_JUMP * median(&mut jumps.collect::<Vec<_>>())
}

/// Mean outward shift of the echoes of a round wall that noise along the wall causes, mm: half the variance times the
/// curvature.
pub(crate) fn outward_bias_mm(radius_mm: f64, tangential_noise_mm: f64) -> f64 {
    if tangential_noise_mm == 0.0 {
        return 0.0;
    }
    tangential_noise_mm * tangential_noise_mm / (2.0 * radius_mm.abs().max(tangential_noise_mm))
}
