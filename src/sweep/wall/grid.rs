//! The wall as a function on a grid about the axis: its faces, its bending, and the least-squares equations over it.

use crate::numerics::banded::{Factored, Pentadiagonal};
use crate::sweep::median;
use realfft::num_complex::Complex64;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::f64::consts::TAU;
use std::ops::Range;
use std::sync::Arc;

/// `rings` rings of `nodes` nodes; node (k, j) has index `k·nodes + j` and lies at `θ = 2πj/nodes`. Faces and
/// triangles are those of [`crate::cylinders::Tube`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::sweep) struct Grid {
    pub rings: usize,
    pub nodes: usize,
    /// Distance of two rings, mm.
    pub step_mm: f64,
    /// Distance of two nodes of a ring, mm, on a tube of the median radius.
    pub arc_mm: f64,
}

/// A place on the grid: the triangle that it lies in, as node indices, and its barycentric weights there.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Corners {
    /// a, b or a', b'.
    pub nodes: [usize; 3],
    pub weights: [f64; 3],
    /// Whether it is the bottom triangle (a, b, b').
    pub bottom: bool,
}

impl Corners {
    /// The value there of a function on the grid.
    pub(in crate::sweep) fn value(&self, x: &[f64]) -> f64 {
        self.nodes.iter().zip(self.weights).map(|(&node, weight)| x[node] * weight).sum()
    }

    /// The node that has the largest weight.
    pub(in crate::sweep) fn nearest(&self) -> usize {
        let nearest = (1..3).fold(0, |best, k| if self.weights[k] > self.weights[best] { k } else { best });
        self.nodes[nearest]
    }
}

impl Grid {
    pub(in crate::sweep) fn new(rings: usize, nodes: usize, step_mm: f64, radius_mm: f64) -> Self {
        Self { rings, nodes, step_mm, arc_mm: TAU * radius_mm / nodes as f64 }
    }

    pub(in crate::sweep) fn node_count(&self) -> usize {
        self.rings * self.nodes
    }

    /// The triangle at `ring` (0 to rings - 1) and `node` (any number; the grid is closed that way).
    pub(in crate::sweep) fn corners(&self, ring: f64, node: f64) -> Corners {
        let level = (ring.max(0.0) as usize).min(self.rings - 2);
        let up = (ring - level as f64).clamp(0.0, 1.0);
        let around = node.rem_euclid(self.nodes as f64);
        let j = (around as usize).min(self.nodes - 1);
        let round = (around - j as f64).clamp(0.0, 1.0);
        let next = if j + 1 == self.nodes { 0 } else { j + 1 };
        let row = level * self.nodes;
        let (a, b, b_up, a_up) = (row + j, row + next, row + self.nodes + next, row + self.nodes + j);
        if round >= up {
            Corners { nodes: [a, b, b_up], weights: [1.0 - round, round - up, up], bottom: true }
        } else {
            Corners { nodes: [a, a_up, b_up], weights: [1.0 - up, up - round, round], bottom: false }
        }
    }

    /// The median radius that distances about the axis are taken at, mm.
    pub(in crate::sweep) fn radius_mm(&self) -> f64 {
        self.arc_mm * self.nodes as f64 / TAU
    }

    /// Area that a node stands for, mm².
    pub(in crate::sweep) fn cell_mm2(&self) -> f64 {
        self.step_mm * self.arc_mm
    }

    /// The weights of rings spread evenly over their nodes, for [`Grid::system`].
    pub(in crate::sweep) fn even_weights(&self, ring_weights: Vec<f64>) -> Vec<f64> {
        let mut weights: Vec<f64> = ring_weights.into_iter().map(|w| w / self.nodes as f64).collect();
        // Rings without points must not make a system singular.
        let floor = 1e-6 * median(&mut weights.clone()).max(f64::MIN_POSITIVE) + 1e-12;
        weights.iter_mut().for_each(|w| *w += floor);
        weights
    }

