// Conjugate gradients: the next direction, and a step of length α along it. A workgroup per 1024 nodes.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read_write> state: State;
@group(0) @binding(2) var<storage, read> next_step: NextStep;
// Of the curvature.
@group(0) @binding(3) var<storage, read> partials: array<f32>;
@group(0) @binding(4) var<storage, read> preconditioned: array<f32>;
@group(0) @binding(5) var<storage, read> product: array<f32>;
@group(0) @binding(6) var<storage, read_write> direction: array<f32>;
@group(0) @binding(7) var<storage, read_write> change: array<f32>;
@group(0) @binding(8) var<storage, read_write> cg_residual: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = workgroup_index(group, groups);
    if (next_step.ends != 0u) {
        if (index == 0u && local == 0u) {
            state.done = next_step.ends;
        }
        return;
    }
    let curvature = sum_of_partials(tile_count(finest(), APPLY_COLUMNS), local);
    if (!(curvature > 0.0 && curvature <= MAX_F32)) {
        if (index == 0u && local == 0u) {
            state.done = BROKEN;
        }
        return;
    }
    let alpha = next_step.square / curvature;
    let beta = next_step.beta;
    if (index == 0u && local == 0u) {
        state.steps += 1u;
        state.residual_square = next_step.square;
    }
    for (var i = 0u; i < 4u; i++) {
        let node = 1024u * index + 256u * i + local;
        if (node < parameters.node_count) {
            let along = preconditioned[node] + beta * direction[node];
            direction[node] = along;
            change[node] += alpha * along;
            cg_residual[node] -= alpha * product[node];
        }
    }
}
