// The gradient of the bending energy at a node of a grid.

// The second difference of three values in a row, from first differences: these are exact where neighbours
// are alike.
fn second_difference(a: f32, b: f32, c: f32) -> f32 {
    return (c - b) - (b - a);
}

fn bending(level: Level, k: u32, s: Stencil) -> f32 {
    let bend_before = second_difference(s.last_but_one, s.before, s.here);
    let bend = second_difference(s.before, s.here, s.next);
    let bend_next = second_difference(s.here, s.next, s.next_but_one);
    let around = (bend_before - bend) + (bend_next - bend);

    // Second differences along the axis exist on inner rings, twists between two rings.
    var arch_below = 0.0;
    var arch = 0.0;
    var arch_above = 0.0;
    var twist = 0.0;
    if (k >= 1u) {
        if (k >= 2u) {
            arch_below = second_difference(s.below_but_one, s.below, s.here);
        }
        if (k + 1u < level.rings) {
            arch = second_difference(s.below, s.here, s.above);
        }
        twist = ((s.here - s.before) - (s.below - s.below_before)) - ((s.next - s.here) - (s.below_next - s.below));
    }
    if (k + 1u < level.rings) {
        if (k + 2u < level.rings) {
            arch_above = second_difference(s.here, s.above, s.above_but_one);
        }
        twist += ((s.above_next - s.above) - (s.next - s.here)) - ((s.above - s.above_before) - (s.here - s.before));
    }
    let along = (arch_below - arch) + (arch_above - arch);
    return level.along * along + level.around * around + level.twist * twist;
}
