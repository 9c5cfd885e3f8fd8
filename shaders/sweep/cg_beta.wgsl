// Conjugate gradients: whether the residual is small enough; if not, the share β of the last direction in the
// next. One workgroup.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> state: State;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let square = sum_of_partials(tile_count(finest(), ASCEND_COLUMNS), local);
    if (local == 0u && state.done == 0u) {
        if (square <= state.max_residual_square) {
            state.done = CONVERGED;
        } else if (square <= MAX_F32 && state.steps >= parameters.max_steps) {
            state.done = EXHAUSTED;
        } else if (square <= MAX_F32) {
            state.beta = select(0.0, square / state.residual_square, state.residual_square > 0.0);
            state.residual_square = square;
        } else {
            state.done = BROKEN;
        }
    }
}
