// Moves the nodes by the filled values of the triangles that meet there, and sums |travel|. An invocation reads all
// that the values about its node can depend on, the triangles of 12 faces, at once: waiting for memory takes longer than what it
// computes twice.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
// Face after face, its bottom triangle's (x) and its top one's (y).
@group(0) @binding(2) var<storage, read> triangle_values: array<vec2u>;
@group(0) @binding(3) var<storage, read_write> radii: array<f32>;
// Per cylinder: the sum of |travel| in fixed point, low and high word.
@group(0) @binding(4) var<storage, read_write> travels: array<atomic<u32>>;

const THREADS: u32 = 256u;

// The workgroup's sum in parts of 16 bits; the last one has the rest.
var<workgroup> parts: array<atomic<u32>, 3>;

// The value of a face's bottom triangle, from its face, the next one and the one below.
fn bottom_of(own: vec2u, next: vec2u, below: vec2u, has_below: bool) -> f32 {
    return bottom_value(own.x, value_of(own.y), value_of(next.y), value_of(below.y), has_below);
}

// The mean of the values about a node.
fn travel_of(first_face: u32, ring: u32, j: u32) -> f32 {
    let nodes = parameters.nodes;
    let levels = parameters.levels;
    let next = select(j + 1u, 0u, j + 1u == nodes);
    let before = select(j, nodes, j == 0u) - 1u;
    let last_but_one = select(before, nodes, before == 0u) - 1u;
    let has_below = ring > 0u;
    let has_above = ring < levels;
    let has_lower = ring > 1u;
    let has_upper = ring + 1u < levels;
    // Levels of faces: below and above the node, and beyond them. One that does not exist is read elsewhere and not
    // used.
    let below = first_face + (max(ring, 1u) - 1u) * nodes;
    let above = first_face + min(ring, levels - 1u) * nodes;
    let lower = first_face + (max(ring, 2u) - 2u) * nodes;
    let upper = first_face + min(ring + 1u, levels - 1u) * nodes;
    let below_last = triangle_values[below + last_but_one];
    let below_before = triangle_values[below + before];
    let below_own = triangle_values[below + j];
    let below_next = triangle_values[below + next];
    let above_before = triangle_values[above + before];
    let above_own = triangle_values[above + j];
    let above_next = triangle_values[above + next];
    let lower_last = triangle_values[lower + last_but_one];
    let lower_before = triangle_values[lower + before];
    let lower_own = triangle_values[lower + j];
    let upper_own = triangle_values[upper + j];
    let upper_next = triangle_values[upper + next];

    let bottom_below_last = bottom_of(below_last, below_before, lower_last, has_lower);
    let bottom_below_before = bottom_of(below_before, below_own, lower_before, has_lower);
    let bottom_below = bottom_of(below_own, below_next, lower_own, has_lower);
    let bottom_above_before = bottom_of(above_before, above_own, below_before, has_below);
    let bottom_above = bottom_of(above_own, above_next, below_own, has_below);
    let bottom_upper = bottom_of(upper_own, upper_next, above_own, true);

    var travel = 0.0;
    if (has_below) {
        let first =
            top_value(below_before.y, bottom_below_before, bottom_below_last, bottom_above_before, has_above);
        let second = top_value(below_own.y, bottom_below, bottom_below_before, bottom_above, has_above);
        travel = first + bottom_below_before + second;
    }
    if (has_above) {
        let own = top_value(above_own.y, bottom_above, bottom_above_before, bottom_upper, has_upper);
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
    let first_face = cylinder * parameters.faces;
    let first_node = cylinder * parameters.node_count;
    var sum = Wide(0u, 0u);
    // The workgroups take the nodes in turn, so that few of them meet in the two words of `travels`.
    let stride = groups.x * groups.y * THREADS;
    for (var node = workgroup_index(group, groups) * THREADS + local; node < parameters.node_count; node += stride) {
        let ring = node / parameters.nodes;
        let radius = radii[first_node + node];
        let travel = travel_of(first_face, ring, node - ring * parameters.nodes);
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
