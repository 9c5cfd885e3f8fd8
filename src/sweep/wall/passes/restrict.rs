//! Multigrid: the right-hand side of the next coarser grid (`shaders/sweep/restrict.wgsl`).

use super::restricted::restricted;
use super::{Level, WallParameters, smooth_zero};

/// What is left on a grid, shared out among the nodes of the next coarser one, and that one's first relaxation from zero.
/// `own` is the coarser grid's.
pub fn restrict(
    parameters: &WallParameters,
    fine: &Level,
    coarse: &Level,
    own: &[[f32; 2]],
    left: &[f32],
) -> (Vec<f32>, Vec<f32>) {
    let node =
        |node: u32| restricted(fine, coarse, |node| left[node], node / coarse.nodes, node % coarse.nodes);
    let right: Vec<f32> = (0..coarse.count).map(node).collect();
    let relaxed = smooth_zero(parameters, own, &right);
    (right, relaxed)
}
