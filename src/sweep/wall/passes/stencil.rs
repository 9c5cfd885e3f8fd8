//! The values of a vector that a row of the bending's matrix needs (`shaders/sweep/common/stencil.wgsl`).

use super::Level;

/// Those at a node and about it, by ring and node. Where a grid ends there are none, and what stands in their place does not
/// matter.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Stencil {
    pub below_but_one: f32,
    pub below_before: f32,
    pub below: f32,
    pub below_next: f32,
    pub last_but_one: f32,
    pub before: f32,
    pub here: f32,
    pub next: f32,
    pub next_but_one: f32,
    pub above_before: f32,
    pub above: f32,
    pub above_next: f32,
    pub above_but_one: f32,
}

/// A node of a ring and those on either side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Places {
    pub last_but_one: usize,
    pub before: usize,
    pub here: usize,
    pub next: usize,
    pub next_but_one: usize,
}

/// Those of node j of ring k in a vector with the nodes of a grid.
pub(super) fn places_of(level: &Level, k: usize, j: usize) -> Places {
    let nodes = level.nodes as usize;
    let row = k * nodes;
    let after = |j: usize| if j + 1 == nodes { 0 } else { j + 1 };
    let previous = |j: usize| if j == 0 { nodes - 1 } else { j - 1 };
    let (next, before) = (after(j), previous(j));
    Places {
        last_but_one: row + previous(before),
        before: row + before,
        here: row + j,
        next: row + next,
        next_but_one: row + after(next),
    }
}
