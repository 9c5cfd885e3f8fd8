//! The echoes' part of the matrix times a vector (`shaders/sweep/common/coupled.wgsl`).

use super::Level;

/// The echoes' part of the matrix times `x`, at node j of ring k.
pub(super) fn coupled(level: &Level, rows: &[[f32; 4]], x: &[f32], k: usize, j: usize) -> f32 {
    let nodes = level.nodes as usize;
    let row = k * nodes;
    let next = if j + 1 == nodes { 0 } else { j + 1 };
    let before = if j == 0 { nodes - 1 } else { j - 1 };
    let here = rows[row + j];
    let mut sum = here[0] * x[row + j] + here[1] * x[row + next] + rows[row + before][1] * x[row + before];
    if k + 1 < level.rings as usize {
        let above = row + nodes;
        sum += here[2] * x[above + j];
        sum += here[3] * x[above + next];
    }
    if k > 0 {
        let below = row - nodes;
        sum += rows[below + j][2] * x[below + j];
        sum += rows[below + before][3] * x[below + before];
    }
    sum
}
