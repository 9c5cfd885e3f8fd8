// The values of the bottom or of the top triangles. A triangle without points takes the mean over its edge
// neighbours, which belong to the other half. The bottom triangles come first: their neighbours contribute
// their own statistic, 0 without points. Then come the top ones, whose neighbours are filled already.

// 0: bottom triangles. 1: top triangles.
override TOP: u32 = 0u;

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> statistics: array<TriangleStatistic>;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;

fn neighbour(triangle: u32) -> f32 {
    if (TOP == 1u) {
        return values[triangle];
    }
    return statistics[triangle].value;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let face = workgroup_index(group, groups) * 64u + local;
    let faces = parameters.faces;
    let nodes = parameters.nodes;
    if (face >= faces) {
        return;
    }
    let own = (2u * group.z + TOP) * faces;
    let other = (2u * group.z + 1u - TOP) * faces;
    var value = statistics[own + face].value;
    if (statistics[own + face].kept == 0u) {
        let j = face % nodes;
        // A bottom triangle has its neighbours on its own face, the next one and the one below; a top
        // triangle on its own face, the previous one and the one above.
        var beside = face - j + select(j + 1u, 0u, j + 1u == nodes);
        var has_third = face >= nodes;
        var third = face - nodes;
        if (TOP == 1u) {
            beside = face - j + select(j, nodes, j == 0u) - 1u;
            has_third = face + nodes < faces;
            third = face + nodes;
        }
        value = neighbour(other + face) + neighbour(other + beside);
        if (has_third) {
            value = (value + neighbour(other + third)) / 3.0;
        } else {
            value = value / 2.0;
        }
    }
    values[own + face] = value;
}
