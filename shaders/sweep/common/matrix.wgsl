// A grid's matrix times a vector, at a node: the finest grid's has the couplings of echoes, those of coarser ones have
// weights at the nodes themselves. The node is counted among those of all grids.

// What the vector leaves of the right-hand side.
fn left_at(level: Level, k: u32, node: u32, c: Couplings, s: Stencil) -> f32 {
    var of_echoes = 0.0;
    if (level.first == 0u) {
        of_echoes = coupled(level, k, c, s);
    } else {
        of_echoes = own[node].x * s.here;
    }
    return rights[node] - (of_echoes + bending(level, k, s));
}

// The vector after a relaxation.
fn relaxed(level: Level, k: u32, node: u32, c: Couplings, s: Stencil, relaxation: f32) -> f32 {
    return s.here + (relaxation * own[node].y) * left_at(level, k, node, c, s);
}