    /// The equations along the axis of waves of that frequency about it, where each ring has even weights.
    pub(in crate::sweep) fn system(
        &self,
        frequency: usize,
        weights: &[f64],
        smoothness: f64,
        ease: &Ease,
    ) -> Pentadiagonal {
        let Self { rings, nodes, step_mm, arc_mm } = *self;
        let area = smoothness * self.cell_mm2();
        let around = (2.0 - 2.0 * (TAU * frequency as f64 / nodes as f64).cos()) / (arc_mm * arc_mm);
        let mut system = Pentadiagonal::zeros(rings);
        for ring in 0..rings - 2 {
            system.add_bend(ring, area / step_mm.powi(4) * ease.of(ring + 1));
        }
        for (ring, weight) in weights.iter().enumerate() {
            system.add_diagonal(ring, weight + area * around * around * ease.of(ring));
        }
        for ring in 0..rings - 1 {
            let twist = 2.0 * area * around / (step_mm * step_mm);
            system.add_pair(ring, twist * ease.of(ring), [-1.0, 1.0]);
        }
        system
    }

    /// Adds the gradient of the bending energy `½ ∫ r_ss² + 2 r_sθ² + r_θθ² dA` at `x`, times `weight` and the rings'
    /// `ease`, to `out`.
    ///
    /// Second differences along the axis are left out on the end rings: a straight wall bends nowhere, so ends
    /// are free and a cone stays a cone.
    pub(in crate::sweep) fn add_bending(&self, x: &[f64], weight: f64, ease: &Ease, out: &mut [f64]) {
        let Self { rings, nodes, step_mm, arc_mm } = *self;
        let area = self.cell_mm2() * weight;
        let along = area / step_mm.powi(4);
        let around = area / arc_mm.powi(4);
        let twist = 2.0 * area / (step_mm * arc_mm).powi(2);
        let next = |j: usize| if j + 1 == nodes { 0 } else { j + 1 };
        let mut bend = vec![0.0; nodes];
        for k in 0..rings {
            let row = k * nodes;
            let [along, around, twist] = [along, around, twist].map(|weight| weight * ease.of(k));
            if k >= 1 && k + 1 < rings {
                for i in row..row + nodes {
                    let d = along * (x[i - nodes] - 2.0 * x[i] + x[i + nodes]);
                    out[i - nodes] += d;
                    out[i] -= 2.0 * d;
                    out[i + nodes] += d;
                }
            }
            let ring = &x[row..row + nodes];
            let before = |j: usize| if j == 0 { nodes - 1 } else { j - 1 };
            for j in 0..nodes {
                bend[j] = around * (ring[before(j)] - 2.0 * ring[j] + ring[next(j)]);
            }
            for j in 0..nodes {
                out[row + j] += bend[before(j)] - 2.0 * bend[j] + bend[next(j)];
            }
            if k + 1 < rings {
                for j in 0..nodes {
                    let (a, b) = (row + j, row + next(j));
                    let d = twist * (x[b + nodes] - x[a + nodes] - x[b] + x[a]);
                    out[b + nodes] += d;
                    out[a + nodes] -= d;
                    out[b] -= d;
                    out[a] += d;
                }
            }
        }
    }
}

/// How much the bending of each ring counts; 1 for all by default.
#[derive(Debug, Clone, Default)]
pub(in crate::sweep) struct Ease(Vec<f64>);

impl Ease {
    fn of(&self, ring: usize) -> f64 {
        self.0.get(ring).copied().unwrap_or(1.0)
    }

    /// For a wall whose bending is not the same everywhere.
    ///
    /// Were it normal with the roughness τ, an expected `∫ |bending|²` of τ² would belong to each of its degrees of
    /// freedom. With Student's t in its stead, a ring that bends by more counts less, in proportion: the weights of
    /// iteratively reweighted least squares.
    pub(in crate::sweep) fn at_bends(grid: &Grid, radii_mm: &[f64], roughness: f64) -> Self {
        let energies = grid.ring_energies(radii_mm);
        let about = |k: usize| &energies[k.saturating_sub(1)..(k + 2).min(grid.rings)];
        let weight = |k: usize| {
            let energy = about(k).iter().sum::<f64>() / about(k).len() as f64;
            let freedom = energy / (roughness * roughness);
            ((EASE_FREEDOM + EASE_RING) / (EASE_FREEDOM + freedom)).clamp(LEAST_EASE, 1.0)
        };
        Self((0..grid.rings).map(weight).collect())
    }
}

