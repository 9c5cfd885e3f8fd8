// Per node: the points kept on the triangles about it, and their mean |distance|. Per cylinder: all points
// kept, and all points in the section.

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> statistics: array<TriangleStatistic>;
@group(0) @binding(2) var<storage, read_write> support: array<u32>;
@group(0) @binding(3) var<storage, read_write> residuals: array<f32>;
@group(0) @binding(4) var<storage, read_write> tallies: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read> offsets: array<u32>;

var<workgroup> own_kept: atomic<u32>;

struct Sum {
    count: u32,
    total: f32,
}

fn plus(sum: Sum, triangle: u32) -> Sum {
    let s = statistics[triangle];
    return Sum(sum.count + s.kept, sum.total + f32(s.kept) * s.residual);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    if (local == 0u) {
        atomicStore(&own_kept, 0u);
    }
    workgroupBarrier();
    let node = workgroup_index(group, groups) * 64u + local;
    let cylinder = group.z;
    let bottom = 2u * cylinder * job.faces;
    let top = bottom + job.faces;
    if (node < job.node_count) {
        let ring = node / job.nodes;
        let j = node % job.nodes;
        let before = select(j, job.nodes, j == 0u) - 1u;
        var sum = Sum(0u, 0.0);
        if (ring > 0u) {
            let row = (ring - 1u) * job.nodes;
            sum = plus(sum, top + row + before);
            sum = plus(sum, bottom + row + before);
            sum = plus(sum, top + row + j);
        }
        if (ring < job.levels) {
            let row = ring * job.nodes;
            sum = plus(sum, bottom + row + before);
            sum = plus(sum, top + row + j);
            sum = plus(sum, bottom + row + j);
        }
        support[cylinder * job.node_count + node] = sum.count;
        residuals[cylinder * job.node_count + node] = sum.total / f32(max(1u, sum.count));
    }
    if (node < job.faces) {
        atomicAdd(&own_kept, statistics[bottom + node].kept + statistics[top + node].kept);
    }
    workgroupBarrier();
    if (local == 0u) {
        atomicAdd(&tallies[2u * cylinder], atomicLoad(&own_kept));
    }
    if (node == 0u) {
        let first = cylinder * job.faces;
        atomicStore(&tallies[2u * cylinder + 1u], offsets[first + job.faces] - offsets[first]);
    }
}
