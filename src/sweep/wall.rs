//! The wall about the axis: robust penalised least squares on radii, with every echo measured across the wall.

use super::echo::{Echo, gate};
use super::grid::{Equations, Grid, Solver};
use super::median;
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
/// Share of the noise to which the equations are solved.
const SOLVED_NOISE_SHARE: f64 = 1e-3;
/// Echoes that one task works through: a fixed number, so that sums do not depend on the number of threads.
const TASK: usize = 8192;

/// Fits a wall to echoes sorted along the axis. `roughness` is τ: λ = (noise/τ)².
pub(super) fn fit(grid: &Grid, echoes: &mut [Echo], roughness: f64) -> Wall {
    let solver = Solver::new(*grid);
    let start = median(&mut echoes.iter().map(|e| e.radius_mm).collect::<Vec<_>>());
    let mut wall = Wall {
        radii_mm: vec![start; grid.node_count()],
        noise_mm: start,
        smoothness_mm2: 0.0,
        iterations: 0,
        solver_steps: 0,
    };
    for iteration in 0..MOST_ITERATIONS {
        let rough = iteration < ROUGH_ITERATIONS;
        measure(grid, echoes, &wall, !rough);
        wall.noise_mm = noise(echoes).hypot(CELL_NOISE * roughness * grid.arc_mm);
        wall.smoothness_mm2 = (wall.noise_mm / roughness).powi(2);
        let equations = equations(grid, echoes, &wall, rough);
        let before = wall.radii_mm.clone();
        let tolerance = (SOLVED_NOISE_SHARE * wall.noise_mm / start).max(1e-10);
        wall.solver_steps += solver.solve(&equations, wall.smoothness_mm2, tolerance, &mut wall.radii_mm);
        wall.iterations = iteration + 1;
        let travel = before.iter().zip(&wall.radii_mm).map(|(a, b)| (a - b).abs()).sum::<f64>();
        let travel = travel / before.len() as f64;
        if !rough && travel <= (ENOUGH_RADII * start).max(ENOUGH_NOISE_SHARE * wall.noise_mm) {
            break;
        }
    }
    measure(grid, echoes, &wall, true);
    wall.noise_mm = noise(echoes);
    wall
}

fn measure(grid: &Grid, echoes: &mut [Echo], wall: &Wall, feet: bool) {
    echoes.par_chunks_mut(TASK).for_each(|task| {
        for echo in task {
            echo.measure(grid, &wall.radii_mm, wall.noise_mm, feet);
        }
    });
}

/// Standard deviation of normal noise with the echoes' median |miss|.
fn noise(echoes: &[Echo]) -> f64 {
    1.4826 * median(&mut echoes.iter().map(|e| e.miss_mm.abs()).collect::<Vec<_>>())
}

fn equations(grid: &Grid, echoes: &mut [Echo], wall: &Wall, rough: bool) -> Equations {
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
                let measured = echo.measure(grid, &wall.radii_mm, wall.noise_mm, false);
                let miss = echo.miss_mm.abs();
                if !rough && miss > gate(wall.noise_mm, measured.wall_mm) {
                    continue;
                }
                let robust = (HUBER * wall.noise_mm / miss.max(f64::MIN_POSITIVE)).min(1.0);
                let corners = grid.corners(ring, node);
                sums.add(
                    &corners,
                    robust * measured.weight * echo.weight,
                    measured.wall_mm + measured.radial_mm,
                );
            }
            sums
        })
        .collect();
    let mut whole = Equations::over(grid, 0..grid.rings);
    parts.iter().for_each(|part| whole.merge(part));
    whole
}
