// Multigrid on the way to coarser grids: two relaxations from values of zero, and what these leave of the right-hand side
// shared out to the next coarser grid. A workgroup per tile.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> levels: array<Level>;
@group(0) @binding(3) var<storage, read> rows: array<vec4f>;
@group(0) @binding(4) var<storage, read> own: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> rights: array<f32>;
@group(0) @binding(6) var<storage, read_write> values: array<f32>;

// The coarser grid needs what is left on two nodes before the tile; each relaxation, and that, depend on two more
// to all sides.
const LOW = 6u;
const HIGH = 4u;
const_assert DESCEND_COLUMNS == TILE_COLUMNS - LOW - HIGH;
const PLACES = TILE_COLUMNS * (LOW + TILE_RINGS + HIGH);

// The values after the first relaxation, then what is left; and behind them those after the second.
var<workgroup> cells: array<f32, 2u * PLACES>;
var<private> tile: Tile;

// The value of what is left at the u-th finer node about a coarser one.
fn fine_value(fine: Level, coarse: Level, ring: u32, u: u32, j: u32) -> f32 {
    // The same as `candidate`, but not around the axis.
    let two_on = select(2u * j + u, j + 2u, fine.nodes == coarse.nodes);
    return cells[TILE_COLUMNS * (ring + LOW - tile.ring) + (two_on + LOW - 2u - tile.node)];
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
    if (state.done != 0u || index >= tile_count(level, DESCEND_COLUMNS)) {
        return;
    }
    let rings = tile_rings(level);
    let rows_of_tile = LOW + rings + HIGH;
    tile = tile_of(level, index, DESCEND_COLUMNS, LOW);
    let column = local % TILE_COLUMNS;
    let quarter = local / TILE_COLUMNS;
    let j = node_of(level, tile, column);
    if (column < tile.end + HIGH) {
        for (var row = quarter; row < rows_of_tile; row += 4u) {
            let k = ring_of(tile, row);
            if (k < level.rings) {
                let node = level.first + k * level.nodes + j;
                cells[TILE_COLUMNS * row + column] = (parameters.first_relaxation * own[node].y) * rights[node];
            }
        }
    }
    workgroupBarrier();
    if (column >= 2u && column < tile.end + HIGH - 2u) {
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
                let x = relaxed(level, k, at.here, c, s, parameters.second_relaxation);
                cells[PLACES + place] = x;
                if (row >= LOW && row < LOW + rings && column >= LOW && column < tile.end) {
                    values[at.here] = x;
                }
            }
        }
    }
    workgroupBarrier();
    if (column >= 4u && column < tile.end + HIGH - 4u) {
        let quarter_rows = (rows_of_tile - 8u + 3u) / 4u;
        let start = 4u + quarter_rows * quarter;
        var s = stencil_below(PLACES + TILE_COLUMNS * start + column);
        for (var row = start; row < min(start + quarter_rows, rows_of_tile - 4u); row++) {
            let place = TILE_COLUMNS * row + column;
            let k = ring_of(tile, row);
            s = climbed(s, PLACES + place);
            if (k < level.rings) {
                let at = places_of(level, k, j);
                var c: Couplings;
                if (level.first == 0u) {
                    c = couplings_at(k, at, level.nodes);
                }
                cells[place] = left_at(level, k, at.here, c, s);
            }
        }
    }
    workgroupBarrier();
    // The coarser nodes on the tile: every second one of a finer row or column, or every one. The last ring may lie
    // beyond the last of the finer ones.
    let rings_halved = coarse.rings != level.rings;
    let nodes_halved = coarse.nodes != level.nodes;
    let first_k = select(tile.ring, tile.ring / 2u, rings_halved);
    let first_j = select(tile.node, tile.node / 2u, nodes_halved);
    let more_k = select(rings, rings / 2u, rings_halved);
    let more_j = select(DESCEND_COLUMNS, DESCEND_COLUMNS / 2u, nodes_halved);
    let end_k = select(first_k + more_k, coarse.rings, tile.ring + rings >= level.rings);
    let end_j = min(first_j + more_j, coarse.nodes);
    let across = select(64u, 32u, nodes_halved);
    let coarse_j = first_j + local % across;
    if (coarse_j < end_j) {
        for (var k = first_k + local / across; k < end_k; k += 256u / across) {
            rights[coarse.first + k * coarse.nodes + coarse_j] = restricted(level, coarse, k, coarse_j);
        }
    }
}
