// Conjugate gradients: the next direction, and a step along it.

@group(0) @binding(0) var<uniform> parameters: WallParameters;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> preconditioned: array<f32>;
@group(0) @binding(3) var<storage, read> product: array<f32>;
@group(0) @binding(4) var<storage, read_write> direction: array<f32>;
@group(0) @binding(5) var<storage, read_write> change: array<f32>;
@group(0) @binding(6) var<storage, read_write> cg_residual: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let node = workgroup_index(group, groups) * 256u + local;
    if (state.done != 0u || node >= parameters.node_count) {
        return;
    }
    let along = preconditioned[node] + state.beta * direction[node];
    direction[node] = along;
    change[node] += state.alpha * along;
    cg_residual[node] -= state.alpha * product[node];
}
