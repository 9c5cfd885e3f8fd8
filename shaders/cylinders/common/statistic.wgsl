// A triangle's statistic from sums over the keys of its face, and what the passes bind that write it.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<vec4u>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// Face after face, its bottom triangle's and its top one's.
@group(0) @binding(5) var<storage, read_write> triangle_values: array<u32>;
@group(0) @binding(6) var<storage, read_write> triangle_support: array<TriangleSupport>;

// What is known of a face's keys, of its bottom triangle and its top one.
struct Sums {
    kept: vec2u,
    below: vec2u,
    // Fixed-point sums in two parts: of the lower 16 bits and of the rest.
    low: vec2u,
    high: vec2u,
    low_size: vec2u,
    high_size: vec2u,
}

fn join(low: u32, high: u32) -> Wide {
    let shifted = Wide(high << 16u, bitcast<u32>(bitcast<i32>(high) >> 16u));
    return add_wide(shifted, Wide(low, 0u));
}

fn bounds_of(half: u32, n: u32, quartiles: vec2f, all: Sums, unit: f32) -> Bounds {
    if (n < 2u || parameters.outliers == OUTLIERS_NONE) {
        return EVERYTHING;
    }
    if (parameters.outliers == OUTLIERS_DEVIATION) {
        return deviation(mean_of(join(all.low[half], all.high[half]), unit, n));
    }
    return box_plot(quartiles.x, quartiles.y);
}

fn write_triangle(triangle: u32, half: u32, sums: Sums, median_key: u32, unit: f32) {
    let kept = sums.kept[half];
    var word = NO_VALUE;
    if (kept > 0u) {
        word = value_word(mean_of(join(sums.low[half], sums.high[half]), unit, kept));
        if (parameters.statistic == STATISTIC_MEDIAN) {
            word = value_word(unpacked(median_key, unit));
        }
    }
    triangle_values[triangle] = word;
    if (parameters.last == 1u) {
        var residual = 0.0;
        if (kept > 0u) {
            residual = mean_of(join(sums.low_size[half], sums.high_size[half]), unit, kept);
        }
        triangle_support[triangle] = TriangleSupport(kept, residual);
    }
}
