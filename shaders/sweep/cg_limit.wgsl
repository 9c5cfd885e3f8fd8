// Conjugate gradients: the residual at which they stop, from the size of the right-hand side. One workgroup.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> state: State;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let square = sum_of_partials(tile_count(finest(), ASCEND_COLUMNS), local);
    if (local == 0u) {
        state.max_residual_square = parameters.tolerance_square * square;
    }
}
