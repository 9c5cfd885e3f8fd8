//! The fit of a wall on the CPU, in f64.

use super::equations::Equations;
use super::fit::{Reweighting, Solution, Wall, WallEngine};
use super::residual::{TASK, gate};
use super::solver::{MAX_STEPS, System, solve};
use crate::Result;
use crate::numerics::robust::{huber_weight, median_size};
use crate::numerics::vectorized;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::WallGrid;
use rayon::prelude::*;

/// A wall on the CPU, and its echoes, sorted along the axis.
pub(super) struct CpuWallEngine<'a> {
    grid: &'a WallGrid,
    echoes: &'a mut [Echo],
    wall: Wall,
}

impl<'a> CpuWallEngine<'a> {
    pub(super) fn new(grid: &'a WallGrid, echoes: &'a mut [Echo], wall: Wall) -> Self {
        Self { grid, echoes, wall }
    }

    fn equations(&mut self, warm_up: bool) -> Equations {
        let Self { grid, echoes, wall, .. } = self;
        let parts: Vec<Equations> = echoes
            .par_chunks_mut(TASK)
            .map(|task| {
                let mut sums = Equations::about(grid, task);
                let model = wall.residual_model(grid);
                vectorized(
                    #[inline(always)]
                    || {
                        model.measure_each(task, false, |_, echo, corners, measured| {
                            let residual = echo.residual_mm.abs();
                            if !warm_up && residual > gate(wall.noise_mm, measured.wall_mm) {
                                return;
                            }
                            let weight = huber_weight(wall.noise_mm, residual)
                                * measured.weight
                                * f64::from(echo.weight);
                            sums.add(corners, weight, measured.wall_mm + measured.radial_mm);
                        });
                    },
                );
                sums
            })
            .collect();
        Equations::sum(grid, &parts)
    }
}

impl WallEngine for CpuWallEngine<'_> {
    fn measure(&mut self, noise_mm: f64, project: bool) -> Result<f64> {
        self.wall.noise_mm = noise_mm;
        let Self { grid, echoes, wall } = self;
        let model = wall.residual_model(grid);
        let mut residuals_mm = vec![0.0; echoes.len()];
        // Smaller tasks, since nothing is summed: all threads have some.
        let tasks = echoes.par_chunks_mut(TASK / 8).zip(residuals_mm.par_chunks_mut(TASK / 8));
        tasks.for_each(|(task, residuals_mm)| {
            vectorized(
                #[inline(always)]
                || {
                    model.measure_each(task, project, |i, echo, _, _| {
                        residuals_mm[i] = echo.single_residual_mm()
                    })
                },
            );
        });
        Ok(median_size(&residuals_mm))
    }

    fn solve(&mut self, reweighting: &Reweighting) -> Result<Solution> {
        self.wall.noise_mm = reweighting.noise_mm;
        let equations = self.equations(reweighting.warm_up);
        let Wall { radii_mm, local, .. } = &mut self.wall;
        let before = radii_mm.clone();
        let system = System { local, ..System::plain(&equations, reweighting.smoothness_mm2) };
        let solved = solve(self.grid, &system, reweighting.tolerance, MAX_STEPS, radii_mm)?;
        let tasks =
            before.par_chunks(TASK).zip(radii_mm.par_chunks(TASK)).zip(equations.rows().par_chunks(TASK));
        let parts: Vec<[f64; 2]> =
            tasks.map(|((before, after), rows)| travels(before, after, rows)).collect();
        let [travel, weight] =
            parts.iter().fold([0.0; 2], |[a, b], [travel, weight]| [a + travel, b + weight]);
        let residual_mm = self.measure(reweighting.noise_mm, reweighting.project)?;
        Ok(Solution { travel_mm: travel / weight.max(f64::MIN_POSITIVE), solved, residual_mm })
    }

    fn finish(self) -> Result<Vec<f64>> {
        Ok(self.wall.radii_mm)
    }
}

/// The sums of the weighted distances that nodes travel, mm, and of their weights: the diagonal of the equations.
fn travels(before_mm: &[f64], after_mm: &[f64], rows: &[[f64; 5]]) -> [f64; 2] {
    let travels = before_mm.iter().zip(after_mm).map(|(a, b)| (a - b).abs());
    travels.zip(rows).fold([0.0; 2], |[travel, weight], (t, row)| [travel + row[0] * t, weight + row[0]])
}
