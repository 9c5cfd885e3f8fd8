// Sorting keys and exact sums. Twin: numerics/scalar.rs.

// An unsigned integer that sorts like the number. The largest one marks an empty place: no NaN gets it.
fn key_of(x: f32) -> u32 {
    let bits = bitcast<u32>(x);
    return min(select(bits | 0x80000000u, ~bits, (bits >> 31u) == 1u), 0xfffffffeu);
}

fn number_of(key: u32) -> f32 {
    return bitcast<f32>(select(~key, key & 0x7fffffffu, (key >> 31u) == 1u));
}

// A 64-bit integer in two's complement.
struct Wide {
    low: u32,
    high: u32,
}

fn widen(x: i32) -> Wide {
    return Wide(bitcast<u32>(x), bitcast<u32>(x >> 31u));
}

fn add_wide(a: Wide, b: Wide) -> Wide {
    let low = a.low + b.low;
    return Wide(low, a.high + b.high + select(0u, 1u, low < a.low));
}

// The mean of `count` numbers from their fixed-point sum.
fn mean_of(sum: Wide, unit: f32, count: u32) -> f32 {
    let negative = (sum.high >> 31u) == 1u;
    var magnitude = sum;
    if (negative) {
        magnitude = add_wide(Wide(~sum.low, ~sum.high), Wide(1u, 0u));
    }
    let mean = (f32(magnitude.high) * 4294967296.0 + f32(magnitude.low)) * unit / f32(count);
    return select(mean, -mean, negative);
}

fn fixed(x: f32, scale: f32) -> i32 {
    return i32(x * scale);
}
