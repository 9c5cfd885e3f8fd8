// Sums in a fixed order.

var<workgroup> addends: array<f32, 256>;

// The sum of `x` over the workgroup's first `width` invocations, a power of two.
fn sum_of_workgroup(x: f32, width: u32, local: u32) -> f32 {
    addends[local] = x;
    workgroupBarrier();
    for (var half = width / 2u; half > 0u; half /= 2u) {
        if (local < half) {
            addends[local] += addends[local + half];
        }
        workgroupBarrier();
    }
    return addends[0];
}
