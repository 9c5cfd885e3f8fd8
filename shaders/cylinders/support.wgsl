// Per node: the number of points kept on the triangles that meet there, and their mean |distance|. Per
// cylinder: the number of kept points, and of all points in the section.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> triangle_support: array<FaceSupport>;
@group(0) @binding(2) var<storage, read_write> support: array<u32>;
@group(0) @binding(3) var<storage, read_write> residuals: array<f32>;
@group(0) @binding(4) var<storage, read_write> tallies: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read> offsets: array<u32>;

var<workgroup> own_kept: atomic<u32>;

struct FaceSupport {
    bottom: TriangleSupport,
    top: TriangleSupport,
}

struct Sum {
    count: u32,
    total: f32,
}

fn plus(sum: Sum, s: TriangleSupport) -> Sum {
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
    let first_face = cylinder * parameters.faces;
    if (node < parameters.node_count) {
        let ring = node / parameters.nodes;
        let j = node % parameters.nodes;
        let before = select(j, parameters.nodes, j == 0u) - 1u;
        var sum = Sum(0u, 0.0);
        if (ring > 0u) {
            let row = first_face + (ring - 1u) * parameters.nodes;
            let beside = triangle_support[row + before];
            sum = plus(sum, beside.top);
            sum = plus(sum, beside.bottom);
            sum = plus(sum, triangle_support[row + j].top);
        }
        if (ring < parameters.levels) {
            let row = first_face + ring * parameters.nodes;
            let own = triangle_support[row + j];
            sum = plus(sum, triangle_support[row + before].bottom);
            sum = plus(sum, own.top);
            sum = plus(sum, own.bottom);
        }
        support[cylinder * parameters.node_count + node] = sum.count;
        residuals[cylinder * parameters.node_count + node] = sum.total / f32(max(1u, sum.count));
    }
    if (node < parameters.faces) {
        let own = triangle_support[first_face + node];
        atomicAdd(&own_kept, own.bottom.kept + own.top.kept);
    }
    workgroupBarrier();
    if (local == 0u) {
        atomicAdd(&tallies[2u * cylinder], atomicLoad(&own_kept));
    }
    if (node == 0u) {
        atomicStore(&tallies[2u * cylinder + 1u], offsets[first_face + parameters.faces] - offsets[first_face]);
    }
}
