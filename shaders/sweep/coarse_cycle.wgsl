// Multigrid: the whole cycle over the coarser grids, by one workgroup. The coarsest, a line of a few rings, is solved by
// factors.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> own: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> rights: array<f32>;
@group(0) @binding(5) var<storage, read_write> values: array<f32>;
@group(0) @binding(6) var<storage, read_write> others: array<f32>;

// Whether the vector whose product is formed is `others`, and not `values`.
var<private> of_others: bool;

fn value(node: u32) -> f32 {
    if (of_others) {
        return others[node];
    }
    return values[node];
}

fn fine_value(node: u32) -> f32 {
    return others[node];
}

// What the vector leaves of the right-hand side.
fn left_at(level: Level, place: u32) -> f32 {
    let node = level.first + place;
    let of_weight = own[node].x * value(node);
    return rights[node] - (of_weight + bending(level, place / level.nodes, place % level.nodes));
}

// The vector after a relaxation.
fn relaxed(level: Level, place: u32, relaxation: f32) -> f32 {
    let node = level.first + place;
    return value(node) + (relaxation * own[node].y) * left_at(level, place);
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
        largest = max(largest, own[level.first + k].x + diagonal(level, k));
    }
    for (var k = 0u; k < level.rings; k++) {
        var pivot = own[level.first + k].x + diagonal(level, k) + FLOOR * largest;
        var to_next = -2.0 * (level.along * f32(has_arch(level, k) + has_arch(level, k + 1u)));
        two[k] = level.along * f32(has_arch(level, k + 1u));
        var right = rights[level.first + k];
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
        values[level.first + k] = solved;
    }
}

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    if (state.done != 0u) {
        return;
    }
    let coarser = levels[0].coarser;
    for (var l = 0u; l < coarser; l++) {
        let level = levels[l];
        let next = levels[l + 1u];
        of_others = true;
        for (var place = local; place < level.count; place += 256u) {
            values[level.first + place] = relaxed(level, place, parameters.second_relaxation);
        }
        storageBarrier();
        of_others = false;
        for (var place = local; place < level.count; place += 256u) {
            others[level.first + place] = left_at(level, place);
        }
        storageBarrier();
        for (var place = local; place < next.count; place += 256u) {
            let node = next.first + place;
            let right = restricted(level, next, place / next.nodes, place % next.nodes);
            rights[node] = right;
            others[node] = (parameters.first_relaxation * own[node].y) * right;
        }
        storageBarrier();
    }
    if (local == 0u) {
        solve(levels[coarser]);
    }
    storageBarrier();
    for (var l = coarser; l > 0u; l--) {
        let level = levels[l - 1u];
        let next = levels[l];
        for (var place = local; place < level.count; place += 256u) {
            values[level.first + place] += interpolated(level, next, place / level.nodes, place % level.nodes);
        }
        storageBarrier();
        of_others = false;
        for (var place = local; place < level.count; place += 256u) {
            others[level.first + place] = relaxed(level, place, parameters.second_relaxation);
        }
        storageBarrier();
        of_others = true;
        for (var place = local; place < level.count; place += 256u) {
            values[level.first + place] = relaxed(level, place, parameters.first_relaxation);
        }
        storageBarrier();
    }
}
