//! What the thesis prints, as far as its numbers are at hand.

/// Median fitting error of the single cylinders before the fit and after iterations 1 to 3, mm (Table 4).
pub const TABLE_4_MEDIAN_MM: [f64; 4] = [0.650, 0.477, 0.465, 0.472];

/// Mean fitting error of the frustum after 3 iterations, mm (Table 2).
pub const FRUSTUM_MEAN_MM_AFTER_3: f64 = 0.0751;

/// Why ours differ from these.
pub const WHAT_DIFFERS: &str = "The thesis measured in vessels segmented from patients; these are not public, so its \
    numbers come from other vessels, another insertion and other noise than ours. Compare the course of a row, not its \
    digits.";
