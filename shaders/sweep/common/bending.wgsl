// The gradient of the bending energy at a node of a grid. The including shader defines `value`.

// The second difference of three values in a row, from first differences: these are exact where neighbours
// are alike.
fn second_difference(a: f32, b: f32, c: f32) -> f32 {
    return (c - b) - (b - a);
}

fn bending(level: Level, k: u32, j: u32) -> f32 {
    let nodes = level.nodes;
    let row = level.first + k * nodes;
    let next = select(j + 1u, 0u, j + 1u == nodes);
    let before = select(j, nodes, j == 0u) - 1u;
    let next_but_one = select(next + 1u, 0u, next + 1u == nodes);
    let last_but_one = select(before, nodes, before == 0u) - 1u;
    let x = value(row + j);
    let x_next = value(row + next);
    let x_before = value(row + before);
    let bend_before = second_difference(value(row + last_but_one), x_before, x);
    let bend = second_difference(x_before, x, x_next);
    let bend_next = second_difference(x, x_next, value(row + next_but_one));
    let around = (bend_before - bend) + (bend_next - bend);

    // Second differences along the axis exist on inner rings, twists between two rings.
    var arch_below = 0.0;
    var arch = 0.0;
    var arch_above = 0.0;
    var twist = 0.0;
    if (k >= 1u) {
        let below = row - nodes;
        let x_below = value(below + j);
        if (k >= 2u) {
            arch_below = second_difference(value(below - nodes + j), x_below, x);
        }
        if (k + 1u < level.rings) {
            arch = second_difference(x_below, x, value(row + nodes + j));
        }
        twist = ((x - x_before) - (x_below - value(below + before)))
            - ((x_next - x) - (value(below + next) - x_below));
    }
    if (k + 1u < level.rings) {
        let above = row + nodes;
        let x_above = value(above + j);
        if (k + 2u < level.rings) {
            arch_above = second_difference(x, x_above, value(above + nodes + j));
        }
        twist += ((value(above + next) - x_above) - (x_next - x))
            - ((x_above - value(above + before)) - (x - x_before));
    }
    let along = (arch_below - arch) + (arch_above - arch);
    return level.along * along + level.around * around + level.twist * twist;
}
