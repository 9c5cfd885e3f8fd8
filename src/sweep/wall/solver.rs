//! Conjugate gradients for the equations of a wall.

use super::bending::LocalSmoothness;
use super::equations::Equations;
use super::multigrid::Multigrid;
use super::operator::Operator;
use crate::numerics::Scalar;
use crate::sweep::prepare::grid::WallGrid;
use crate::{Error, Result};
use rayon::prelude::*;

/// Adds the product of couplings with a vector to the second argument.
type Coupling<'a> = dyn Fn(&[f64], &mut [f64]) + Sync + 'a;

/// The system to solve: points, smoothness, and further couplings between nodes.
pub(in crate::sweep) struct System<'a> {
    pub equations: &'a Equations,
    /// λ, mm².
    pub smoothness_mm2: f64,
    pub local: &'a LocalSmoothness,
    /// Adds the product of further couplings with x to the second argument.
    pub coupling: &'a Coupling<'a>,
}

impl<'a> System<'a> {
    /// Points and even smoothness only.
    pub(in crate::sweep) fn plain(equations: &'a Equations, smoothness_mm2: f64) -> Self {
        Self { equations, smoothness_mm2, local: LocalSmoothness::EVEN, coupling: &|_, _| () }
    }
}

/// How conjugate gradients ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::sweep) struct Solved {
    pub steps: usize,
    /// Whether the residual is as small as asked for; otherwise the number of steps ran out.
    pub converged: bool,
}

/// Largest number of steps of conjugate gradients.
pub(in crate::sweep) const MAX_STEPS: usize = 100;

/// Numbers of a vector per parallel task: a fixed number, so that sums do not depend on the number of threads.
const TASK: usize = 8192;
/// The same where nothing is summed.
const STEP_TASK: usize = 4096;
/// Tasks of a scalar product that a thread adds up side by side.
const SIDE_BY_SIDE: usize = 8;

/// A part of a vector that changes, and that of the vector which is added to it.
type Pair<'a> = (&'a mut [f64], &'a [f64]);

/// The minimum of `Σ w (x - y)² + λ ∫ |bending|² dA` over the values at a grid's nodes: conjugate gradients, preconditioned
/// by a [`Multigrid`] cycle.
///
/// Improves `x` until the residual is `tolerance` times that of `x = 0`, or `max_steps` run out.
///
/// # Errors
/// [`Error::Solver`] where the equations are not positive definite or hold numbers that are not finite.
pub(in crate::sweep) fn solve(
    grid: &WallGrid,
    system: &System,
    tolerance: f64,
    max_steps: usize,
    x: &mut [f64],
) -> Result<Solved> {
    let operator = Operator::of(system.equations, grid, system.smoothness_mm2, system.local);
    let right: Vec<f64> = system.equations.rows().par_iter().with_min_len(TASK).map(|row| row[4]).collect();
    Solver::of(&operator)?.solve(&right, system.coupling, tolerance, max_steps, x)
}

/// A matrix that is ready to be solved for many right-hand sides.
pub(in crate::sweep) struct Solver<'a> {
    operator: &'a Operator,
    multigrid: Multigrid,
}

impl<'a> Solver<'a> {
    /// # Errors
    /// [`Error::Solver`] where the matrix is not positive definite or holds numbers that are not finite.
    pub(in crate::sweep) fn of(operator: &'a Operator) -> Result<Self> {
        let multigrid = Multigrid::of(operator).ok_or_else(|| {
            broken("weight of all echoes on the wall", operator.lumped_weights().iter().sum())
        })?;
        Ok(Self { operator, multigrid })
    }

    /// As [`solve`], for the matrix with a coupling added to it.
    ///
    /// # Errors
    /// As [`solve`].
    pub(in crate::sweep) fn solve(
        &self,
        right: &[f64],
        coupling: &Coupling,
        tolerance: f64,
        max_steps: usize,
        x: &mut [f64],
    ) -> Result<Solved> {
        // On a thread of the pool, so that none of the many short tasks has to be handed over to it.
        rayon::scope(|_| self.conjugate_gradients(right, coupling, tolerance, max_steps, x))
    }

