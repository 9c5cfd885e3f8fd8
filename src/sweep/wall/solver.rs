//! Conjugate gradients for the equations of a wall.

use super::bending::LocalSmoothness;
use super::equations::Equations;
use crate::numerics::banded::Factored;
use crate::sweep::prepare::grid::WallGrid;
use crate::{Error, Result};
use realfft::num_complex::Complex64;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::sync::Arc;

/// The system to solve: points, smoothness, and further couplings between nodes.
pub(in crate::sweep) struct System<'a> {
    pub equations: &'a Equations,
    /// λ, mm².
    pub smoothness_mm2: f64,
    pub local: &'a LocalSmoothness,
    /// Adds the product of further couplings with x to the second argument.
    pub coupling: &'a dyn Fn(&[f64], &mut [f64]),
    /// Share of the points' weight that these couplings leave to the first harmonic of a ring, for the preconditioner.
    pub first_harmonic: f64,
}

impl<'a> System<'a> {
    /// Points and even smoothness only.
    pub(in crate::sweep) fn plain(equations: &'a Equations, smoothness_mm2: f64) -> Self {
        let local = LocalSmoothness::EVEN;
        Self { equations, smoothness_mm2, local, coupling: &|_, _| (), first_harmonic: 1.0 }
    }
}

/// The minimum of `Σ w (x - y)² + λ ∫ |bending|² dA` over the values at a grid's nodes.
///
/// Matrix-free conjugate gradients. The preconditioner is the same problem with the weights of each ring spread evenly
/// over it: a Fourier transform about the axis separates it into one pentadiagonal system per frequency. It inverts the
/// bending term exactly, so the number of steps hardly depends on the number of nodes.
pub(in crate::sweep) struct Solver {
    grid: WallGrid,
    forward: Arc<dyn RealToComplex<f64>>,
    backward: Arc<dyn ComplexToReal<f64>>,
    max_steps: usize,
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

impl Solver {
    pub(in crate::sweep) fn new(grid: WallGrid) -> Self {
        let mut planner = RealFftPlanner::new();
        let (forward, backward) =
            (planner.plan_fft_forward(grid.nodes), planner.plan_fft_inverse(grid.nodes));
        Self { grid, forward, backward, max_steps: MAX_STEPS }
    }

    /// A solver over another grid with the same number of nodes per ring, with at most `max_steps` steps.
    pub(in crate::sweep) fn over(&self, grid: WallGrid, max_steps: usize) -> Self {
        let (forward, backward) = (self.forward.clone(), self.backward.clone());
        Self { grid, forward, backward, max_steps }
    }

    /// Improves `x` until the residual is `tolerance` times that of `x = 0`, or the steps run out.
    ///
    /// # Errors
    /// [`Error::Solver`] where the equations are not positive definite or hold numbers that are not finite.
    pub(in crate::sweep) fn solve(&self, system: &System, tolerance: f64, x: &mut [f64]) -> Result<Solved> {
        let System { equations, smoothness_mm2, local, coupling, .. } = *system;
        let count = self.grid.node_count();
        let precondition = self.preconditioner(system)?;
        let right: Vec<f64> = equations.rows().iter().map(|row| row[4]).collect();
        let mut product = vec![0.0; count];
        let apply = |x: &[f64], out: &mut [f64]| {
            equations.apply(&self.grid, x, out);
            coupling(x, out);
            self.grid.add_bending(x, smoothness_mm2, local, out);
        };
        apply(x, &mut product);
        let mut residual: Vec<f64> = right.iter().zip(&product).map(|(b, a)| b - a).collect();
        let mut z = right;
        self.precondition(&precondition, &mut z);
        // In the norm of the preconditioner, which weights a residual by its effect on x.
        let enough =
            tolerance * tolerance * dot(&z, &equations.rows().iter().map(|row| row[4]).collect::<Vec<_>>());
        z.copy_from_slice(&residual);
        self.precondition(&precondition, &mut z);
        let mut direction = z.clone();
        let mut size = dot(&residual, &z);
        for step in 0..self.max_steps {
            if size <= enough {
                return Ok(Solved { steps: step, converged: true });
            }
            if !size.is_finite() {
                return Err(broken("square of the wall equations' residual", size));
            }
            apply(&direction, &mut product);
            let curvature = dot(&direction, &product);
            if !(curvature.is_finite() && curvature > 0.0) {
                return Err(broken("curvature of the wall equations", curvature));
            }
            let alpha = size / curvature;
            for i in 0..count {
                x[i] += alpha * direction[i];
                residual[i] -= alpha * product[i];
            }
            z.copy_from_slice(&residual);
            self.precondition(&precondition, &mut z);
            let next = dot(&residual, &z);
            let beta = next / size;
            size = next;
            for i in 0..count {
                direction[i] = z[i] + beta * direction[i];
            }
        }
        Ok(Solved { steps: self.max_steps, converged: size <= enough })
    }

