//! The wall about the axis: robust penalised least squares on radii, with every echo measured across the wall.

pub(in crate::sweep) mod echo;
pub(in crate::sweep) mod engine;
#[cfg(feature = "gpu")]
pub mod gpu;
pub(in crate::sweep) mod grid;
pub mod passes;

use super::median;
use crate::Result;
use echo::{Echo, Held, OUT_OF_PLANE, gate};
use grid::{Equations, Grid, Solver, System};
use rayon::prelude::*;

/// A wall fitted to echoes.
#[derive(Debug, Clone)]
pub(in crate::sweep) struct Wall {
    pub radii_mm: Vec<f64>,
    /// Standard deviation of an echo about the wall, mm.
    pub noise_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    /// Share of the noise's variance across the image plane.
    pub out_of_plane: f64,
    pub iterations: usize,
    pub solver_steps: usize,
}

/// Huber's constant: 95 % as good as least squares for normal noise.
pub(in crate::sweep) const HUBER: f64 = 1.345;
/// What a wall of roughness one bends away from a flat triangle, as noise, in edge lengths. It keeps perfect echoes from
/// being interpolated.
pub(in crate::sweep) const CELL_NOISE: f64 = 0.3;
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
pub(in crate::sweep) struct Round {
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
pub(in crate::sweep) struct Drawn {
    /// Mean way of the nodes, mm.
    pub travel_mm: f64,
    pub solver_steps: usize,
}

/// Something that holds a wall, at first a tube of the radius [`start_mm`], and the echoes about it.
pub(in crate::sweep) trait WallEngine {
    /// Measures the way of every echo to the wall, and moves its foot where `feet` says so, but no farther than a noise
    /// of `noise_mm` explains; returns the median of |miss|, mm.
    fn measure(&mut self, noise_mm: f64, feet: bool) -> Result<f64>;

    /// Draws the wall to the echoes.
    fn draw(&mut self, round: &Round) -> Result<Drawn>;

    /// The nodes' radii, mm, once the echoes have their last feet and misses.
    fn finish(self) -> Result<Vec<f64>>;
}

/// The radius of the tube that every fit begins with, mm.
pub(in crate::sweep) fn start_mm(echoes: &[Echo]) -> f64 {
    median(&mut echoes.iter().map(|e| e.radius_mm).collect::<Vec<_>>())
}

impl Wall {
    /// A tube that no echo has been held against yet.
    pub(in crate::sweep) fn tube(grid: &Grid, radius_mm: f64) -> Self {
        Self {
            radii_mm: vec![radius_mm; grid.node_count()],
            noise_mm: radius_mm,
            smoothness_mm2: 0.0,
            out_of_plane: OUT_OF_PLANE,
            iterations: 0,
            solver_steps: 0,
        }
    }

    /// What an echo is held against.
    pub(in crate::sweep) fn held<'a>(&'a self, grid: &'a Grid) -> Held<'a> {
        let Self { radii_mm, noise_mm, out_of_plane, .. } = self;
        Held { grid, radii_mm, noise_mm: *noise_mm, out_of_plane: *out_of_plane }
    }
}

/// Fits a wall. `roughness` is τ: λ = (noise/τ)².
pub(in crate::sweep) fn fit(
    engine: impl WallEngine,
    grid: &Grid,
    start_mm: f64,
    roughness: f64,
) -> Result<Wall> {
    let tube = Wall { radii_mm: Vec::new(), ..Wall::tube(grid, start_mm) };
    reweighted(engine, grid, start_mm, roughness, tube)
}

/// Goes on from a fitted wall, on the CPU.
pub(in crate::sweep) fn refit(grid: &Grid, echoes: &mut [Echo], roughness: f64, wall: Wall) -> Result<Wall> {
    let start_mm = start_mm(echoes);
    let engine = OnCpu { grid, echoes, solver: Solver::new(*grid), wall: wall.clone() };
    reweighted(engine, grid, start_mm, roughness, wall)
}

/// The first iterations of a wall are rough ones.
fn reweighted(
    mut engine: impl WallEngine,
    grid: &Grid,
    start_mm: f64,
    roughness: f64,
    mut wall: Wall,
) -> Result<Wall> {
    let first = wall.iterations;
    for iteration in first..first + MOST_ITERATIONS {
        let rough = iteration < ROUGH_ITERATIONS;
        let miss_mm = engine.measure(wall.noise_mm, !rough)?;
        wall.noise_mm = smoothed_noise(grid, noise_mm(miss_mm), roughness);
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

/// The noise with what is added to it so that perfect echoes are not interpolated, mm.
pub(in crate::sweep) fn smoothed_noise(grid: &Grid, noise_mm: f64, roughness: f64) -> f64 {
    noise_mm.hypot(CELL_NOISE * roughness * grid.arc_mm)
}

/// Huber's weight of an echo that lies `miss_mm` off the wall.
pub(in crate::sweep) fn huber(noise_mm: f64, miss_mm: f64) -> f64 {
    (HUBER * noise_mm / miss_mm.max(f64::MIN_POSITIVE)).min(1.0)
}

/// Measures every echo against the wall, and with `feet` moves its foot.
pub(in crate::sweep) fn measure(grid: &Grid, echoes: &mut [Echo], wall: &Wall, feet: bool) {
    echoes.par_chunks_mut(TASK).for_each(|task| {
        for echo in task {
            echo.measure(wall.held(grid), feet);
        }
    });
}

/// The fit on the CPU, in f64.
pub(in crate::sweep) struct OnCpu<'a> {
    grid: &'a Grid,
    echoes: &'a mut [Echo],
    solver: Solver,
    wall: Wall,
}

impl<'a> OnCpu<'a> {
    /// A tube of the radius `start_mm` and echoes sorted along the axis.
    pub(in crate::sweep) fn new(grid: &'a Grid, echoes: &'a mut [Echo], start_mm: f64) -> Self {
        Self { grid, echoes, solver: Solver::new(*grid), wall: Wall::tube(grid, start_mm) }
    }

    fn equations(&mut self, rough: bool) -> Equations {
        let Self { grid, echoes, wall, .. } = self;
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
                    let measured = echo.measure(wall.held(grid), false);
                    let miss = echo.miss_mm.abs();
                    if !rough && miss > gate(wall.noise_mm, measured.wall_mm) {
                        continue;
                    }
                    let corners = grid.corners(ring, node);
                    let weight = huber(wall.noise_mm, miss) * measured.weight * echo.weight;
                    sums.add(&corners, weight, measured.wall_mm + measured.radial_mm);
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
        self.wall.noise_mm = noise_mm;
        measure(self.grid, self.echoes, &self.wall, feet);
        Ok(median(&mut self.echoes.iter().map(|e| e.miss_mm.abs()).collect::<Vec<_>>()))
    }

    fn draw(&mut self, round: &Round) -> Result<Drawn> {
        self.wall.noise_mm = round.noise_mm;
        let equations = self.equations(round.rough);
        let radii_mm = &mut self.wall.radii_mm;
        let before = radii_mm.clone();
        let system = System::plain(&equations, round.smoothness_mm2);
        let solver_steps = self.solver.solve(&system, round.tolerance, radii_mm);
        let travel = before.iter().zip(&*radii_mm).map(|(a, b)| (a - b).abs()).sum::<f64>();
        Ok(Drawn { travel_mm: travel / before.len() as f64, solver_steps })
    }

    fn finish(self) -> Result<Vec<f64>> {
        Ok(self.wall.radii_mm)
    }
}
