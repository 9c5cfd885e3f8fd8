// The sum of what the workgroups of a pass have summed up, by one workgroup of 256.

fn sum_of_partials(count: u32, local: u32) -> f32 {
    var own = 0.0;
    for (var i = local; i < count; i += 256u) {
        own += partials[i];
    }
    return sum_of_workgroup(own, 256u, local);
}
