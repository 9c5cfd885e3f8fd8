// Eight keys of an invocation: what the passes over faces with few points share.

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

// What is known of an invocation's keys, x of all, y of those of the top triangle. `size` has the numbers kept from bit
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