    fn conjugate_gradients(
        &self,
        right: &[f64],
        coupling: &Coupling,
        tolerance: f64,
        max_steps: usize,
        x: &mut [f64],
    ) -> Result<Solved> {
        let Self { operator, multigrid } = self;
        let mut room = multigrid.room();
        let zeros = || vec![0.0; right.len()];
        let (mut product, mut direction, mut next_direction) = (zeros(), zeros(), zeros());
        let mut residual = right.to_vec();
        // In the norm of the preconditioner, which weights a residual by its effect on x.
        let enough = tolerance * tolerance * dot(&residual, multigrid.precondition(&residual, &mut room));
        // From zero, that is the first step's already.
        let from_zero = x.iter().all(|x| *x == 0.0);
        if !from_zero {
            operator.apply(x, &mut product);
            coupling(x, &mut product);
            residual.iter_mut().zip(&product).for_each(|(right, product)| *right -= product);
        }
        let mut size = 0.0;
        for step in 0..=max_steps {
            let z = match step == 0 && from_zero {
                true => Multigrid::found(&room),
                false => multigrid.precondition(&residual, &mut room),
            };
            let next = dot(&residual, z);
            if next <= enough || step == max_steps {
                // The cycle that told how large the residual is takes most of it away.
                x.iter_mut().zip(z).for_each(|(x, z)| *x += f64::from(*z));
                return Ok(Solved { steps: step, converged: next <= enough });
            }
            if !next.is_finite() {
                return Err(broken("square of the wall equations' residual", next));
            }
            let beta = if step == 0 { 0.0 } else { next / size };
            size = next;
            operator.advance(z, beta, &direction, &mut next_direction, &mut product);
            std::mem::swap(&mut direction, &mut next_direction);
            coupling(&direction, &mut product);
            let curvature = dot(&direction, &product);
            if !(curvature.is_finite() && curvature > 0.0) {
                return Err(broken("curvature of the wall equations", curvature));
            }
            let alpha = size / curvature;
            let of_task = |((x, direction), (residual, product)): (Pair, Pair)| {
                x.iter_mut().zip(direction).for_each(|(x, direction)| *x += alpha * direction);
                residual.iter_mut().zip(product).for_each(|(residual, product)| *residual -= alpha * product);
            };
            let of_x = x.par_chunks_mut(STEP_TASK).zip(direction.par_chunks(STEP_TASK));
            of_x.zip(residual.par_chunks_mut(STEP_TASK).zip(product.par_chunks(STEP_TASK))).for_each(of_task);
        }
        unreachable!("the last step returns")
    }
}

fn broken(what: &'static str, found: f64) -> Error {
    Error::Solver { what, found: found.to_string(), expected: "a finite number above 0" }
}

/// The scalar product, in a fixed order.
fn dot<T: Scalar>(a: &[f64], b: &[T]) -> f64 {
    // Some tasks side by side: sums that do not wait for each other.
    let of_tasks = |(a, b): (&[f64], &[T])| -> Vec<f64> {
        let tasks: Vec<(&[f64], &[T])> = a.chunks(TASK).zip(b.chunks(TASK)).collect();
        let mut sums = vec![0.0; tasks.len()];
        match <[(&[f64], &[T]); SIDE_BY_SIDE]>::try_from(tasks) {
            Ok(tasks) => sums.copy_from_slice(&products_of(tasks)),
            Err(tasks) => sums.iter_mut().zip(tasks).for_each(|(sum, task)| [*sum] = products_of([task])),
        }
        sums
    };
    let runs = a.par_chunks(TASK * SIDE_BY_SIDE).zip(b.par_chunks(TASK * SIDE_BY_SIDE));
    let parts: Vec<f64> = runs.flat_map_iter(of_tasks).collect();
    parts.iter().sum()
}

