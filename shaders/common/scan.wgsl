// Inclusive prefix sums over the first 256 invocations of a workgroup: over sixteen runs of sixteen, then over the
// runs. Few barriers, because each costs a software device as much as hundreds of operations. Twin:
// numerics/scan.rs.

var<workgroup> running: array<vec4u, 256>;
var<workgroup> runs: array<vec4u, 16>;

// Four prefix sums at once. All invocations must call it. The sums of all others stay in `running` afterwards;
// an invocation that reads them puts a barrier before the next scan.
fn inclusive_scan_of_four(own: vec4u, local: u32) -> vec4u {
    let takes_part = local < 256u;
    if (takes_part) {
        running[local] = own;
    }
    workgroupBarrier();
    if (local < 16u) {
        var sum = vec4u(0u);
        for (var i = 16u * local; i < 16u * local + 16u; i++) {
            sum += running[i];
        }
        runs[local] = sum;
    }
    workgroupBarrier();
    var upto = vec4u(0u);
    if (takes_part) {
        let run = local / 16u;
        for (var i = 0u; i < run; i++) {
            upto += runs[i];
        }
        for (var i = 16u * run; i <= local; i++) {
            upto += running[i];
        }
    }
    workgroupBarrier();
    if (takes_part) {
        running[local] = upto;
    }
    workgroupBarrier();
    return upto;
}

fn inclusive_scan(own: u32, local: u32) -> u32 {
    return inclusive_scan_of_four(vec4u(own, 0u, 0u, 0u), local).x;
}