/// Degrees of freedom of Student's t, …
const EASE_FREEDOM: f64 = 4.0;
/// … and of a ring: about two, each for the lowest two harmonics.
const EASE_RING: f64 = 4.0;
/// A wall is never taken to be rougher than ten times the roughness.
const LEAST_EASE: f64 = 0.01;

/// Weighted sums over points, as far as they couple neighbouring nodes.
#[derive(Debug, Clone)]
pub(in crate::sweep) struct Equations {
    /// First node held.
    first: usize,
    /// Per node: coupling to itself, to (k, j+1), (k+1, j) and (k+1, j+1), and the right-hand side.
    rows: Vec<[f64; 5]>,
}

impl Grid {
    /// `∫ |bending|² dA` over each ring.
    fn ring_energies(&self, x: &[f64]) -> Vec<f64> {
        let Self { rings, nodes, step_mm, arc_mm } = *self;
        let bends = |k: usize, j: usize| {
            let (i, next) = (k * nodes + j, k * nodes + (j + 1) % nodes);
            let before = k * nodes + (j + nodes - 1) % nodes;
            let around = (x[before] - 2.0 * x[i] + x[next]) / (arc_mm * arc_mm);
            let mut sum = around * around;
            if k + 1 < rings {
                let twist = (x[next + nodes] - x[i + nodes] - x[next] + x[i]) / (step_mm * arc_mm);
                sum += 2.0 * twist * twist;
                if k >= 1 {
                    let along = (x[i - nodes] - 2.0 * x[i] + x[i + nodes]) / (step_mm * step_mm);
                    sum += along * along;
                }
            }
            sum
        };
        (0..rings).map(|k| (0..nodes).map(|j| bends(k, j)).sum::<f64>() * self.cell_mm2()).collect()
    }
}

/// What is solved for: points, the wall's smoothness, and what else couples nodes.
pub(in crate::sweep) struct System<'a> {
    pub equations: &'a Equations,
    /// λ, mm².
    pub smoothness_mm2: f64,
    pub ease: &'a Ease,
    /// Adds further couplings, times x, to the product.
    pub coupling: &'a dyn Fn(&[f64], &mut [f64]),
    /// Share of the points' weight that these leave to the first harmonic of a ring, for the preconditioner.
    pub first_harmonic: f64,
}

impl<'a> System<'a> {
    /// Points and smoothness alone.
    pub(in crate::sweep) fn plain(equations: &'a Equations, smoothness_mm2: f64) -> Self {
        const EVEN: &Ease = &Ease(Vec::new());
        Self { equations, smoothness_mm2, ease: EVEN, coupling: &|_, _| (), first_harmonic: 1.0 }
    }
}

impl Equations {
    /// No points yet, over the rings `rings` of a grid.
    pub(in crate::sweep) fn over(grid: &Grid, rings: Range<usize>) -> Self {
        let first = rings.start * grid.nodes;
        Self { first, rows: vec![[0.0; 5]; rings.len() * grid.nodes] }
    }

    /// Adds a point: `weight · (x(corners) - value)²`.
    pub(in crate::sweep) fn add(&mut self, corners: &Corners, weight: f64, value: f64) {
        let [a, m, c] = corners.nodes.map(|n| n - self.first);
        let [p, q, r] = corners.weights;
        // a couples to b along the ring or to a' across; b to b' across, a' to b' along; a to b' always.
        let (from_a, to_c) = if corners.bottom { (1, 2) } else { (2, 1) };
        self.rows[a][0] += weight * p * p;
        self.rows[m][0] += weight * q * q;
        self.rows[c][0] += weight * r * r;
        self.rows[a][from_a] += weight * p * q;
        self.rows[m][to_c] += weight * q * r;
        self.rows[a][3] += weight * p * r;
        self.rows[a][4] += weight * p * value;
        self.rows[m][4] += weight * q * value;
        self.rows[c][4] += weight * r * value;
    }

