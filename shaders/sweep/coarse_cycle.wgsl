// Multigrid: the whole cycle over the coarser grids, by one workgroup in its own memory. The coarsest, a line of a few
// rings, is solved by factors.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> own: array<vec2f>;
@group(0) @binding(4) var<storage, read> rights: array<f32>;
// The cycle's results.
@group(0) @binding(5) var<storage, read_write> results: array<f32>;

// Of all grids: the right-hand sides, and two vectors that take turns.
var<workgroup> right_sides: array<f32, MOST_OF_ONE>;
var<workgroup> cells: array<f32, 2u * MOST_OF_ONE>;

// The first node of these grids.
var<private> base: u32;

fn value(place: u32) -> f32 {
    return cells[place];
}

fn coarse_value(place: u32) -> f32 {
    return cells[place];
}

fn fine_value(fine: Level, coarse: Level, ring: u32, u: u32, j: u32) -> f32 {
    let node = candidate(u, j, fine.nodes, coarse.nodes, true);
    return cells[MOST_OF_ONE + fine.first + ring * fine.nodes + node];
}

// What the vector in one of the two leaves of the right-hand side.
fn left_at(level: Level, place: u32, vector: u32) -> f32 {
    let node = level.first + place;
    var in_vector = level;
    in_vector.first += vector;
    let k = place / level.nodes;
    let s = stencil_at(level, k, places_of(in_vector, k, place % level.nodes), level.nodes);
    return right_sides[node] - (own[base + node].x * s.here + bending(level, k, s));
}

// That vector after a relaxation.
fn relaxed(level: Level, place: u32, vector: u32, relaxation: f32) -> f32 {
    let node = level.first + place;
    return cells[vector + node] + (relaxation * own[base + node].y) * left_at(level, place, vector);
}

// A grid, its first node counted from that of the first of these grids.
fn level_at(l: u32) -> Level {
    var level = levels[l];
    level.first -= base;
    return level;
}

// Solves the coarsest grid, with a bit more on its diagonal so that a wall without echoes has a solution.
fn solve(level: Level) {
    // Per row: the pivot's inverse, its couplings to the next two rows, and these over the pivot.
    var inverse: array<f32, MOST_COARSEST>;
    var one: array<f32, MOST_COARSEST>;
    var two: array<f32, MOST_COARSEST>;
    var next: array<f32, MOST_COARSEST>;
    var next_but_one: array<f32, MOST_COARSEST>;
    var x: array<f32, MOST_COARSEST>;
    var largest = 0.0;
    for (var k = 0u; k < level.rings; k++) {
        largest = max(largest, own[base + level.first + k].x + diagonal(level, k));
    }
    for (var k = 0u; k < level.rings; k++) {
        var pivot = own[base + level.first + k].x + diagonal(level, k) + FLOOR * largest;
        var to_next = -2.0 * (level.along * f32(has_arch(level, k) + has_arch(level, k + 1u)));
        two[k] = level.along * f32(has_arch(level, k + 1u));
        var right = right_sides[level.first + k];
        if (k >= 1u) {
            pivot -= next[k - 1u] * one[k - 1u];
            to_next -= next[k - 1u] * two[k - 1u];
            right -= next[k - 1u] * x[k - 1u];
        }
        if (k >= 2u) {
            pivot -= next_but_one[k - 2u] * two[k - 2u];
            right -= next_but_one[k - 2u] * x[k - 2u];
        }
        one[k] = to_next;
        inverse[k] = 1.0 / pivot;
        next[k] = to_next * inverse[k];
        next_but_one[k] = two[k] * inverse[k];
        x[k] = right;
    }
    for (var left = level.rings; left > 0u; left--) {
        let k = left - 1u;
        var solved = x[k] * inverse[k];
        if (k + 1u < level.rings) {
            solved -= next[k] * x[k + 1u];
        }
        if (k + 2u < level.rings) {
            solved -= next_but_one[k] * x[k + 2u];
        }
        x[k] = solved;
        cells[level.first + k] = solved;
    }
}

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    if (state.done != 0u) {
        return;
    }
    base = levels[0].first;
    let coarser = levels[0].coarser;
    let finest_count = levels[0].count;
    for (var node = local; node < finest_count; node += 256u) {
        let right = rights[base + node];
        right_sides[node] = right;
        cells[MOST_OF_ONE + node] = (parameters.first_relaxation * own[base + node].y) * right;
    }
    workgroupBarrier();
    for (var l = 0u; l < coarser; l++) {
        let level = level_at(l);
        let next = level_at(l + 1u);
        for (var place = local; place < level.count; place += 256u) {
            cells[level.first + place] = relaxed(level, place, MOST_OF_ONE, parameters.second_relaxation);
        }
        workgroupBarrier();
        for (var place = local; place < level.count; place += 256u) {
            cells[MOST_OF_ONE + level.first + place] = left_at(level, place, 0u);
        }
        workgroupBarrier();
        for (var place = local; place < next.count; place += 256u) {
            let node = next.first + place;
            let right = restricted(level, next, place / next.nodes, place % next.nodes);
            right_sides[node] = right;
            cells[MOST_OF_ONE + node] = (parameters.first_relaxation * own[base + node].y) * right;
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        solve(level_at(coarser));
    }
    workgroupBarrier();
    for (var l = coarser; l > 0u; l--) {
        let level = level_at(l - 1u);
        let next = level_at(l);
        for (var place = local; place < level.count; place += 256u) {
            let ring = share_of(place / level.nodes, level.rings, next.rings, false);
            let node = share_of(place % level.nodes, level.nodes, next.nodes, true);
            cells[level.first + place] += interpolated(next, ring, node);
        }
        workgroupBarrier();
        for (var place = local; place < level.count; place += 256u) {
            cells[MOST_OF_ONE + level.first + place] = relaxed(level, place, 0u, parameters.second_relaxation);
        }
        workgroupBarrier();
        for (var place = local; place < level.count; place += 256u) {
            cells[level.first + place] = relaxed(level, place, MOST_OF_ONE, parameters.first_relaxation);
        }
        workgroupBarrier();
    }
    for (var node = local; node < finest_count; node += 256u) {
        results[base + node] = cells[node];
    }
}
