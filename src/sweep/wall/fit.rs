//! The fit of a wall by iteratively reweighted least squares, whatever engine does the reweightings.

use super::bending::LocalSmoothness;
use super::residual::ResidualModel;
use super::solver::Solved;
use crate::Result;
use crate::numerics::robust::{SD_PER_MAD, median_size};
use crate::recording::echo_error::OUT_OF_PLANE;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::WallGrid;
use rayon::prelude::*;

/// A wall fitted to echoes.
#[derive(Debug, Clone)]
pub(in crate::sweep) struct Wall {
    pub radii_mm: Vec<f64>,
    /// Standard deviation of an echo about the wall, mm.
    pub noise_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    /// Its factor on each ring.
    pub local: LocalSmoothness,
    /// Share of the noise's variance across the image plane.
    pub out_of_plane: f64,
    pub iterations: usize,
    pub solver_steps: usize,
    /// Whether the last reweighting was solved to its tolerance and moved the nodes by little enough.
    pub converged: bool,
}

/// Iterations without projections and gate, until the wall has its shape.
const WARM_UP_ITERATIONS: usize = 2;
const MAX_ITERATIONS: usize = 15;
/// The fit ends when the nodes under echoes move by at most this share of the noise on average, or by this many radii.
const ENOUGH_NOISE_SHARE: f64 = 0.01;
const ENOUGH_RADII: f64 = 1e-6;
/// Share of the noise to which the equations are solved, and of the radius at least; in the warm-up, whose walls are left soon, the
/// former is `WARM_UP_NOISE_SHARE`.
const SOLVED_NOISE_SHARE: f64 = 1e-4;
const SOLVED_RADII: f64 = 1e-10;
const WARM_UP_NOISE_SHARE: f64 = 1e-3;
/// A fit that another one continues ends after so many iterations, unless the nodes still moved by more than this share, which is
/// large against what is usually left: they are as many on a device, where rounding differs.
const CONTINUED_ITERATIONS: usize = 4;
const CONTINUED_ENOUGH: f64 = 0.05;

/// Asked before every reweighting whether to go on: an error ends the fit.
pub(in crate::sweep) type Checkpoint<'a> = dyn Fn() -> Result<()> + 'a;

/// The parameters of one reweighting.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Reweighting {
    /// σ, mm.
    pub noise_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    /// Whether echoes count however far they lie from the wall.
    pub warm_up: bool,
    /// Share of the radius to which the equations are to be solved.
    pub tolerance: f64,
    /// Whether projections move when the residuals from the new wall are evaluated.
    pub project: bool,
}

/// The result of one reweighting.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Solution {
    /// Mean displacement of the nodes, mm, each weighted by the diagonal of the echoes' equations: what the wall does where
    /// nothing was measured must not keep the fit going.
    pub travel_mm: f64,
    pub solved: Solved,
    /// Median of |residual| from the new wall, mm.
    pub residual_mm: f64,
}

/// A wall, initially a tube of the radius [`start_mm`], and the echoes about it.
pub(in crate::sweep) trait WallEngine {
    /// Evaluates the residual of every echo and with `project` moves its projection, but no farther than noise of
    /// `noise_mm` explains; returns the median of |residual|, mm.
    fn measure(&mut self, noise_mm: f64, project: bool) -> Result<f64>;

    /// Solves for the wall under the current weights of the echoes, and measures it as [`WallEngine::measure`] does: a
    /// device answers both at once.
    fn solve(&mut self, reweighting: &Reweighting) -> Result<Solution>;

    /// The nodes' radii, mm; the echoes then have their last projections and residuals.
    fn finish(self) -> Result<Vec<f64>>;
}

/// The radius of the tube that every fit starts from, mm.
pub(in crate::sweep) fn start_mm(echoes: &[Echo]) -> f64 {
    median_size(&echoes.par_iter().map(|echo| echo.radius_mm).collect::<Vec<_>>())
}