/// Scalar products of tasks, all but the last equally long.
fn products_of<T: Scalar, const N: usize>(tasks: [(&[f64], &[T]); N]) -> [f64; N] {
    let together = tasks.iter().map(|(a, _)| a.len()).min().unwrap_or(0);
    let fronts = tasks.map(|(a, b)| (&a[..together], &b[..together]));
    let mut sums = [0.0; N];
    for i in 0..together {
        for (sum, (a, b)) in sums.iter_mut().zip(fronts) {
            *sum += a[i] * b[i].to_f64();
        }
    }
    for (sum, (a, b)) in sums.iter_mut().zip(tasks) {
        for (a, b) in a[together..].iter().zip(&b[together..]) {
            *sum += a * b.to_f64();
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: WallGrid = WallGrid { rings: 6, nodes: 8, step_mm: 1.3, arc_mm: 0.9 };

    fn some_equations() -> Equations {
        let mut equations = Equations::over(&GRID, 0..GRID.rings);
        for i in 0..200 {
            let (ring, node) = (5.0 * (0.618 * f64::from(i)).fract(), 8.0 * (0.414 * f64::from(i)).fract());
            equations.add(&GRID.corners(ring, node), 1.0 + 0.01 * f64::from(i), (0.1 * f64::from(i)).sin());
        }
        equations
    }

    fn residual(equations: &Equations, smoothness: f64, x: &[f64]) -> f64 {
        let mut product = vec![0.0; x.len()];
        Operator::of(equations, &GRID, smoothness, LocalSmoothness::EVEN).apply(x, &mut product);
        product.iter().zip(equations.rows()).map(|(a, row)| (a - row[4]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn the_solver_solves_the_equations() {
        let equations = some_equations();
        for smoothness in [1e-4, 1.0, 1e4] {
            let mut x = vec![0.0; 48];
            let solved = solve(&GRID, &System::plain(&equations, smoothness), 1e-12, MAX_STEPS, &mut x);
            let Solved { steps, converged } = solved.unwrap();
            let scale = 1.0 + smoothness;
            assert!(residual(&equations, smoothness, &x) < 1e-9 * scale, "{smoothness}: {steps} steps");
            assert!(converged && steps < MAX_STEPS, "{smoothness}");
            x[7] += 0.01;
            assert!(residual(&equations, smoothness, &x) > 1e-6 * scale);
        }
    }

    #[test]
    fn too_few_steps_are_no_convergence() {
        let equations = some_equations();
        let solved = solve(&GRID, &System::plain(&equations, 1e-4), 1e-12, 2, &mut vec![0.0; 48]).unwrap();
        assert_eq!(solved, Solved { steps: 2, converged: false });
    }

    #[test]
    fn equations_without_a_minimum_are_refused() {
        let message = |equations: &Equations, smoothness, coupling: &Coupling| {
            let system = System { coupling, ..System::plain(equations, smoothness) };
            solve(&GRID, &system, 1e-12, MAX_STEPS, &mut vec![0.0; 48]).unwrap_err().to_string()
        };
        let mut with_nan = some_equations();
        with_nan.add(&GRID.corners(2.5, 3.5), 1.0, f64::NAN);
        let found = message(&with_nan, 1.0, &|_, _| ());
        assert_eq!(
            found,
            "square of the wall equations' residual: found NaN, expected a finite number above 0"
        );
        let mut with_nan = some_equations();
        with_nan.add(&GRID.corners(2.5, 3.5), f64::NAN, 1.0);
        assert!(
            message(&with_nan, 1.0, &|_, _| ()).starts_with("weight of all echoes on the wall: found NaN")
        );
        let endless = message(&some_equations(), f64::INFINITY, &|_, _| ());
        assert!(endless.contains("expected a finite number above 0"), "{endless}");
        // A coupling that outweighs the echoes: the system has negative curvature.
        let negative =
            |x: &[f64], out: &mut [f64]| out.iter_mut().zip(x).for_each(|(out, x)| *out -= 1e6 * x);
        let found = message(&some_equations(), 1.0, &negative);
        assert!(found.starts_with("curvature of the wall equations: found -"), "{found}");
    }
}
