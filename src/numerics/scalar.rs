//! The numbers that a computation runs in: f32 or f64. The f32 half is the twin of `shaders/common/scalar.wgsl`.

use super::angle::angle;
use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A floating-point type that a fit computes in: f32 as on the device, f64 as the reference.
///
/// Besides arithmetic it has three operations whose results must not depend on the order of a triangle's points or
/// on the platform: an integer key that sorts like the number, an exact sum, and the arc tangent.
pub trait Scalar:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + 'static
{
    /// An integer that sorts like the number (without NaN).
    type Key: Copy + Ord + Send + Sync;
    /// A fixed-point sum: exact, so the same in every order.
    type Sum: Copy + Default + Add<Output = Self::Sum> + Neg<Output = Self::Sum> + PartialOrd + Send + Sync;

    /// Bits of the largest distance as a fixed-point number of scale
    /// [`fixed_point_scale`](Self::fixed_point_scale).
    const FIXED_POINT_BITS: i32;

    /// The nearest number.
    fn from_f64(x: f64) -> Self;
    /// The number of a count below 2³².
    fn from_count(n: u32) -> Self;
    /// The same number in f64.
    fn to_f64(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// |x|.
    fn abs(self) -> Self;
    /// The integer part of a number that is not negative, at most `u32::MAX`.
    fn floor_to_u32(self) -> u32;
    /// The angle of (x, y) in [0, 2π); 0 at the origin.
    fn angle(y: Self, x: Self) -> Self;
    /// The sorting key of the number.
    fn key(self) -> Self::Key;
    /// The number of a sorting key.
    fn from_key(key: Self::Key) -> Self;
    /// The number in units of 1/scale, cut towards zero.
    fn to_fixed(self, scale: Self) -> Self::Sum;
    /// The mean of `count` numbers from their fixed-point sum in units of `unit` = 1/scale.
    fn mean_of(sum: Self::Sum, unit: Self, count: u32) -> Self;

    /// A power of two that brings numbers up to `bound` into the range of a fixed-point number.
    fn fixed_point_scale(bound: f64) -> Self {
        let exponent = Self::FIXED_POINT_BITS - bound.log2().ceil() as i32;
        Self::from_f64(2.0_f64.powi(exponent))
    }
}

impl Scalar for f32 {
    type Key = i32;
    type Sum = i64;
    const FIXED_POINT_BITS: i32 = 30;

