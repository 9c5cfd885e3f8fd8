// A grid's matrix times a vector, at a node: the finest grid's has the couplings of echoes in `rows`, those of
// coarser ones have weights at the nodes themselves. The including shader defines the vector as `value`.

fn times(level: Level, k: u32, j: u32) -> f32 {
    var of_echoes = 0.0;
    if (level.first == 0u) {
        of_echoes = coupled(level, k, j);
    } else {
        let node = level.first + k * level.nodes + j;
        of_echoes = own[node].x * value(node);
    }
    return of_echoes + bending(level, k, j);
}
