// Conjugate gradients: whether the residual is small enough; if not, the share β of the last direction in the next, the
// matrix of the equations times that, and the scalar product of both. A workgroup per tile.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read_write> next_step: NextStep;
// Of the residual's square.
@group(0) @binding(3) var<storage, read> partials: array<f32>;
@group(0) @binding(4) var<storage, read> rows: array<vec4f>;
@group(0) @binding(5) var<storage, read> preconditioned: array<f32>;
@group(0) @binding(6) var<storage, read> direction: array<f32>;
@group(0) @binding(7) var<storage, read_write> product: array<f32>;
@group(0) @binding(8) var<storage, read_write> curvatures: array<f32>;

const MARGIN = 2u;
const_assert APPLY_COLUMNS == TILE_COLUMNS - 2u * MARGIN;

// The next direction: `cg_step`, which no longer needs the last one at other nodes, stores it.
var<workgroup> cells: array<f32, TILE_COLUMNS * (TILE_RINGS + 2u * MARGIN)>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let level = finest();
    let index = workgroup_index(group, groups);
    if (state.done != 0u || index >= tile_count(level, APPLY_COLUMNS)) {
        return;
    }
    let square = sum_of_partials(tile_count(level, ASCEND_COLUMNS), local);
    var ends = 0u;
    var beta = 0.0;
    if (square <= state.max_residual_square) {
        ends = CONVERGED;
    } else if (square <= MAX_F32 && state.steps >= parameters.max_steps) {
        ends = EXHAUSTED;
    } else if (square <= MAX_F32) {
        beta = select(0.0, square / state.residual_square, state.residual_square > 0.0);
    } else {
        ends = BROKEN;
    }
    if (index == 0u && local == 0u) {
        next_step = NextStep(ends, square, beta);
    }
    if (ends != 0u) {
        return;
    }
    let rings = tile_rings(level);
    let rows_of_tile = rings + 2u * MARGIN;
    let tile = tile_of(level, index, APPLY_COLUMNS, MARGIN);
    let column = local % TILE_COLUMNS;
    let quarter = local / TILE_COLUMNS;
    let j = node_of(level, tile, column);
    if (column < tile.end + MARGIN) {
        for (var row = quarter; row < rows_of_tile; row += 4u) {
            let k = ring_of(tile, row);
            if (k < level.rings) {
                let node = k * level.nodes + j;
                cells[TILE_COLUMNS * row + column] = preconditioned[node] + beta * direction[node];
            }
        }
    }
    workgroupBarrier();
    var curvature = 0.0;
    if (column >= MARGIN && column < tile.end) {
        let quarter_rows = (rings + 3u) / 4u;
        let start = MARGIN + quarter_rows * quarter;
        var s = stencil_below(TILE_COLUMNS * start + column);
        for (var row = start; row < min(start + quarter_rows, MARGIN + rings); row++) {
            let k = ring_of(tile, row);
            s = climbed(s, TILE_COLUMNS * row + column);
            if (k < level.rings) {
                let at = places_of(level, k, j);
                let x = coupled(level, k, couplings_at(k, at, level.nodes), s) + bending(level, k, s);
                product[at.here] = x;
                curvature += s.here * x;
            }
        }
    }
    let sum = sum_of_workgroup(curvature, 256u, local);
    if (local == 0u) {
        curvatures[index] = sum;
    }
}
