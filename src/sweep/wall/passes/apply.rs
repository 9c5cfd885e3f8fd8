//! Conjugate gradients: convergence, and the matrix of the equations times the next direction
//! (`shaders/sweep/apply.wgsl`).

use super::cg_step::next_direction;
use super::coupled::coupled;
use super::tile::{APPLY_COLUMNS, tile_sums};
use super::{BROKEN, CONVERGED, EXHAUSTED, NextStep, State, WallParameters, bending, sum_of_partials};

/// What [`apply`] finds: the next step; and unless that ends them, the product, and the sums, tile by tile, of its scalar
/// product with the direction.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Applied {
    /// The next step.
    pub next_step: NextStep,
    /// The matrix times the next direction.
    pub product: Vec<f32>,
    /// Sums of their scalar product.
    pub curvatures: Vec<f32>,
}

/// From the partial sums of the residual's square: whether it is small enough, or the steps ran out; if not, the share β of
/// the last direction in the next, and the matrix times that. A residual that is not a finite number breaks the solver.
pub fn apply(
    parameters: &WallParameters,
    state: &State,
    squares: &[f32],
    rows: &[[f32; 4]],
    preconditioned: &[f32],
    direction: &[f32],
) -> Applied {
    let square = sum_of_partials(squares);
    let (mut ends, mut beta) = (0, 0.0);
    if square <= state.max_residual_square {
        ends = CONVERGED;
    } else if square <= f32::MAX && state.steps >= parameters.max_steps {
        ends = EXHAUSTED;
    } else if square <= f32::MAX {
        beta = if state.residual_square > 0.0 { square / state.residual_square } else { 0.0 };
    } else {
        ends = BROKEN;
    }
    let next_step = NextStep { ends, square, beta };
    if ends != 0 {
        return Applied { next_step, ..Applied::default() };
    }
    let level = parameters.finest();
    let nodes = parameters.nodes as usize;
    let along: Vec<f32> =
        preconditioned.iter().zip(direction).map(|(z, d)| next_direction(&next_step, *z, *d)).collect();
    let product: Vec<f32> = (0..along.len())
        .map(|node| {
            let (k, j) = (node / nodes, node % nodes);
            coupled(&level, rows, &along, k, j) + bending(&level, &along, k, j)
        })
        .collect();
    let curvatures = tile_sums(parameters, &level, APPLY_COLUMNS, |node| along[node] * product[node]);
    Applied { next_step, product, curvatures }
}
