// Moves the nodes by the filled values of the triangles that meet there, and sums |travel|. An invocation reads all
// that the values about its node can depend on, 18 triangles, at once: waiting for memory takes longer than what it
// computes twice.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
// Per cylinder those of its bottom triangles, then those of its top ones.
@group(0) @binding(2) var<storage, read> triangle_values: array<u32>;
@group(0) @binding(3) var<storage, read_write> radii: array<f32>;
// Per cylinder: the sum of |travel| in fixed point, low and high word.
@group(0) @binding(4) var<storage, read_write> travels: array<atomic<u32>>;

const THREADS: u32 = 256u;

// The workgroup's sum in parts of 16 bits; the last one has the rest.
var<workgroup> parts: array<atomic<u32>, 3>;

// The mean of the values about a node.
fn travel_of(bottom: u32, ring: u32, j: u32) -> f32 {
    let nodes = parameters.nodes;
    let levels = parameters.levels;
    let top = bottom + parameters.faces;
    let next = select(j + 1u, 0u, j + 1u == nodes);
    let before = select(j, nodes, j == 0u) - 1u;
    let last_but_one = select(before, nodes, before == 0u) - 1u;
    let has_below = ring > 0u;
    let has_above = ring < levels;
    let has_lower = ring > 1u;
    let has_upper = ring + 1u < levels;
    // Levels of faces: below and above the node, and beyond them. One that does not exist is read elsewhere and not
    // used.
    let below = (max(ring, 1u) - 1u) * nodes;
    let above = min(ring, levels - 1u) * nodes;
    let lower = (max(ring, 2u) - 2u) * nodes;
    let upper = min(ring + 1u, levels - 1u) * nodes;
    let top_below = triangle_values[top + below + j];
    let top_below_before = triangle_values[top + below + before];
    let top_above = triangle_values[top + above + j];
    let value_below = value_of(top_below);
    let value_below_before = value_of(top_below_before);
    let value_above = value_of(top_above);
    let value_above_before = value_of(triangle_values[top + above + before]);

    let bottom_below_last = bottom_value(
        triangle_values[bottom + below + last_but_one],
        value_of(triangle_values[top + below + last_but_one]),
        value_below_before,
        value_of(triangle_values[top + lower + last_but_one]),
        has_lower,
    );
    let bottom_below_before = bottom_value(
        triangle_values[bottom + below + before],
        value_below_before,
        value_below,
        value_of(triangle_values[top + lower + before]),
        has_lower,
    );
    let bottom_below = bottom_value(
        triangle_values[bottom + below + j],
        value_below,
        value_of(triangle_values[top + below + next]),
        value_of(triangle_values[top + lower + j]),
        has_lower,
    );
    let bottom_above_before = bottom_value(
        triangle_values[bottom + above + before],
        value_above_before,
        value_above,
        value_below_before,
        has_below,
    );
    let bottom_above = bottom_value(
        triangle_values[bottom + above + j],
        value_above,
        value_of(triangle_values[top + above + next]),
        value_below,
        has_below,
    );
    let bottom_upper = bottom_value(
        triangle_values[bottom + upper + j],
        value_of(triangle_values[top + upper + j]),
        value_of(triangle_values[top + upper + next]),
        value_above,
        true,
    );

    var travel = 0.0;
    if (has_below) {
        let first =
            top_value(top_below_before, bottom_below_before, bottom_below_last, bottom_above_before, has_above);
        let second = top_value(top_below, bottom_below, bottom_below_before, bottom_above, has_above);
        travel = first + bottom_below_before + second;
    }
    if (has_above) {
        let own = top_value(top_above, bottom_above, bottom_above_before, bottom_upper, has_upper);
        travel = select(bottom_above_before, travel + bottom_above_before, has_below) + own + bottom_above;
    }
    return travel / select(3.0, 6.0, has_below && has_above);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    if (local < 3u) {
        atomicStore(&parts[local], 0u);
    }
    workgroupBarrier();
    let cylinder = group.z;
    let scale = cylinders[cylinder].scale;
    let bottom = 2u * cylinder * parameters.faces;
    let first_node = cylinder * parameters.node_count;
    var sum = Wide(0u, 0u);
    // The workgroups take the nodes in turn, so that few of them meet in the two words of `travels`.
    let stride = groups.x * groups.y * THREADS;
    for (var node = workgroup_index(group, groups) * THREADS + local; node < parameters.node_count; node += stride) {
        let ring = node / parameters.nodes;
        let radius = radii[first_node + node];
        let travel = travel_of(bottom, ring, node - ring * parameters.nodes);
        radii[first_node + node] = radius + travel;
        sum = add_wide(sum, widen(fixed(abs(travel), scale)));
    }
    atomicAdd(&parts[0], sum.low & 0xffffu);
    atomicAdd(&parts[1], sum.low >> 16u);
    atomicAdd(&parts[2], sum.high);
    workgroupBarrier();
    if (local == 0u) {
        let middle = atomicLoad(&parts[1]);
        let low = Wide(atomicLoad(&parts[0]), atomicLoad(&parts[2]));
        let all = add_wide(low, Wide(middle << 16u, middle >> 16u));
        let old = atomicAdd(&travels[2u * cylinder], all.low);
        atomicAdd(&travels[2u * cylinder + 1u], all.high + select(0u, 1u, old + all.low < old));
    }
}
