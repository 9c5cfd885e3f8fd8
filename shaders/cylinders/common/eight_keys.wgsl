// What the passes over faces with few points share: eight keys of an invocation, and a triangle's statistic.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> grouped: array<vec4u>;
@group(0) @binding(4) var<storage, read> radii: array<f32>;
// Face after face, its bottom triangle's and its top one's.
@group(0) @binding(5) var<storage, read_write> triangle_values: array<u32>;
@group(0) @binding(6) var<storage, read_write> triangle_support: array<TriangleSupport>;

struct Keys {
    a: vec4u,
    b: vec4u,
}

// Sorts the keys of each invocation (Batcher's odd-even merge of eight).
fn sort_own(k: Keys) -> Keys {
    let p = vec4u(k.a.x, k.a.z, k.b.x, k.b.z);
    let q = vec4u(k.a.y, k.a.w, k.b.y, k.b.w);
    let l = min(p, q);
    let h = max(p, q);
    let r = vec4u(l.x, h.x, l.z, h.z);
    let s = vec4u(l.y, h.y, l.w, h.w);
    let m = min(r, s);
    let n = max(r, s);
    let inner_low = min(m.yw, n.xz);
    let inner_high = max(m.yw, n.xz);
    let first = vec4u(m.x, inner_low.x, inner_high.x, n.y);
    let second = vec4u(m.z, inner_low.y, inner_high.y, n.w);
    let low = min(first, second);
    let high = max(first, second);
    let t = min(low.zw, high.xy);
    let u = max(low.zw, high.xy);
    let v = vec3u(low.y, t.y, u.y);
    let w = vec3u(t.x, u.x, high.z);
    let e = min(v, w);
    let f = max(v, w);
    return Keys(vec4u(low.x, e.x, f.x, e.y), vec4u(f.y, e.z, f.z, high.w));
}

// Sorts the keys of each invocation where they rise and then fall.
fn merge_own(k: Keys) -> Keys {
    let low = min(k.a, k.b);
    let high = max(k.a, k.b);
    let p = vec4u(low.xy, high.xy);
    let q = vec4u(low.zw, high.zw);
    let m = min(p, q);
    let n = max(p, q);
    let r = vec4u(m.x, n.x, m.z, n.z);
    let s = vec4u(m.y, n.y, m.w, n.w);
    let l = min(r, s);
    let h = max(r, s);
    return Keys(vec4u(l.x, h.x, l.y, h.y), vec4u(l.z, h.z, l.w, h.w));
}

// The key of that rank among the sorted keys of an invocation.
fn own_key_at(k: Keys, rank: u32) -> u32 {
    let four = select(k.a, k.b, (rank & 4u) != 0u);
    let two = select(four.xy, four.zw, (rank & 2u) != 0u);
    return select(two.x, two.y, (rank & 1u) != 0u);
}

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

// The same of an invocation's keys, x of all, y of those of the top triangle. `size` has the numbers kept from bit
// 23 on, since no face has more than 256 keys, and the upper parts of their sizes have 15 bits each.
struct OwnSums {
    below: vec2u,
    low: vec2u,
    high: vec2u,
    low_size: vec2u,
    size: vec2u,
}

const ONE_KEPT: u32 = 0x800000u;

fn add(sums: OwnSums, key: u32, bottom: Bounds, top: Bounds, rule: Cylinder) -> OwnSums {
    let is_top = (key >> 31u) == 1u;
    let d = unpacked(key, rule.unit);
    let low = select(bottom.low, top.low, is_top);
    let high = select(bottom.high, top.high, is_top);
    let is_key = key != EMPTY;
    let kept = is_key && d >= low && d <= high;
    let step = select(0, fixed(d, rule.scale), kept);
    let mask = vec2u(0xffffffffu, select(0u, 0xffffffffu, is_top));
    var own = sums;
    own.low += mask & vec2u(bitcast<u32>(step) & 0xffffu);
    own.high += mask & vec2u(bitcast<u32>(step >> 16u));
    var size = select(0u, ONE_KEPT, kept);
    // Of the sizes only the last iteration's are used.
    if (parameters.last == 1u) {
        own.low_size += mask & vec2u(bitcast<u32>(abs(step)) & 0xffffu);
        size += bitcast<u32>(abs(step)) >> 16u;
    }
    own.size += mask & vec2u(size);
    if (parameters.statistic == STATISTIC_MEDIAN) {
        own.below += mask & vec2u(select(0u, 1u, is_key && d < low));
    }
    return own;
}

// The sums with eight more keys.
fn add_eight(sums: OwnSums, k: Keys, bottom: Bounds, top: Bounds, rule: Cylinder) -> OwnSums {
    var own = add(sums, k.a.x, bottom, top, rule);
    own = add(own, k.a.y, bottom, top, rule);
    own = add(own, k.a.z, bottom, top, rule);
    own = add(own, k.a.w, bottom, top, rule);
    own = add(own, k.b.x, bottom, top, rule);
    own = add(own, k.b.y, bottom, top, rule);
    own = add(own, k.b.z, bottom, top, rule);
    return add(own, k.b.w, bottom, top, rule);
}

// What is known of a face from the sums over its invocations.
fn face_sums(own: OwnSums) -> Sums {
    return Sums(
        apart(own.size / vec2u(ONE_KEPT)),
        apart(own.below),
        apart(own.low),
        apart(own.high),
        apart(own.low_size),
        apart(own.size % vec2u(ONE_KEPT)),
    );
}

// Bottom and top, from both and top.
fn apart(sum: vec2u) -> vec2u {
    return vec2u(sum.x - sum.y, sum.y);
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
