// Multigrid on the way back: the values of a grid are corrected by those of the next coarser one and relaxed twice; on the
// finest grid also their scalar product with the right-hand side. A workgroup per tile.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> rows: array<vec4f>;
@group(0) @binding(4) var<storage, read> own: array<vec2f>;
@group(0) @binding(5) var<storage, read> rights: array<f32>;
@group(0) @binding(6) var<storage, read> values: array<f32>;
// The cycle's results.
@group(0) @binding(7) var<storage, read_write> results: array<f32>;
@group(0) @binding(8) var<storage, read_write> squares: array<f32>;

// Each relaxation depends on two more nodes to all sides.
const MARGIN = 4u;
const_assert ASCEND_COLUMNS == TILE_COLUMNS - 2u * MARGIN;
const PLACES = TILE_COLUMNS * (TILE_RINGS + 2u * MARGIN);

// The corrected values, and behind them those after the first of the two relaxations.
var<workgroup> cells: array<f32, 2u * PLACES>;

fn coarse_value(node: u32) -> f32 {
    return results[node];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let level = levels[0];
    let coarse = levels[1];
    let index = workgroup_index(group, groups);
    if (state.done != 0u || index >= tile_count(level, ASCEND_COLUMNS)) {
        return;
    }
    let rings = tile_rings(level);
    let rows_of_tile = rings + 2u * MARGIN;
    let tile = tile_of(level, index, ASCEND_COLUMNS, MARGIN);
    let column = local % TILE_COLUMNS;
    let quarter = local / TILE_COLUMNS;
    let j = node_of(level, tile, column);
    let share = share_of(j, level.nodes, coarse.nodes, true);
    if (column < tile.end + MARGIN) {
        for (var row = quarter; row < rows_of_tile; row += 4u) {
            let k = ring_of(tile, row);
            if (k < level.rings) {
                let correction = interpolated(coarse, share_of(k, level.rings, coarse.rings, false), share);
                cells[TILE_COLUMNS * row + column] = values[level.first + k * level.nodes + j] + correction;
            }
        }
    }
    workgroupBarrier();
    if (column >= 2u && column < tile.end + MARGIN - 2u) {
        let quarter_rows = (rows_of_tile - 4u + 3u) / 4u;
        let start = 2u + quarter_rows * quarter;
        var s = stencil_below(TILE_COLUMNS * start + column);
        for (var row = start; row < min(start + quarter_rows, rows_of_tile - 2u); row++) {
            let place = TILE_COLUMNS * row + column;
            let k = ring_of(tile, row);
            s = climbed(s, place);
            if (k < level.rings) {
                let at = places_of(level, k, j);
                var c: Couplings;
                if (level.first == 0u) {
                    c = couplings_at(k, at, level.nodes);
                }
                cells[PLACES + place] = relaxed(level, k, at.here, c, s, parameters.second_relaxation);
            }
        }
    }
    workgroupBarrier();
    var square = 0.0;
    if (column >= MARGIN && column < tile.end) {
        let quarter_rows = (rings + 3u) / 4u;
        let start = MARGIN + quarter_rows * quarter;
        var s = stencil_below(PLACES + TILE_COLUMNS * start + column);
        for (var row = start; row < min(start + quarter_rows, MARGIN + rings); row++) {
            let k = ring_of(tile, row);
            s = climbed(s, PLACES + TILE_COLUMNS * row + column);
            if (k < level.rings) {
                let at = places_of(level, k, j);
                var c: Couplings;
                if (level.first == 0u) {
                    c = couplings_at(k, at, level.nodes);
                }
                let x = relaxed(level, k, at.here, c, s, parameters.first_relaxation);
                results[at.here] = x;
                square += rights[at.here] * x;
            }
        }
    }
    if (level.first == 0u) {
        let sum = sum_of_workgroup(square, 256u, local);
        if (local == 0u) {
            squares[index] = sum;
        }
    }
}
