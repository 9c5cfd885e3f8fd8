//! Multigrid: the whole cycle over the coarser grids (`shaders/sweep/coarse_cycle.wgsl`).

use super::diagonal::{diagonal, has_arch};
use super::{Level, Matrix, WallParameters, ascend, descend};

/// Most nodes of the grids that one workgroup goes through the cycle over, all together.
pub const MOST_OF_ONE: u32 = 1360;
/// Added to the diagonal of the coarsest grid, in units of the largest one, so that a wall without echoes has a solution.
pub(in crate::sweep::wall) const FLOOR: f32 = 1e-6;

/// The values of the first of some grids after a cycle over them, from a right-hand side. `own` has, grid by grid, each
/// node's weight and the inverse of its diagonal. The last grid, a line, is solved by factors.
pub fn coarse_cycle(
    parameters: &WallParameters,
    levels: &[Level],
    own: &[&[[f32; 2]]],
    right: &[f32],
) -> Vec<f32> {
    let ([level, coarser @ ..], [first, others @ ..]) = (levels, own) else { return Vec::new() };
    let Some(next) = coarser.first() else { return solve(level, first, right) };
    let matrix = Matrix { parameters, level, rows: &[], own: first };
    let (values, coarse_right) = descend(&matrix, next, right);
    let correction = coarse_cycle(parameters, coarser, others, &coarse_right);
    ascend(&matrix, next, &correction, right, &values).0
}

/// Solves the coarsest grid.
fn solve(level: &Level, own: &[[f32; 2]], right: &[f32]) -> Vec<f32> {
    let rings = level.rings as usize;
    let weight = |k: usize| own[k][0] + diagonal(level, k as u32);
    let largest = (0..rings).fold(0.0_f32, |largest, k| largest.max(weight(k)));
    // Per row: the pivot's inverse, its couplings to the next two rows, and these over the pivot.
    let [mut inverse, mut one, mut two, mut next, mut next_but_one, mut x] =
        [0.0; 6].map(|zero: f32| vec![zero; rings]);
    for k in 0..rings {
        let arches = |k: usize| has_arch(level, k as u32);
        let mut pivot = weight(k) + FLOOR * largest;
        let mut to_next = -2.0 * (level.along * (arches(k) + arches(k + 1)) as f32);
        two[k] = level.along * arches(k + 1) as f32;
        let mut right = right[k];
        if k >= 1 {
            pivot -= next[k - 1] * one[k - 1];
            to_next -= next[k - 1] * two[k - 1];
            right -= next[k - 1] * x[k - 1];
        }
        if k >= 2 {
            pivot -= next_but_one[k - 2] * two[k - 2];
            right -= next_but_one[k - 2] * x[k - 2];
        }
        one[k] = to_next;
        inverse[k] = 1.0 / pivot;
        next[k] = to_next * inverse[k];
        next_but_one[k] = two[k] * inverse[k];
        x[k] = right;
    }
    for k in (0..rings).rev() {
        let mut solved = x[k] * inverse[k];
        if k + 1 < rings {
            solved -= next[k] * x[k + 1];
        }
        if k + 2 < rings {
            solved -= next_but_one[k] * x[k + 2];
        }
        x[k] = solved;
    }
    x
}
