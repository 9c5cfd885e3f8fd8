// The diagonal of the bending's matrix.

// Whether second differences along the axis exist on a ring: the ends are free.
fn has_arch(level: Level, k: u32) -> u32 {
    return select(0u, 1u, k >= 1u && k + 1u < level.rings);
}

fn diagonal(level: Level, k: u32) -> f32 {
    var arches = 4u * has_arch(level, k) + has_arch(level, k + 1u);
    var twists = select(0u, 2u, k + 1u < level.rings);
    if (k > 0u) {
        arches += has_arch(level, k - 1u);
        twists += 2u;
    }
    var bends = 6u;
    // Where neighbours on both sides are the same node, or the node itself.
    if (level.nodes == 2u) {
        bends = 8u;
    }
    if (level.nodes == 1u) {
        bends = 0u;
        twists = 0u;
    }
    return f32(arches) * level.along + f32(bends) * level.around + f32(twists) * level.twist;
}
