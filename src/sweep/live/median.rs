//! The median of values that come and go.

/// Least value that is told from zero.
const LEAST: f64 = 1e-9;
/// Bins for a factor of e: they are 1 % wide.
const BINS_PER_E: f64 = 100.0;
/// Up to 4e9.
const BINS: usize = 4300;

/// A running median of positive numbers, to 1 %: counts over logarithmic bins, so that values can be taken out again and
/// neither time nor memory grows with their number.
#[derive(Debug, Clone)]
pub(super) struct Median {
    counts: Vec<u64>,
    total: u64,
}

impl Median {
    pub fn new() -> Self {
        Self { counts: vec![0; BINS], total: 0 }
    }

    /// Adds a value; its bin takes it out again.
    pub fn add(&mut self, value: f64) -> u16 {
        let bin = ((value / LEAST).ln() * BINS_PER_E).clamp(0.0, (BINS - 1) as f64) as u16;
        self.counts[usize::from(bin)] += 1;
        self.total += 1;
        bin
    }

    /// Takes out a value that [`Median::add`] put into that bin.
    pub fn take(&mut self, bin: u16) {
        self.counts[usize::from(bin)] -= 1;
        self.total -= 1;
    }

    /// The upper median; 0 of nothing.
    pub fn value(&self) -> f64 {
        let mut below = 0;
        let bin = self.counts.iter().position(|count| {
            below += count;
            below > self.total / 2
        });
        bin.filter(|&bin| bin > 0).map_or(0.0, |bin| LEAST * ((bin as f64 + 0.5) / BINS_PER_E).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_median_to_one_percent_while_values_come_and_go() {
        let mut median = Median::new();
        assert_eq!(median.value(), 0.0);
        let bins: Vec<u16> = (1..=1000).map(|k| median.add(f64::from(k))).collect();
        assert!((median.value() / 501.0 - 1.0).abs() < 0.01, "{}", median.value());
        bins[..800].iter().for_each(|&bin| median.take(bin));
        assert!((median.value() / 901.0 - 1.0).abs() < 0.01, "{}", median.value());
        for odd in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e300] {
            let bin = median.add(odd);
            median.take(bin);
        }
        assert!((median.value() / 901.0 - 1.0).abs() < 0.01, "{}", median.value());
    }
}
