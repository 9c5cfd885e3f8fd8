//! How long things took, for benches.

/// Percentiles of durations in milliseconds, in words.
pub fn percentiles(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    let rank = |share: f64| values[((share * values.len() as f64).ceil() as usize).max(1) - 1];
    format!("p50 {:.3}, p95 {:.3}, p99 {:.3}, max {:.3} ms", rank(0.5), rank(0.95), rank(0.99), rank(1.0))
}
