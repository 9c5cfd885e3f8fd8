// Moves the nodes by the filled values of the triangles that meet there, and sums |travel|. A strip of up to
// 254 neighbouring nodes of a ring fills the triangles about them in workgroup memory; short rings share a
// workgroup.

@group(0) @binding(0) var<uniform> parameters: FitParameters;
@group(0) @binding(1) var<storage, read> cylinders: array<Cylinder>;
// Per cylinder those of its bottom triangles, then those of its top ones.
@group(0) @binding(2) var<storage, read> triangle_values: array<u32>;
@group(0) @binding(3) var<storage, read_write> radii: array<f32>;
// Per cylinder: the sum of |travel| in fixed point, low and high word.
@group(0) @binding(4) var<storage, read_write> travels: array<atomic<u32>>;

const THREADS: u32 = 256u;

// Values of the bottom and top triangles below a node and above it.
var<workgroup> bottom_below: array<f32, 256>;
var<workgroup> bottom_above: array<f32, 256>;
var<workgroup> top_below: array<f32, 256>;
var<workgroup> top_above: array<f32, 256>;
// The workgroup's sum in parts of 16 bits; the last one has the rest.
var<workgroup> parts: array<atomic<u32>, 3>;

// The value of the bottom triangle of a face.
fn bottom_of(bottom: u32, top: u32, level: u32, j: u32, next: u32) -> f32 {
    let row = level * parameters.nodes;
    let has_below = level > 0u;
    let below = select(row, row - parameters.nodes, has_below) + j;
    return bottom_value(
        triangle_values[bottom + row + j],
        value_of(triangle_values[top + row + j]),
        value_of(triangle_values[top + row + next]),
        value_of(triangle_values[top + below]),
        has_below,
    );
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let nodes = parameters.nodes;
    let levels = parameters.levels;
    let cylinder = group.z;
    let scale = cylinders[cylinder].scale;
    let bottom = 2u * cylinder * parameters.faces;
    let top = bottom + parameters.faces;
    // Two columns before the first node of a strip are filled too.
    let width = min(nodes + 2u, THREADS);
    let strips_of_ring = (nodes + width - 3u) / (width - 2u);
    let strips = strips_of_ring * (levels + 1u);
    let strips_here = THREADS / width;
    let own_strip = local / width;
    let column = local - own_strip * width;
    if (local < 3u) {
        atomicStore(&parts[local], 0u);
    }
    var sum = Wide(0u, 0u);
    // The workgroups take the strips in turn, so that few of them meet in the two words of `travels`.
    let stride = groups.x * groups.y * strips_here;
    for (var first = workgroup_index(group, groups) * strips_here; first < strips; first += stride) {
        let strip = first + own_strip;
        let ring = strip / strips_of_ring;
        let place = (strip - ring * strips_of_ring) * (width - 2u) + column;
        let takes_part = own_strip < strips_here && strip < strips && place < nodes + 2u;
        // Less than twice the nodes where the invocation takes part.
        let turned = place + nodes - 2u;
        let j = select(turned, turned - nodes, turned >= nodes);
        let next = select(j + 1u, 0u, j + 1u == nodes);
        let has_below = takes_part && ring > 0u;
        let has_above = takes_part && ring < levels;
        let has_next = takes_part && ring + 1u < levels;
        var below = 0.0;
        var above = 0.0;
        var next_above = 0.0;
        // Read before the barriers, since reading takes longest.
        let is_node = takes_part && column >= 2u;
        let node = cylinder * parameters.node_count + ring * nodes + j;
        var radius = 0.0;
        if (is_node) {
            radius = radii[node];
        }
        var own_below = NO_VALUE;
        var own_above = NO_VALUE;
        if (has_below) {
            own_below = triangle_values[top + (ring - 1u) * nodes + j];
            below = bottom_of(bottom, top, ring - 1u, j, next);
        }
        if (has_above) {
            own_above = triangle_values[top + ring * nodes + j];
            above = bottom_of(bottom, top, ring, j, next);
        }
        // Only an empty triangle asks for its neighbour.
        if (has_next && own_above == NO_VALUE) {
            next_above = bottom_of(bottom, top, ring + 1u, j, next);
        }
        bottom_below[local] = below;
        bottom_above[local] = above;
        workgroupBarrier();
        let left = max(local, 1u) - 1u;
        if (has_below) {
            top_below[local] = top_value(own_below, below, bottom_below[left], above, has_above);
        }
        if (has_above) {
            top_above[local] = top_value(own_above, above, bottom_above[left], next_above, has_next);
        }
        workgroupBarrier();
        if (is_node) {
            var travel = 0.0;
            if (has_below) {
                travel = top_below[left] + bottom_below[left] + top_below[local];
            }
            if (has_above) {
                let beside = bottom_above[left];
                travel = select(beside, travel + beside, has_below) + top_above[local] + above;
            }
            travel = travel / select(3.0, 6.0, has_below && has_above);
            radii[node] = radius + travel;
            sum = add_wide(sum, widen(fixed(abs(travel), scale)));
        }
        workgroupBarrier();
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
