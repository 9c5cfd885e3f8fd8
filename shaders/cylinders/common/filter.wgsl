// Keys of a face's distances, ranks of order statistics, and bounds of the distances that count.
// Twin: cylinders/passes/filter.rs.

// One order for both triangles: the keys of all bottom distances sort before those of the top ones, and each
// triangle's like its distances. A key is exact, because a distance is no shorter than the root of the smallest
// number (or 0), the scale of the sums is a power of two, and no distance reaches 2³¹ of its steps. Whatever is
// beyond that, which no gated point is, counts as that far.
fn packed_key(d: f32, top: bool, scale: f32) -> u32 {
    let bits = bitcast<u32>(d * (scale * 9.313225746154785e-10));
    let size = min(bits & 0x7fffffffu, 0x3ffffffeu);
    return select(0x40000000u + size, 0x3fffffffu - size, (bits >> 31u) == 1u) | select(0u, 0x80000000u, top);
}

// Larger than the key of any distance.
const EMPTY: u32 = 0xffffffffu;

// The distance of a key; `unit` is the inverse of the scale.
fn unpacked(key: u32, unit: f32) -> f32 {
    let above = key & 0x7fffffffu;
    let bits = select((0x3fffffffu - above) | 0x80000000u, above - 0x40000000u, above >= 0x40000000u);
    return bitcast<f32>(bits) * (unit * 1073741824.0);
}

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