    #[inline(always)]
    fn from_f64(x: f64) -> f32 {
        x as f32
    }
    #[inline(always)]
    fn from_count(n: u32) -> f32 {
        n as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn sqrt(self) -> f32 {
        f32::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> f32 {
        f32::abs(self)
    }
    #[inline(always)]
    fn floor_to_u32(self) -> u32 {
        self as u32
    }
    #[inline(always)]
    fn angle(y: f32, x: f32) -> f32 {
        angle(y, x)
    }
    #[inline(always)]
    fn key(self) -> i32 {
        let bits = self.to_bits() as i32;
        // The largest key marks an empty place on the device: no number has it, and no NaN gets it.
        (bits ^ ((bits >> 31) & i32::MAX)).min(i32::MAX - 1)
    }
    #[inline(always)]
    fn from_key(key: i32) -> f32 {
        f32::from_bits((key ^ ((key >> 31) & i32::MAX)) as u32)
    }
    #[inline(always)]
    fn to_fixed(self, scale: f32) -> i64 {
        i64::from((self * scale) as i32)
    }
    /// Sign and magnitude in two 32-bit halves, as the device holds it.
    #[inline(always)]
    fn mean_of(sum: i64, unit: f32, count: u32) -> f32 {
        let magnitude = sum.unsigned_abs();
        let (high, low) = ((magnitude >> 32) as u32, magnitude as u32);
        let mean = (high as f32 * 4294967296.0 + low as f32) * unit / count as f32;
        if sum < 0 { -mean } else { mean }
    }
}

impl Scalar for f64 {
    type Key = i64;
    type Sum = i128;
    const FIXED_POINT_BITS: i32 = 70;

    #[inline(always)]
    fn from_f64(x: f64) -> f64 {
        x
    }
    #[inline(always)]
    fn from_count(n: u32) -> f64 {
        f64::from(n)
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> f64 {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> f64 {
        f64::abs(self)
    }
    #[inline(always)]
    fn floor_to_u32(self) -> u32 {
        self as u32
    }
    #[inline(always)]
    fn angle(y: f64, x: f64) -> f64 {
        use std::f64::consts::TAU;
        let angle = y.atan2(x);
        let full = if angle < 0.0 { angle + TAU } else { angle };
        // Also turns the -0 of atan2 into 0.
        if full >= TAU { 0.0 } else { full + 0.0 }
    }
    #[inline(always)]
    fn key(self) -> i64 {
        let bits = self.to_bits() as i64;
        bits ^ ((bits >> 63) & i64::MAX)
    }
    #[inline(always)]
    fn from_key(key: i64) -> f64 {
        f64::from_bits((key ^ ((key >> 63) & i64::MAX)) as u64)
    }
    #[inline(always)]
    fn to_fixed(self, scale: f64) -> i128 {
        (self * scale) as i128
    }
    #[inline(always)]
    fn mean_of(sum: i128, unit: f64, count: u32) -> f64 {
        sum as f64 * unit / f64::from(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_is_right_to_two_ulp_over_the_full_circle() {
        let mut worst: f64 = 0.0;
        for i in 0..2_000_000_u32 {
            let direction = f64::from(i) * (std::f64::consts::TAU / 2_000_000.0);
            let length = [1e-3, 0.7, 13.0, 400.0][i as usize % 4];
            let (y, x) = ((direction.sin() * length) as f32, (direction.cos() * length) as f32);
            let exact = f64::angle(f64::from(y), f64::from(x));
            let found = f64::from(f32::angle(y, x));
            // Below π/4 the ULP is the result's own; beyond, that of the quadrant it was folded from.
            let ulp = f64::from((exact as f32).next_up() - exact as f32);
            worst = worst.max((found - exact).abs() / ulp);
        }
        assert!(worst <= 2.0, "{worst} ULP");
    }

    #[test]
    fn the_angle_at_the_axes_and_the_seam() {
        use std::f32::consts::{FRAC_PI_2, PI, TAU};
        assert_eq!(f32::angle(0.0, 1.0), 0.0);
        assert_eq!(f32::angle(1.0, 0.0), FRAC_PI_2);
        assert_eq!(f32::angle(0.0, -1.0), PI);
        assert_eq!(f32::angle(-1.0, 0.0), TAU - FRAC_PI_2);
        assert_eq!(f32::angle(0.0, 0.0), 0.0);
        // Just below the seam: never 2π itself.
        assert_eq!(f32::angle(-1e-30, 1.0), 0.0);
        assert_eq!(f64::angle(-1e-300, 1.0), 0.0);
        assert_eq!(f64::angle(-0.0, 1.0).to_bits(), 0);
    }

    #[test]
    fn keys_sort_like_numbers_and_give_them_back() {
        let numbers = [f32::MIN, -1.5, -f32::MIN_POSITIVE, -1e-45, 0.0, 1e-45, 0.5, 1.5, f32::MAX];
        for pair in numbers.windows(2) {
            assert!(pair[0].key() < pair[1].key());
            assert!(f64::from(pair[0]).key() < f64::from(pair[1]).key());
        }
        for x in numbers {
            assert_eq!(f32::from_key(x.key()).to_bits(), x.to_bits());
            assert_eq!(f64::from_key(f64::from(x).key()).to_bits(), f64::from(x).to_bits());
        }
    }

    #[test]
    fn fixed_point_means_are_exact_to_a_step() {
        let scale = f32::fixed_point_scale(40.0);
        assert_eq!(scale, 2.0_f32.powi(24));
        let values = [-1.25_f32, 3.5, 0.125, -20.0];
        let sum = values.iter().map(|v| v.to_fixed(scale)).sum::<i64>();
        assert_eq!(f32::mean_of(sum, 1.0 / scale, 4), -4.40625);
        let many: i64 = (0..100_000).map(|_| (-30.0_f32).to_fixed(scale)).sum();
        assert_eq!(f32::mean_of(many, 1.0 / scale, 100_000), -30.0);
    }
}
