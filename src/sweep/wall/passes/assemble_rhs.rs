//! The right-hand side for whole radii (`shaders/sweep/assemble_rhs.wgsl`).

use super::coupled::coupled;
use super::{Sums, WallParameters};
use crate::numerics::Scalar;

/// The right-hand side of the equations for whole radii instead of changes, in units of the noise: the
/// reference of the solver's relative residual.
pub fn assemble_rhs(parameters: &WallParameters, sums: &[Sums], rows: &[[f32; 4]], wall: &[f32]) -> Vec<f32> {
    let nodes = parameters.nodes as usize;
    let radii: Vec<f32> = wall.iter().map(|r| (r + parameters.start) * parameters.per_noise).collect();
    (0..wall.len())
        .map(|node| {
            let of_echoes = f32::mean_of(sums[node][4], parameters.rhs_unit, 1);
            coupled(&parameters.finest(), rows, &radii, node / nodes, node % nodes) + of_echoes
        })
        .collect()
}