    /// Adds sums over other points, as far as they lie on the nodes held here.
    pub(in crate::sweep) fn merge(&mut self, other: &Self) {
        let skipped = self.first.saturating_sub(other.first).min(other.rows.len());
        let shift = (other.first + skipped).saturating_sub(self.first).min(self.rows.len());
        for (mine, theirs) in self.rows[shift..].iter_mut().zip(&other.rows[skipped..]) {
            for (a, b) in mine.iter_mut().zip(theirs) {
                *a += b;
            }
        }
    }

    /// The sums of every node.
    #[cfg(all(test, feature = "gpu"))]
    pub(in crate::sweep) fn rows(&self) -> &[[f64; 5]] {
        &self.rows
    }

    /// Weighs all points anew.
    pub(in crate::sweep) fn scale(&mut self, factor: f64) {
        self.rows.as_flattened_mut().iter_mut().for_each(|x| *x *= factor);
    }

    /// Counts nodes from one that lies `nodes` before.
    pub(in crate::sweep) fn renumber(&mut self, nodes: usize) {
        self.first += nodes;
    }

    /// The equations of the change that `x` still needs on the rings `free`; the others are held where they are.
    pub(in crate::sweep) fn of_change(
        mut self,
        grid: &Grid,
        smoothness: f64,
        x: &[f64],
        free: Range<usize>,
    ) -> Self {
        let mut product = vec![0.0; x.len()];
        self.apply(grid, x, &mut product);
        grid.add_bending(x, smoothness, &Ease::default(), &mut product);
        let bending = smoothness * grid.cell_mm2() * (grid.step_mm.powi(-4) + grid.arc_mm.powi(-4));
        let stiff = HELD * (bending + self.rows.iter().fold(0.0, |most: f64, row| most.max(row[0])));
        for (node, (row, product)) in self.rows.iter_mut().zip(product).enumerate() {
            row[4] -= product;
            if !free.contains(&(node / grid.nodes)) {
                row[0] += stiff;
                row[4] = 0.0;
            }
        }
        self
    }

    /// `out = (points' couplings)·x`.
    fn apply(&self, grid: &Grid, x: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let nodes = grid.nodes;
        for k in 0..grid.rings {
            for j in 0..nodes {
                let a = k * nodes + j;
                let [own, along, across, diagonal, _] = self.rows[a];
                let b = if j + 1 == nodes { k * nodes } else { a + 1 };
                let mut sum = own * x[a] + along * x[b];
                out[b] += along * x[a];
                if k + 1 < grid.rings {
                    sum += across * x[a + nodes] + diagonal * x[b + nodes];
                    out[a + nodes] += across * x[a];
                    out[b + nodes] += diagonal * x[a];
                }
                out[a] += sum;
            }
        }
    }

    /// Total weight of the points on each ring.
    fn ring_weights(&self, grid: &Grid) -> Vec<f64> {
        let mut weights = vec![0.0; self.rows.len()];
        self.apply(grid, &vec![1.0; self.rows.len()], &mut weights);
        weights.chunks_exact(grid.nodes).map(|ring| ring.iter().sum()).collect()
    }
}

/// The minimum of `Σ w (x - y)² + λ ∫ |bending|² dA` over the values at a grid's nodes.
///
/// Found by conjugate gradients without a matrix. The preconditioner is the same problem with the weights of each ring
/// spread evenly over it: a Fourier transform about the axis parts it into one pentadiagonal system for each
/// frequency. It grasps the bending fully, so the count of steps hardly grows with the number of nodes.
pub(in crate::sweep) struct Solver {
    grid: Grid,
    forward: Arc<dyn RealToComplex<f64>>,
    backward: Arc<dyn ComplexToReal<f64>>,
    most_steps: usize,
}

