// Inclusive prefix sums over a workgroup of 256 invocations, by doubling steps (Hillis and Steele, 1986).
// Twin: numerics/scan.rs.

var<workgroup> running: array<vec2u, 256>;

// Two prefix sums at once. All invocations must call it. The sums of all others stay in `running` afterwards;
// an invocation that reads them puts a barrier before the next scan.
fn inclusive_scan_of_two(own: vec2u, local: u32) -> vec2u {
    running[local] = own;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var left = vec2u(0u);
        if (local >= step) {
            left = running[local - step];
        }
        workgroupBarrier();
        running[local] += left;
        workgroupBarrier();
    }
    return running[local];
}

fn inclusive_scan(own: u32, local: u32) -> u32 {
    return inclusive_scan_of_two(vec2u(own, 0u), local).x;
}
