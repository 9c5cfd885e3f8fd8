// The total of the partial sums of the workgroups of a pass, by one workgroup of 256.

fn sum_of_partials(count: u32, local: u32) -> f32 {
    var own = 0.0;
    for (var i = local; i < count; i += 256u) {
        own += partials[i];
    }
    return sum_of_workgroup(own, 256u, local);
}