    /// One factored system per frequency about the axis.
    fn preconditioner(&self, system: &System) -> Result<Vec<Factored>> {
        let System { equations, smoothness_mm2, local, first_harmonic, .. } = *system;
        let weights = self.grid.even_weights(equations.ring_weights(&self.grid));
        (0..=self.grid.nodes / 2)
            .map(|frequency| {
                let share = if frequency == 1 { first_harmonic } else { 1.0 };
                let weights: Vec<f64> = weights.iter().map(|weight| weight * share).collect();
                let system = self.grid.system(frequency, &weights, smoothness_mm2, local);
                // Without one of them, those after it would be taken for lower frequencies.
                system
                    .factored()
                    .ok_or_else(|| broken("weight of all echoes on the wall", weights.iter().sum()))
            })
            .collect()
    }

    /// Applies the preconditioner for rings of these weights to `x`.
    #[cfg(all(test, feature = "gpu"))]
    pub(in crate::sweep) fn precondition_evenly(
        &self,
        ring_weights: Vec<f64>,
        smoothness: f64,
        x: &mut [f64],
    ) {
        let weights = self.grid.even_weights(ring_weights);
        let system =
            |frequency| self.grid.system(frequency, &weights, smoothness, LocalSmoothness::EVEN).factored();
        let systems: Option<Vec<Factored>> = (0..=self.grid.nodes / 2).map(system).collect();
        self.precondition(&systems.expect("positive definite systems"), x);
    }

    fn precondition(&self, systems: &[Factored], x: &mut [f64]) {
        let WallGrid { rings, nodes, .. } = self.grid;
        let frequencies = nodes / 2 + 1;
        let mut spectrum = vec![Complex64::default(); rings * frequencies];
        let mut scratch = self.forward.make_scratch_vec();
        for (ring, out) in x.chunks_exact_mut(nodes).zip(spectrum.chunks_exact_mut(frequencies)) {
            // Fails only where lengths differ from the plan's.
            let _ = self.forward.process_with_scratch(ring, out, &mut scratch);
        }
        let mut column = vec![Complex64::default(); rings];
        for (frequency, system) in systems.iter().enumerate() {
            for ring in 0..rings {
                column[ring] = spectrum[ring * frequencies + frequency];
            }
            column = system.solve(column);
            for ring in 0..rings {
                spectrum[ring * frequencies + frequency] = column[ring] / nodes as f64;
            }
        }
        let mut scratch = self.backward.make_scratch_vec();
        for (ring, out) in x.chunks_exact_mut(nodes).zip(spectrum.chunks_exact_mut(frequencies)) {
            // These two are real; rounding must not make the transform refuse them.
            out[0].im = 0.0;
            if nodes % 2 == 0 {
                out[frequencies - 1].im = 0.0;
            }
            let _ = self.backward.process_with_scratch(out, ring, &mut scratch);
        }
    }
}

fn broken(what: &'static str, found: f64) -> Error {
    Error::Solver { what, found: found.to_string(), expected: "a finite number above 0" }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
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
        equations.apply(&GRID, x, &mut product);
        GRID.add_bending(x, smoothness, LocalSmoothness::EVEN, &mut product);
        product.iter().zip(equations.rows()).map(|(a, row)| (a - row[4]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn the_solver_solves_the_equations() {
        let equations = some_equations();
        for smoothness in [1e-4, 1.0, 1e4] {
            let mut x = vec![0.0; 48];
            let solved = Solver::new(GRID).solve(&System::plain(&equations, smoothness), 1e-12, &mut x);
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
        let few = Solver::new(GRID).over(GRID, 2);
        let solved = few.solve(&System::plain(&equations, 1e-4), 1e-12, &mut vec![0.0; 48]).unwrap();
        assert_eq!(solved, Solved { steps: 2, converged: false });
    }

    #[test]
    fn equations_without_a_minimum_are_refused() {
        let message = |equations: &Equations, smoothness, coupling: &dyn Fn(&[f64], &mut [f64])| {
            let system = System { coupling, ..System::plain(equations, smoothness) };
            Solver::new(GRID).solve(&system, 1e-12, &mut vec![0.0; 48]).unwrap_err().to_string()
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
