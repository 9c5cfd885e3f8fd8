//! Round numbers for axes and bars.

/// The largest of 1, 2 and 5 times a power of ten that is not above a positive value.
pub(super) fn round_down(value: f64) -> f64 {
    let power = 10_f64.powf(value.log10().floor());
    // A value that rounding has left a hair under a round number counts as that number.
    let digit = value / power * (1.0 + 1e-9);
    power * [5.0, 2.0, 1.0].into_iter().find(|d| *d <= digit).unwrap_or(1.0)
}

/// The step between round numbers and those from `low` to `high`: three to seven or so.
pub(super) fn ticks(low: f64, high: f64) -> (f64, Vec<f64>) {
    let step = round_down((high - low) / 3.0);
    let first = (low / step - 1e-9).ceil();
    let last = (high / step + 1e-9).floor();
    let count = (last - first).clamp(0.0, 20.0) as u32;
    (step, (0..=count).map(|i| (first + f64::from(i)) * step).collect())
}

/// A multiple of `step` with as many decimals as that needs.
pub(in crate::report) fn label(value: f64, step: f64) -> String {
    if !(1e-4..1e6).contains(&step) {
        return format!("{value:.1e}");
    }
    let decimals = (-(step * (1.0 + 1e-9)).log10().floor()).max(0.0) as usize;
    // Zero has no sign.
    format!("{:.decimals$}", if value.abs() < 0.5 * step { 0.0 } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_numbers_are_found_below() {
        for (value, expected) in [(99.0, 50.0), (100.0, 100.0), (1.99, 1.0), (0.0213, 0.02), (7.0, 5.0)] {
            assert!((round_down(value) - expected).abs() < 1e-12, "{value}");
        }
    }

    #[test]
    fn ticks_lie_in_the_range_and_are_labelled_in_full() {
        let (step, at) = ticks(-0.3, 0.62);
        let labels: Vec<String> = at.iter().map(|v| label(*v, step)).collect();
        assert_eq!(labels, ["-0.2", "0.0", "0.2", "0.4", "0.6"]);
        let (step, at) = ticks(0.0, 30.0);
        assert_eq!(at.iter().map(|v| label(*v, step)).collect::<Vec<_>>(), ["0", "10", "20", "30"]);
    }
}
