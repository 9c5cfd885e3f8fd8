//! The wall about the axis: robust penalised least squares on radii, with every echo measured across the wall.

use super::echo::{Echo, gate};
use super::grid::{Equations, Grid, Solver};
use super::median;
use crate::Result;
use rayon::prelude::*;

/// A wall fitted to echoes.
#[derive(Debug, Clone)]
pub(super) struct Wall {
    pub radii_mm: Vec<f64>,
    /// Standard deviation of an echo about the wall, mm.
    pub noise_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    pub iterations: usize,
    pub solver_steps: usize,
}

/// Huber's constant: 95 % as good as least squares for normal noise.
pub(super) const HUBER: f64 = 1.345;
/// What a wall of roughness one bends away from a flat triangle, as noise, in edge lengths. It keeps perfect echoes from
/// being interpolated.
pub(super) const CELL_NOISE: f64 = 0.3;
/// Iterations without feet and gate, until the wall has its shape.
const ROUGH_ITERATIONS: usize = 3;
const MOST_ITERATIONS: usize = 15;
/// The fit ends when no more than this share of the noise is left to travel, on average over the nodes, or …
const ENOUGH_NOISE_SHARE: f64 = 0.01;
/// … this many radii.
const ENOUGH_RADII: f64 = 1e-6;
/// Share of the noise to which the equations are solved, and of the radius at least.
const SOLVED_NOISE_SHARE: f64 = 1e-3;
const SOLVED_RADII: f64 = 1e-10;
/// Echoes that one task works through: a fixed number, so that sums do not depend on the number of threads.
const TASK: usize = 8192;

/// One reweighting.
#[derive(Debug, Clone, Copy)]
pub(super) struct Round {
    /// σ, mm.
    pub noise_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    /// Whether echoes count however far they lie from the wall.
    pub rough: bool,
    /// Share of the radius to which the equations are to be solved.
    pub tolerance: f64,
}

/// What a reweighting did.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drawn {
    /// Mean way of the nodes, mm.
    pub travel_mm: f64,
    pub solver_steps: usize,
}

/// Something that holds a wall, at first a tube of the radius [`start_mm`], and the echoes about it.
pub(super) trait WallEngine {
    /// Measures the way of every echo to the wall, and moves its foot where `feet` says so, but no farther than a noise
    /// of `noise_mm` explains; returns the median of |miss|, mm.
    fn measure(&mut self, noise_mm: f64, feet: bool) -> Result<f64>;

    /// Draws the wall to the echoes.
    fn draw(&mut self, round: &Round) -> Result<Drawn>;

    /// The nodes' radii, mm, once the echoes have their last feet and misses.
    fn finish(self) -> Result<Vec<f64>>;
}

/// The radius of the tube that every fit begins with, mm.
pub(super) fn start_mm(echoes: &[Echo]) -> f64 {
    median(&mut echoes.iter().map(|e| e.radius_mm).collect::<Vec<_>>())
}

/// Fits a wall. `roughness` is τ: λ = (noise/τ)².
pub(super) fn fit(mut engine: impl WallEngine, grid: &Grid, start_mm: f64, roughness: f64) -> Result<Wall> {
    let mut wall = Wall {
        radii_mm: Vec::new(),
        noise_mm: start_mm,
        smoothness_mm2: 0.0,
        iterations: 0,
        solver_steps: 0,
    };
    for iteration in 0..MOST_ITERATIONS {
        let rough = iteration < ROUGH_ITERATIONS;
        let miss_mm = engine.measure(wall.noise_mm, !rough)?;
        wall.noise_mm = noise_mm(miss_mm).hypot(CELL_NOISE * roughness * grid.arc_mm);
        wall.smoothness_mm2 = (wall.noise_mm / roughness).powi(2);
        let drawn = engine.draw(&Round {
            noise_mm: wall.noise_mm,
            smoothness_mm2: wall.smoothness_mm2,
            rough,
            tolerance: (SOLVED_NOISE_SHARE * wall.noise_mm / start_mm).max(SOLVED_RADII),
        })?;
        wall.solver_steps += drawn.solver_steps;
        wall.iterations = iteration + 1;
        let enough_mm = (ENOUGH_RADII * start_mm).max(ENOUGH_NOISE_SHARE * wall.noise_mm);
        if !rough && drawn.travel_mm <= enough_mm {
            break;
        }
    }
    wall.noise_mm = noise_mm(engine.measure(wall.noise_mm, true)?);
    wall.radii_mm = engine.finish()?;
    Ok(wall)
}

/// Standard deviation of normal noise with that median |miss|.
fn noise_mm(median_miss_mm: f64) -> f64 {
    1.4826 * median_miss_mm
}

/// The fit on the CPU, in f64.
pub(super) struct OnCpu<'a> {
    grid: &'a Grid,
    echoes: &'a mut [Echo],
    solver: Solver,
    radii_mm: Vec<f64>,
}

impl<'a> OnCpu<'a> {
    /// A tube of the radius `start_mm` and echoes sorted along the axis.
    pub(super) fn new(grid: &'a Grid, echoes: &'a mut [Echo], start_mm: f64) -> Self {
        Self { grid, echoes, solver: Solver::new(*grid), radii_mm: vec![start_mm; grid.node_count()] }
    }

    fn equations(&mut self, round: &Round) -> Equations {
        let Self { grid, echoes, radii_mm, .. } = self;
        let parts: Vec<Equations> = echoes
            .par_chunks_mut(TASK)
            .map(|task| {
                let rings = task.iter().map(|e| e.foot().0);
                let last = grid.rings - 2;
                let (low, high) = rings.fold((last, 0), |(low, high), ring| {
                    let level = (ring.max(0.0) as usize).min(last);
                    (low.min(level), high.max(level))
                });
                let mut sums = Equations::over(grid, low..high + 2);
                for echo in task {
                    let (ring, node) = echo.foot();
                    let measured = echo.measure(grid, radii_mm, round.noise_mm, false);
                    let miss = echo.miss_mm.abs();
                    if !round.rough && miss > gate(round.noise_mm, measured.wall_mm) {
                        continue;
                    }
                    let robust = (HUBER * round.noise_mm / miss.max(f64::MIN_POSITIVE)).min(1.0);
                    let corners = grid.corners(ring, node);
                    sums.add(&corners, robust * measured.weight, measured.wall_mm + measured.radial_mm);
                }
                sums
            })
            .collect();
        let mut whole = Equations::over(grid, 0..grid.rings);
        parts.iter().for_each(|part| whole.merge(part));
        whole
    }
}

impl WallEngine for OnCpu<'_> {
    fn measure(&mut self, noise_mm: f64, feet: bool) -> Result<f64> {
        let (grid, radii_mm) = (self.grid, &self.radii_mm);
        self.echoes.par_chunks_mut(TASK).for_each(|task| {
            for echo in task {
                echo.measure(grid, radii_mm, noise_mm, feet);
            }
        });
        Ok(median(&mut self.echoes.iter().map(|e| e.miss_mm.abs()).collect::<Vec<_>>()))
    }

    fn draw(&mut self, round: &Round) -> Result<Drawn> {
        let equations = self.equations(round);
        let before = self.radii_mm.clone();
        let solver_steps =
            self.solver.solve(&equations, round.smoothness_mm2, round.tolerance, &mut self.radii_mm);
        let travel = before.iter().zip(&self.radii_mm).map(|(a, b)| (a - b).abs()).sum::<f64>();
        Ok(Drawn { travel_mm: travel / before.len() as f64, solver_steps })
    }

    fn finish(self) -> Result<Vec<f64>> {
        Ok(self.radii_mm)
    }
}
