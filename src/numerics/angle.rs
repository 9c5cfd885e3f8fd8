//! The arc tangent in f32. Twin: `shaders/common/angle.wgsl`, which takes the coefficients from here.

/// The angle of (x, y) in [0, 2π), rad; 0 at the origin.
///
/// The device has no usable atan2 (up to 4096 ULP are allowed), so both sides evaluate this polynomial:
/// atan(t) = t + t·s·p(s) with s = t², t in [0, 1]; p is a weighted least-squares fit whose own error is
/// 3e-9, evaluated here to about 1 ULP.
#[inline(always)]
pub fn angle(y: f32, x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, PI, TAU};
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ay > ax { (ax, ay) } else { (ay, ax) };
    let t = small / if large > 0.0 { large } else { 1.0 };
    let s = t * t;
    let mut p = ANGLE_COEFFICIENTS[8];
    p = p * s + ANGLE_COEFFICIENTS[7];
    p = p * s + ANGLE_COEFFICIENTS[6];
    p = p * s + ANGLE_COEFFICIENTS[5];
    p = p * s + ANGLE_COEFFICIENTS[4];
    p = p * s + ANGLE_COEFFICIENTS[3];
    p = p * s + ANGLE_COEFFICIENTS[2];
    p = p * s + ANGLE_COEFFICIENTS[1];
    p = p * s + ANGLE_COEFFICIENTS[0];
    let octant = t + t * s * p;
    let quadrant = if ay > ax { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    // An angle just below a full turn rounds to it: the same direction is 0.
    let full = if y < 0.0 { TAU - half } else { half };
    if full >= TAU { 0.0 } else { full }
}

/// The coefficients of p in [`angle`], constant term first.
pub const ANGLE_COEFFICIENTS: [f32; 9] = [
    -0.333_333,
    0.199_985_49,
    -0.142_642_42,
    0.109_521_86,
    -0.084_034_5,
    0.057_957_594,
    -0.031_177_847,
    0.010_914_606,
    -0.001_793_621_8,
];
