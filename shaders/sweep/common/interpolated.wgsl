// The value of a coarser grid, in `values`, at a node of a finer one.

fn interpolated(fine: Level, coarse: Level, k: u32, j: u32) -> f32 {
    let ring = share_of(k, fine.rings, coarse.rings, false);
    let node = share_of(j, fine.nodes, coarse.nodes, true);
    let below = coarse.first + ring.below * coarse.nodes;
    let above = coarse.first + ring.above * coarse.nodes;
    let a0 = values[below + node.below];
    let b0 = values[above + node.below];
    let a = a0 + node.part * (values[below + node.above] - a0);
    let b = b0 + node.part * (values[above + node.above] - b0);
    return a + ring.part * (b - a);
}
