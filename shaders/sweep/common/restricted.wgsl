// The transpose of interpolation: every value of a grid shared out among the coarser nodes about it. The including shader
// defines `fine_value`, by the ring and by the node as `candidate` counts nodes.

// The share of coarser node j in a finer node.
fn weight_of_node(u: u32, j: u32, fine: u32, coarse: u32) -> f32 {
    let node = candidate(u, j, fine, coarse, true);
    if (node == fine) {
        return 0.0;
    }
    return weight_of(j, share_of(node, fine, coarse, true));
}

fn with_share(sum: f32, weight: f32, fine: Level, coarse: Level, ring: u32, u: u32, j: u32) -> f32 {
    if (weight == 0.0) {
        return sum;
    }
    return sum + weight * fine_value(fine, coarse, ring, u, j);
}

fn restricted(fine: Level, coarse: Level, k: u32, j: u32) -> f32 {
    // Not an array: an index that is known only when it runs costs more than all that is computed here.
    let weight_0 = weight_of_node(0u, j, fine.nodes, coarse.nodes);
    let weight_1 = weight_of_node(1u, j, fine.nodes, coarse.nodes);
    let weight_2 = weight_of_node(2u, j, fine.nodes, coarse.nodes);
    let weight_3 = weight_of_node(3u, j, fine.nodes, coarse.nodes);
    var sum = 0.0;
    for (var t = 0u; t < 4u; t++) {
        let ring = candidate(t, k, fine.rings, coarse.rings, false);
        if (ring == fine.rings) {
            continue;
        }
        let of_ring = weight_of(k, share_of(ring, fine.rings, coarse.rings, false));
        if (of_ring == 0.0) {
            continue;
        }
        var row = with_share(0.0, weight_0, fine, coarse, ring, 0u, j);
        row = with_share(row, weight_1, fine, coarse, ring, 1u, j);
        row = with_share(row, weight_2, fine, coarse, ring, 2u, j);
        row = with_share(row, weight_3, fine, coarse, ring, 3u, j);
        sum += of_ring * row;
    }
    return sum;
}
