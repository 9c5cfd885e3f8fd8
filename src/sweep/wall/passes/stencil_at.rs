//! The stencil at a node (`shaders/sweep/common/stencil_at.wgsl`).

use super::Level;
use super::stencil::{Stencil, places_of};

/// That at node j of ring k in `x`, the values of a grid.
pub(super) fn stencil_at(level: &Level, x: &[f32], k: usize, j: usize) -> Stencil {
    let (rings, ring) = (level.rings as usize, level.nodes as usize);
    let at = places_of(level, k, j);
    let mut s = Stencil {
        last_but_one: x[at.last_but_one],
        before: x[at.before],
        here: x[at.here],
        next: x[at.next],
        next_but_one: x[at.next_but_one],
        ..Stencil::default()
    };
    if k >= 1 {
        s.below_before = x[at.before - ring];
        s.below = x[at.here - ring];
        s.below_next = x[at.next - ring];
    }
    if k >= 2 {
        s.below_but_one = x[at.here - 2 * ring];
    }
    if k + 1 < rings {
        s.above_before = x[at.before + ring];
        s.above = x[at.here + ring];
        s.above_next = x[at.next + ring];
    }
    if k + 2 < rings {
        s.above_but_one = x[at.here + 2 * ring];
    }
    s
}
