// Conjugate gradients: the length α of the next step. One workgroup.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> state: State;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let curvature = sum_of_partials(tile_count(finest(), APPLY_COLUMNS), local);
    if (local == 0u && state.done == 0u) {
        if (curvature > 0.0 && curvature <= MAX_F32) {
            state.alpha = state.residual_square / curvature;
            state.steps += 1u;
        } else {
            state.done = BROKEN;
        }
    }
}
