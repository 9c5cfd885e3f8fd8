//! The fit of a wall as a linear function of the echoes' values, with the weights of its last reweighting.

use super::process::{Signs, random};
use crate::Result;
use crate::numerics::robust::huber_weight;
use crate::numerics::vectorized;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::WallGrid;
use crate::sweep::wall::equations::Equations;
use crate::sweep::wall::fit::Wall;
use crate::sweep::wall::operator::Operator;
use crate::sweep::wall::residual::{TASK, gate};
use crate::sweep::wall::solver::Solver;
use rayon::prelude::*;

/// The share of the residual that may remain before the solver's last correction: draws need not be exact. It changes standard
/// errors by 0.5 %, which is much less than other draws would.
const TOLERANCE: f64 = 0.05;
const MAX_STEPS: usize = 30;
/// Stream of the random numbers of a wall's bends.
const BENDS: usize = 63;

/// The part of an echo in the equations of the wall.
#[derive(Clone, Copy, Default)]
pub(in crate::sweep) struct Term {
    nodes: [u32; 3],
    shares: [f32; 3],
    /// What each millimetre of its residual adds to the right-hand side, for the share 1.
    pull: f32,
    /// A residual for each millimetre of radius.
    scale: f32,
}

impl Term {
    /// The residual that a change of the wall makes.
    fn at(&self, wall_mm: &[f64]) -> f64 {
        let corners = self.nodes.iter().zip(self.shares);
        f64::from(self.scale) * corners.map(|(&n, share)| wall_mm[n as usize] * f64::from(share)).sum::<f64>()
    }

    /// The robust weight of the echo's residual.
    pub(in crate::sweep) fn weight(&self) -> f64 {
        f64::from(self.pull) / f64::from(self.scale)
    }

    /// The residual that a wall leaves of an error of the echo.
    pub(in crate::sweep) fn left(&self, error_mm: f64, wall_mm: &[f64]) -> f64 {
        error_mm - self.at(wall_mm)
    }
}

/// The echoes' parts in the equations of a wall, and the matrix of these.
pub(in crate::sweep) fn linearised(grid: &WallGrid, echoes: &[Echo], wall: &Wall) -> (Vec<Term>, Operator) {
    let model = wall.residual_model(grid);
    let mut terms = vec![Term::default(); echoes.len()];
    let of_task = |(echoes, terms): (&[Echo], &mut [Term])| {
        let mut sums = Equations::about(grid, echoes);
        let mut echoes = echoes.to_vec();
        vectorized(
            #[inline(always)]
            || {
                model.measure_each(&mut echoes, false, |i, echo, corners, measured| {
                    let residual = echo.residual_mm.abs();
                    let is_on_wall = residual <= gate(wall.noise_mm, measured.wall_mm);
                    let robust = if is_on_wall { huber_weight(wall.noise_mm, residual) } else { 0.0 };
                    let weight = robust * measured.weight * f64::from(echo.weight);
                    let scale = measured.weight.sqrt();
                    let pull = if weight > 0.0 { weight / scale } else { 0.0 };
                    sums.add(corners, weight, 0.0);
                    terms[i] = Term {
                        nodes: corners.nodes.map(|n| n as u32),
                        shares: corners.weights.map(|w| w as f32),
                        pull: pull as f32,
                        scale: scale as f32,
                    };
                });
            },
        );
        sums
    };
    let parts: Vec<Equations> =
        echoes.par_chunks(TASK).zip(terms.par_chunks_mut(TASK)).map(of_task).collect();
    let equations = Equations::sum(grid, &parts);
    let operator = Operator::of(&equations, grid, wall.smoothness_mm2, &wall.local);
    (terms, operator)
}

/// What the fit makes of errors of the echoes.
pub(in crate::sweep) struct Smoother<'a> {
    grid: &'a WallGrid,
    terms: &'a [Term],
    operator: &'a Operator,
    solver: Solver<'a>,
    /// √λ·τ: the noise that the smoothness stands for, mm.
    noise_mm: f64,
}

impl<'a> Smoother<'a> {
    pub(in crate::sweep) fn of(
        grid: &'a WallGrid,
        (terms, operator): &'a (Vec<Term>, Operator),
        smoothness_mm2: f64,
        roughness: f64,
    ) -> Result<Self> {
        let noise_mm = smoothness_mm2.sqrt() * roughness;
        Ok(Self { grid, terms, operator, solver: Solver::of(operator)?, noise_mm })
    }

    fn solve(&self, right: &[f64]) -> Result<Vec<f64>> {
        let mut x = vec![0.0; right.len()];
        self.solver.solve(right, &|_, _| (), TOLERANCE, MAX_STEPS, &mut x)?;
        Ok(x)
    }

    /// The wall through values of the echoes in the form of residuals, mm.
    pub(in crate::sweep) fn wall(&self, values_mm: impl IntoIterator<Item = f64>) -> Result<Vec<f64>> {
        let mut right = vec![0.0; self.grid.node_count()];
        for (term, value) in self.terms.iter().zip(values_mm) {
            let weighted = f64::from(term.pull) * value;
            for (node, share) in term.nodes.iter().zip(term.shares) {
                right[*node as usize] += weighted * f64::from(share);
            }
        }
        self.solve(&right)
    }

    /// What the [`wall`](Self::wall) through errors of the echoes leaves of them, mm.
    pub(super) fn residuals(&self, errors_mm: &[f64], wall_mm: &[f64]) -> impl Iterator<Item = f64> {
        self.terms.iter().zip(errors_mm).map(|(term, error)| term.left(*error, wall_mm))
    }

    /// What the fit misses of the bends of a wall that is as rough as the smoothing assumes, mm.
    ///
    /// With `λ ∫ bending² = Σ w (c·r)²`, such a wall has `√w c·r = √λ τ z` with independent signs z, and the fit misses
    /// `A⁻¹ Σ w c (c·r)` of it.
    /// `rougher` has the roughness about each node in units of that, if it is not the same everywhere.
    pub(super) fn bends(&self, draw: usize, rougher: Option<&[f64]>) -> Result<Vec<f64>> {
        let mut right = vec![0.0; self.grid.node_count()];
        let mut rng = random(draw, BENDS);
        let mut signs = Signs::of(&mut rng);
        for k in 0..self.grid.rings {
            for j in 0..self.grid.nodes {
                let rougher = rougher.map_or(1.0, |rougher| rougher[k * self.grid.nodes + j]);
                for (weight, nodes) in self.operator.squares(k, j) {
                    let size = self.noise_mm * rougher * weight.sqrt() * signs.draw();
                    for (node, coefficient) in nodes {
                        right[node] += size * coefficient;
                    }
                }
            }
        }
        self.solve(&right)
    }

    /// The residuals of the echoes that come with such bends, mm.
    pub(super) fn residuals_of_bends(&self, bends_mm: &[f64]) -> impl Iterator<Item = f64> {
        self.terms.iter().map(|term| term.at(bends_mm))
    }
}
