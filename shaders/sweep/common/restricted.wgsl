// The transpose of interpolation: every value of a grid, `fine_value`, shared out among the coarser nodes about it.

fn restricted(fine: Level, coarse: Level, k: u32, j: u32) -> f32 {
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
        var row = 0.0;
        for (var u = 0u; u < 4u; u++) {
            let node = candidate(u, j, fine.nodes, coarse.nodes, true);
            if (node < fine.nodes) {
                let of_node = weight_of(j, share_of(node, fine.nodes, coarse.nodes, true));
                row += of_node * fine_value(fine.first + ring * fine.nodes + node);
            }
        }
        sum += of_ring * row;
    }
    return sum;
}
