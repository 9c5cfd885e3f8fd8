// Ranks of order statistics, and bounds of the distances that count. Twin: cylinders/fit/passes/filter.rs.

// 0-based ranks of the quartiles of n >= 2 values and of the median of n >= 1 values.
fn first_quartile(n: u32) -> u32 {
    return (n + 3u) / 4u - 1u;
}

fn third_quartile(n: u32) -> u32 {
    return (3u * n + 5u) / 4u - 1u;
}

fn median(n: u32) -> u32 {
    return (n + 2u) / 2u - 1u;
}

// The interval of distances that count, both ends included.
struct Bounds {
    low: f32,
    high: f32,
}

fn box_plot(q1: f32, q3: f32) -> Bounds {
    let reach = 1.5 * (q3 - q1);
    return Bounds(q1 - reach, q3 + reach);
}

fn deviation(mean: f32) -> Bounds {
    let reach = 0.3 * abs(mean);
    return Bounds(mean - reach, mean + reach);
}

const EVERYTHING: Bounds = Bounds(-3.4028234e38, 3.4028234e38);
