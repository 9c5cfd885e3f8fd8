// Per node: the number of points kept on the triangles that meet there, and their mean |distance|. Per
// cylinder: the number of kept points, and of all points in the section.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> triangle_support: array<TriangleSupport>;
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
    let s = triangle_support[triangle];
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
    let bottom = 2u * cylinder * parameters.faces;
    let top = bottom + parameters.faces;
    if (node < parameters.node_count) {
        let ring = node / parameters.nodes;
        let j = node % parameters.nodes;
        let before = select(j, parameters.nodes, j == 0u) - 1u;
        var sum = Sum(0u, 0.0);
        if (ring > 0u) {
            let row = (ring - 1u) * parameters.nodes;
            sum = plus(sum, top + row + before);
            sum = plus(sum, bottom + row + before);
            sum = plus(sum, top + row + j);
        }
        if (ring < parameters.levels) {
            let row = ring * parameters.nodes;
            sum = plus(sum, bottom + row + before);
            sum = plus(sum, top + row + j);
            sum = plus(sum, bottom + row + j);
        }
        support[cylinder * parameters.node_count + node] = sum.count;
        residuals[cylinder * parameters.node_count + node] = sum.total / f32(max(1u, sum.count));
    }
    if (node < parameters.faces) {
        atomicAdd(&own_kept, triangle_support[bottom + node].kept + triangle_support[top + node].kept);
    }
    workgroupBarrier();
    if (local == 0u) {
        atomicAdd(&tallies[2u * cylinder], atomicLoad(&own_kept));
    }
    if (node == 0u) {
        let first = cylinder * parameters.faces;
        atomicStore(&tallies[2u * cylinder + 1u], offsets[first + parameters.faces] - offsets[first]);
    }
}
