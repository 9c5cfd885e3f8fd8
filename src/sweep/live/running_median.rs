//! A running median of values that are added and removed.

use serde::{Deserialize, Serialize};

/// The smallest value that differs from 0.
const MIN: f64 = 1e-9;
/// Bins per factor of e: each is 1 % wide.
const BINS_PER_E: f64 = 100.0;
/// Up to a value of 4e9.
const BINS: usize = 4300;

/// A running median of positive numbers, to 1 %. It counts values in logarithmic bins, so that values can be removed again
/// and neither time nor memory grows with their number.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct RunningMedian {
    counts: Vec<u64>,
    total: u64,
}

impl RunningMedian {
    pub fn new() -> Self {
        Self { counts: vec![0; BINS], total: 0 }
    }

    /// Adds a value and returns its bin, with which it can be removed again.
    pub fn add(&mut self, value: f64) -> u16 {
        let bin = ((value / MIN).ln() * BINS_PER_E).clamp(0.0, (BINS - 1) as f64) as u16;
        self.counts[usize::from(bin)] += 1;
        self.total += 1;
        bin
    }

    /// Removes a value that [`RunningMedian::add`] put into that bin.
    pub fn remove(&mut self, bin: u16) {
        self.counts[usize::from(bin)] -= 1;
        self.total -= 1;
    }

    /// The number of values.
    pub fn count(&self) -> u64 {
        self.total
    }

    /// Whether these values can be removed, by their bins, as often as they come.
    pub fn holds(&self, bins: impl Iterator<Item = u16>) -> bool {
        let mut left = self.counts.clone();
        let is_there = |bin: u16| {
            let count = left.get_mut(usize::from(bin)).filter(|count| **count > 0);
            count.map(|count| *count -= 1).is_some()
        };
        let sum = self.counts.iter().try_fold(0_u64, |sum, count| sum.checked_add(*count));
        self.counts.len() == BINS && sum == Some(self.total) && { bins }.all(is_there)
    }

    /// The upper median; 0 of nothing.
    pub fn value(&self) -> f64 {
        let mut below = 0;
        let bin = self.counts.iter().position(|count| {
            below += count;
            below > self.total / 2
        });
        bin.filter(|&bin| bin > 0).map_or(0.0, |bin| MIN * ((bin as f64 + 0.5) / BINS_PER_E).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_median_to_one_percent_while_values_come_and_go() {
        let mut median = RunningMedian::new();
        assert_eq!(median.value(), 0.0);
        let bins: Vec<u16> = (1..=1000).map(|k| median.add(f64::from(k))).collect();
        assert!((median.value() / 501.0 - 1.0).abs() < 0.01, "{}", median.value());
        bins[..800].iter().for_each(|&bin| median.remove(bin));
        assert!((median.value() / 901.0 - 1.0).abs() < 0.01, "{}", median.value());
        let left = || bins[800..].iter().copied();
        assert!(
            median.holds(left()) && !median.holds(left().chain(left())) && !median.holds([4300].into_iter())
        );
        for odd in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e300] {
            let bin = median.add(odd);
            median.remove(bin);
        }
        assert!((median.value() / 901.0 - 1.0).abs() < 0.01, "{}", median.value());
    }
}
