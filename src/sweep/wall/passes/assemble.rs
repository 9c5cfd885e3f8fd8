//! The equations of the nodes (`shaders/sweep/assemble.wgsl`).

use super::{Sums, WallParameters, bending};
use crate::numerics::Scalar;

/// The equations of every node from the sums over echoes (the coefficients of the node itself, of the next
/// node of its ring, of the node above and of the next node above), and their residual for the wall as it is,
/// in units of the noise.
pub fn assemble(parameters: &WallParameters, sums: &[Sums], wall: &[f32]) -> (Vec<[f32; 4]>, Vec<f32>) {
    let nodes = parameters.nodes as usize;
    sums.iter()
        .enumerate()
        .map(|(node, sums)| {
            let weight = |part: usize| f32::mean_of(sums[part], parameters.weight_unit, 1);
            let gradient = bending(&parameters.finest(), wall, node / nodes, node % nodes);
            let residual = f32::mean_of(sums[4], parameters.rhs_unit, 1) - gradient * parameters.per_noise;
            ([weight(0), weight(1), weight(2), weight(3)], residual)
        })
        .unzip()
}