/// Steps after which conjugate gradients give up to come nearer.
pub(in crate::sweep) const MOST_STEPS: usize = 100;
/// Nodes that are held are so many times as stiff as any other.
const HELD: f64 = 1e6;

impl Solver {
    pub(in crate::sweep) fn new(grid: Grid) -> Self {
        let mut planner = RealFftPlanner::new();
        let (forward, backward) =
            (planner.plan_fft_forward(grid.nodes), planner.plan_fft_inverse(grid.nodes));
        Self { grid, forward, backward, most_steps: MOST_STEPS }
    }

    /// A solver over another grid with as many nodes a ring, which takes at most so many steps.
    pub(in crate::sweep) fn over(&self, grid: Grid, most_steps: usize) -> Self {
        let (forward, backward) = (self.forward.clone(), self.backward.clone());
        Self { grid, forward, backward, most_steps }
    }

    /// Improves `x` until the residual is `tolerance` times that of `x = 0`; returns the number of steps.
    pub(in crate::sweep) fn solve(&self, system: &System, tolerance: f64, x: &mut [f64]) -> usize {
        let System { equations, smoothness_mm2, ease, coupling, .. } = *system;
        let count = self.grid.node_count();
        let precondition = self.preconditioner(system);
        let right: Vec<f64> = equations.rows.iter().map(|row| row[4]).collect();
        let mut product = vec![0.0; count];
        let apply = |x: &[f64], out: &mut [f64]| {
            equations.apply(&self.grid, x, out);
            coupling(x, out);
            self.grid.add_bending(x, smoothness_mm2, ease, out);
        };
        apply(x, &mut product);
        let mut residual: Vec<f64> = right.iter().zip(&product).map(|(b, a)| b - a).collect();
        let mut z = right;
        self.precondition(&precondition, &mut z);
        // In the norm of the preconditioner, which weighs a misfit by what it does to x.
        let enough =
            tolerance * tolerance * dot(&z, &equations.rows.iter().map(|row| row[4]).collect::<Vec<_>>());
        z.copy_from_slice(&residual);
        self.precondition(&precondition, &mut z);
        let mut direction = z.clone();
        let mut size = dot(&residual, &z);
        for step in 0..self.most_steps {
            if size.is_nan() || size <= enough {
                return step;
            }
            apply(&direction, &mut product);
            let length = size / dot(&direction, &product);
            if !length.is_finite() {
                return step;
            }
            for i in 0..count {
                x[i] += length * direction[i];
                residual[i] -= length * product[i];
            }
            z.copy_from_slice(&residual);
            self.precondition(&precondition, &mut z);
            let next = dot(&residual, &z);
            let turn = next / size;
            size = next;
            for i in 0..count {
                direction[i] = z[i] + turn * direction[i];
            }
        }
        self.most_steps
    }

    /// One system for each frequency about the axis.
    fn preconditioner(&self, system: &System) -> Vec<Factored> {
        let System { equations, smoothness_mm2, ease, first_harmonic, .. } = *system;
        let weights = self.grid.even_weights(equations.ring_weights(&self.grid));
        (0..=self.grid.nodes / 2)
            .filter_map(|frequency| {
                let share = if frequency == 1 { first_harmonic } else { 1.0 };
                let weights: Vec<f64> = weights.iter().map(|weight| weight * share).collect();
                self.grid.system(frequency, &weights, smoothness_mm2, ease).factored()
            })
            .collect()
    }

    /// The preconditioner of rings of these weights, applied to `x`.
    #[cfg(all(test, feature = "gpu"))]
    pub(in crate::sweep) fn precondition_evenly(
        &self,
        ring_weights: Vec<f64>,
        smoothness: f64,
        x: &mut [f64],
    ) {
        let weights = self.grid.even_weights(ring_weights);
        let system =
            |frequency| self.grid.system(frequency, &weights, smoothness, &Ease::default()).factored();
        let systems: Vec<Factored> = (0..=self.grid.nodes / 2).filter_map(system).collect();
        self.precondition(&systems, x);
    }