impl Wall {
    /// The initial tube; there are no residuals yet.
    pub(in crate::sweep) fn tube(grid: &WallGrid, radius_mm: f64) -> Self {
        Self {
            radii_mm: vec![radius_mm; grid.node_count()],
            noise_mm: radius_mm,
            smoothness_mm2: 0.0,
            local: LocalSmoothness::default(),
            out_of_plane: OUT_OF_PLANE,
            iterations: 0,
            solver_steps: 0,
            converged: false,
        }
    }

    /// The model that residuals from this wall are evaluated on.
    pub(in crate::sweep) fn residual_model<'a>(&'a self, grid: &'a WallGrid) -> ResidualModel<'a> {
        let Self { radii_mm, noise_mm, out_of_plane, .. } = self;
        ResidualModel::new(grid, radii_mm, *noise_mm, *out_of_plane)
    }
}

/// What a fit is to come to.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Aim {
    /// τ: λ = (noise/τ)².
    pub roughness: f64,
    /// Whether [`refit`](super::engine::refit) continues the fit of a wall whose noise exceeds the
    /// [cells'](WallGrid::cell_noise_mm), so that this one may end sooner.
    pub is_continued: bool,
}

impl Aim {
    /// Of a fit that stands for itself.
    pub(in crate::sweep) fn alone(roughness: f64) -> Self {
        Self { roughness, is_continued: false }
    }
}

/// Fits a wall.
pub(super) fn fit(
    engine: impl WallEngine,
    grid: &WallGrid,
    start_mm: f64,
    aim: Aim,
    checkpoint: &Checkpoint,
) -> Result<Wall> {
    let tube = Wall { radii_mm: Vec::new(), ..Wall::tube(grid, start_mm) };
    reweighted(engine, grid, start_mm, aim, tube, checkpoint)
}

/// Continues the fit of `wall`; the first iterations of a new one are its warm-up.
pub(super) fn reweighted(
    mut engine: impl WallEngine,
    grid: &WallGrid,
    start_mm: f64,
    aim: Aim,
    mut wall: Wall,
    checkpoint: &Checkpoint,
) -> Result<Wall> {
    let Aim { roughness, is_continued } = aim;
    let first = wall.iterations;
    let is_warm_up = |iteration: usize| iteration < WARM_UP_ITERATIONS;
    let mut residual_mm = engine.measure(wall.noise_mm, !is_warm_up(first))?;
    for iteration in first..first + MAX_ITERATIONS {
        checkpoint()?;
        let warm_up = is_warm_up(iteration);
        let noise_mm = SD_PER_MAD * residual_mm;
        let is_continued = is_continued && noise_mm > grid.cell_noise_mm(roughness);
        let (least, enough) = match is_continued {
            true => (CONTINUED_ITERATIONS, CONTINUED_ENOUGH),
            false => (0, ENOUGH_NOISE_SHARE),
        };
        let solved = if warm_up { WARM_UP_NOISE_SHARE } else { SOLVED_NOISE_SHARE };
        wall.noise_mm = grid.smoothed_noise_mm(noise_mm, roughness);
        wall.smoothness_mm2 = (wall.noise_mm / roughness).powi(2);
        let solution = engine.solve(&Reweighting {
            noise_mm: wall.noise_mm,
            smoothness_mm2: wall.smoothness_mm2,
            warm_up,
            tolerance: (solved * wall.noise_mm / start_mm).max(SOLVED_RADII),
            project: !is_warm_up(iteration + 1),
        })?;
        residual_mm = solution.residual_mm;
        wall.solver_steps += solution.solved.steps;
        wall.iterations = iteration + 1;
        let enough_mm = (ENOUGH_RADII * start_mm).max(enough * wall.noise_mm);
        let settled = solution.travel_mm <= enough_mm;
        wall.converged = settled && solution.solved.converged;
        if !warm_up && settled && wall.iterations >= least {
            break;
        }
    }
    wall.noise_mm = SD_PER_MAD * residual_mm;
    wall.radii_mm = engine.finish()?;
    Ok(wall)
}
