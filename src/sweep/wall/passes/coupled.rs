//! The echoes' part of the matrix times a vector (`shaders/sweep/common/coupled.wgsl`).

use super::Level;
use super::stencil::places_of;
use super::stencil_at::stencil_at;

/// The coefficients of a node: its own four, those with the next node and the next node above of the node before, that with
/// the node above of the node below, and that with the next node above of the node before that one.
struct Couplings {
    here: [f32; 4],
    before: [f32; 2],
    below: f32,
    below_before: f32,
}

fn couplings_at(level: &Level, rows: &[[f32; 4]], k: usize, j: usize) -> Couplings {
    let (at, ring) = (places_of(level, k, j), level.nodes as usize);
    let before = rows[at.before];
    let [below, below_before] = match k {
        0 => [0.0; 2],
        _ => [rows[at.here - ring][2], rows[at.before - ring][3]],
    };
    Couplings { here: rows[at.here], before: [before[1], before[3]], below, below_before }
}

/// The echoes' part of the matrix times `x`, at node j of ring k.
pub(super) fn coupled(level: &Level, rows: &[[f32; 4]], x: &[f32], k: usize, j: usize) -> f32 {
    let (c, s) = (couplings_at(level, rows, k, j), stencil_at(level, x, k, j));
    let mut sum = c.here[0] * s.here + c.here[1] * s.next + c.before[0] * s.before;
    if k + 1 < level.rings as usize {
        sum += c.here[2] * s.above;
        sum += c.here[3] * s.above_next;
    }
    if k > 0 {
        sum += c.below * s.below;
        sum += c.below_before * s.below_before;
    }
    sum
}
