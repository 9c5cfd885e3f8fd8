// The value of a coarser grid at a node of a finer one, by where it lies between the coarser rings and nodes. The including
// shader defines `coarse_value`.

fn interpolated(coarse: Level, ring: Share, node: Share) -> f32 {
    let below = coarse.first + ring.below * coarse.nodes;
    let above = coarse.first + ring.above * coarse.nodes;
    let a0 = coarse_value(below + node.below);
    let b0 = coarse_value(above + node.below);
    let a = a0 + node.part * (coarse_value(below + node.above) - a0);
    let b = b0 + node.part * (coarse_value(above + node.above) - b0);
    return a + ring.part * (b - a);
}
