//! Conjugate gradients for the equations of a wall.

use super::bending::LocalSmoothness;
use super::equations::Equations;
use crate::numerics::banded::Factored;
use crate::sweep::prepare::grid::WallGrid;
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

    /// Improves `x` until the residual is `tolerance` times that of `x = 0`; returns the number of steps.
    pub(in crate::sweep) fn solve(&self, system: &System, tolerance: f64, x: &mut [f64]) -> usize {
        let System { equations, smoothness_mm2, local, coupling, .. } = *system;
        let count = self.grid.node_count();
        let precondition = self.preconditioner(system);
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
            if size.is_nan() || size <= enough {
                return step;
            }
            apply(&direction, &mut product);
            let alpha = size / dot(&direction, &product);
            if !alpha.is_finite() {
                return step;
            }
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
        self.max_steps
    }

    /// One factored system per frequency about the axis.
    fn preconditioner(&self, system: &System) -> Vec<Factored> {
        let System { equations, smoothness_mm2, local, first_harmonic, .. } = *system;
        let weights = self.grid.even_weights(equations.ring_weights(&self.grid));
        (0..=self.grid.nodes / 2)
            .filter_map(|frequency| {
                let share = if frequency == 1 { first_harmonic } else { 1.0 };
                let weights: Vec<f64> = weights.iter().map(|weight| weight * share).collect();
                self.grid.system(frequency, &weights, smoothness_mm2, local).factored()
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
        let systems: Vec<Factored> = (0..=self.grid.nodes / 2).filter_map(system).collect();
        self.precondition(&systems, x);
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
            let steps = Solver::new(GRID).solve(&System::plain(&equations, smoothness), 1e-12, &mut x);
            let scale = 1.0 + smoothness;
            assert!(residual(&equations, smoothness, &x) < 1e-9 * scale, "{smoothness}: {steps} steps");
            assert!(steps < MAX_STEPS, "{smoothness}");
            x[7] += 0.01;
            assert!(residual(&equations, smoothness, &x) > 1e-6 * scale);
        }
    }
}
