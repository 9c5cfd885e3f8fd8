// The values of a vector that a row of the bending's matrix needs: those at a node and about it, by ring and node. Where a
// grid ends there are none, and what stands in their place does not matter.

struct Stencil {
    below_but_one: f32,
    below_before: f32,
    below: f32,
    below_next: f32,
    last_but_one: f32,
    before: f32,
    here: f32,
    next: f32,
    next_but_one: f32,
    above_before: f32,
    above: f32,
    above_next: f32,
    above_but_one: f32,
}

// A node of a ring and those on either side.
struct Places {
    last_but_one: u32,
    before: u32,
    here: u32,
    next: u32,
    next_but_one: u32,
}

// Those of node j of ring k in a vector with all nodes of a grid.
fn places_of(level: Level, k: u32, j: u32) -> Places {
    let nodes = level.nodes;
    let row = level.first + k * nodes;
    let next = select(j + 1u, 0u, j + 1u == nodes);
    let before = select(j, nodes, j == 0u) - 1u;
    let next_but_one = select(next + 1u, 0u, next + 1u == nodes);
    let last_but_one = select(before, nodes, before == 0u) - 1u;
    return Places(row + last_but_one, row + before, row + j, row + next, row + next_but_one);
}
