// Whether the residual is small enough; if not, how much of the last direction is in the next. One workgroup.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> state: State;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let count = (job.rings * (job.nodes / 2u + 1u) + 255u) / 256u;
    let size = sum_of_partials(count, local);
    if (local == 0u && state.done == 0u) {
        if (size > job.enough) {
            state.turn = select(0.0, size / state.size, state.size > 0.0);
            state.size = size;
        } else {
            state.done = 1u;
        }
    }
}