    fn precondition(&self, systems: &[Factored], x: &mut [f64]) {
        let Grid { rings, nodes, .. } = self.grid;
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

    const GRID: Grid = Grid { rings: 6, nodes: 8, step_mm: 1.3, arc_mm: 0.9 };

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
        GRID.add_bending(x, smoothness, &Ease::default(), &mut product);
        product.iter().zip(&equations.rows).map(|(a, row)| (a - row[4]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn a_place_is_the_weighted_mean_of_its_corners() {
        for (ring, node) in [(0.0, 0.0), (0.3, 0.7), (2.7, 7.9), (4.5, -0.2), (5.0, 8.0), (3.0, 3.0)] {
            let corners = GRID.corners(ring, node);
            assert!((corners.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(corners.weights.iter().all(|w| *w >= 0.0));
            let mean = |of: fn(usize) -> f64| -> f64 {
                corners.nodes.iter().zip(corners.weights).map(|(&n, w)| w * of(n)).sum()
            };
            assert!((mean(|n| (n / 8) as f64) - ring).abs() < 1e-12, "{ring} {corners:?}");
            let angle = |n: usize| (n % 8) as f64;
            let around = corners.nodes.map(|n| (angle(n) - node + 4.0).rem_euclid(8.0) - 4.0);
            let offset: f64 = around.iter().zip(corners.weights).map(|(a, w)| a * w).sum();
            assert!(offset.abs() < 1e-12, "{node} {corners:?}");
        }
    }

    #[test]
    fn a_cone_bends_nowhere() {
        let cone: Vec<f64> = (0..48).map(|i| 5.0 + 0.3 * f64::from(i / 8)).collect();
        let mut bending = vec![0.0; 48];
        GRID.add_bending(&cone, 7.0, &Ease::default(), &mut bending);
        assert!(bending.iter().all(|b| b.abs() < 1e-9), "{bending:?}");
        let mut dented = cone;
        dented[20] += 1.0;
        GRID.add_bending(&dented, 7.0, &Ease::default(), &mut bending);
        assert!(bending[20] > 1.0);
    }

    #[test]
    fn a_wall_is_eased_where_it_bends() {
        let cone: Vec<f64> = (0..48).map(|i| 5.0 + 0.3 * f64::from(i / 8)).collect();
        let even = Ease::at_bends(&GRID, &cone, 0.1);
        assert!((0..6).all(|k| even.of(k) == 1.0), "{even:?}");
        let step: Vec<f64> = (0..48).map(|i| if i < 8 { 5.0 } else { 8.0 }).collect();
        let eased = Ease::at_bends(&GRID, &step, 0.1);
        assert!(eased.of(1) < 0.1 && eased.of(5) == 1.0, "{eased:?}");
    }

    #[test]
    fn the_solver_solves_the_equations() {
        let equations = some_equations();
        for smoothness in [1e-4, 1.0, 1e4] {
            let mut x = vec![0.0; 48];
            let steps = Solver::new(GRID).solve(&System::plain(&equations, smoothness), 1e-12, &mut x);
            let scale = 1.0 + smoothness;
            assert!(residual(&equations, smoothness, &x) < 1e-9 * scale, "{smoothness}: {steps} steps");
            assert!(steps < MOST_STEPS, "{smoothness}");
            x[7] += 0.01;
            assert!(residual(&equations, smoothness, &x) > 1e-6 * scale);
        }
    }

    #[test]
    fn sums_over_parts_are_the_whole() {
        let mut parts = Equations::over(&GRID, 0..GRID.rings);
        let mut some = Equations::over(&GRID, 2..5);
        let corners = GRID.corners(2.6, 7.5);
        some.add(&corners, 2.0, 3.0);
        parts.merge(&some);
        let mut whole = Equations::over(&GRID, 0..GRID.rings);
        whole.add(&corners, 2.0, 3.0);
        assert_eq!(parts.rows, whole.rows);
    }
}
