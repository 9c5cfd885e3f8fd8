//! The matrix of the wall's equations, and its products with vectors, ring by ring on all threads.

use super::bending::LocalSmoothness;
use super::equations::Equations;
use crate::numerics::Scalar;
use crate::sweep::prepare::grid::WallGrid;
use rayon::prelude::*;
use std::cell::RefCell;
use std::ops::Range;

/// Nodes per parallel task: fewer do not pay for a thread.
const TASK_NODES: usize = 1024;
/// Nodes of a grid that one thread is done with before others have begun.
const ALONE_NODES: usize = 6144;
/// Most rings per parallel task: windows of more leave the cache.
const TASK_RINGS: usize = 64;

/// The couplings of weighted echoes plus λ times those of the bending energy `½ ∫ r_ss² + 2 r_sθ² + r_θθ² dA`.
///
/// Second differences along the axis are left out on the end rings: the ends are free, so a cone has no bending energy.
///
/// In f64, or [rounded](Self::rounded) to f32.
#[derive(Debug, Clone)]
pub(in crate::sweep) struct Operator<T = f64> {
    pub grid: WallGrid,
    /// Per node: the echoes' coupling to itself.
    own: Vec<T>,
    couplings: Option<Couplings<T>>,
    /// λ, mm².
    pub smoothness_mm2: f64,
    /// λ and the area of a cell times the squares of second differences along the axis, about it, and of twists.
    along: f64,
    around: f64,
    twist: f64,
    local: LocalSmoothness,
}

/// The echoes' couplings between nodes. Planes hold one number more per ring: the last one's comes first as well.
#[derive(Debug, Clone)]
struct Couplings<T> {
    /// (k, j) to (k, j+1).
    along_ring: Vec<T>,
    /// (k-1, j) to (k, j), and to (k, j+1); zeros for k = 0 and behind the last ring.
    across: Vec<T>,
    diagonal: Vec<T>,
}

/// Some successive rings of values, with two nodes repeated on either side of each, so that no stencil has to wrap around.
#[derive(Debug, Default)]
pub(super) struct Window<T> {
    first: usize,
    width: usize,
    values: Vec<T>,
}

impl<T: Scalar> Window<T> {
    /// Calls `fill` with every ring of a range and room for its values.
    #[inline(always)]
    pub(super) fn fill(&mut self, nodes: usize, rings: Range<usize>, mut fill: impl FnMut(usize, &mut [T])) {
        self.first = rings.start;
        self.width = nodes + 4;
        if self.values.len() < rings.len() * self.width {
            self.values.resize(rings.len() * self.width, T::default());
        }
        for (ring, padded) in rings.zip(self.values.chunks_exact_mut(nodes + 4)) {
            fill(ring, &mut padded[2..nodes + 2]);
            for i in 0..2 {
                padded[i] = padded[2 + (2 * nodes + i - 2) % nodes];
                padded[nodes + 2 + i] = padded[2 + i % nodes];
            }
        }
    }

    #[inline(always)]
    fn padded(&self, ring: usize) -> &[T] {
        &self.values[(ring - self.first) * self.width..][..self.width]
    }

    /// The values of a ring.
    #[inline(always)]
    pub(super) fn ring(&self, ring: usize) -> &[T] {
        &self.padded(ring)[2..self.width - 2]
    }
}

/// Windows of a thread's tasks.
#[derive(Debug, Default)]
pub(super) struct Windows {
    pub exact: Window<f64>,
    pub rounded: [Window<f32>; 2],
}

thread_local! {
    static WINDOWS: RefCell<Windows> = RefCell::default();
}

/// Calls `task`, compiled for this processor, with windows to use.
#[inline(always)]
pub(super) fn with_windows(task: impl FnOnce(&mut Windows)) {
    WINDOWS.with_borrow_mut(|windows| {
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || task(windows),
        );
    });
}

/// Does tasks on all threads.
pub(super) fn for_each<T: Send>(mut tasks: Vec<T>, task: impl Fn(T) + Send + Sync) {
    match tasks.len() {
        1 => tasks.drain(..).for_each(task),
        _ => tasks.into_par_iter().with_max_len(1).for_each(task),
    }
}

impl WallGrid {
    /// The rings, in as many parts as keep all threads busy. No ring's values depend on it.
    pub(super) fn bands(&self) -> Vec<Range<usize>> {
        let Self { rings, nodes, .. } = *self;
        let least = if self.node_count() < ALONE_NODES { rings } else { TASK_NODES.div_ceil(nodes) };
        let of_thread = rings.div_ceil(rayon::current_num_threads());
        let even = of_thread.div_ceil(of_thread.div_ceil(TASK_RINGS)).max(least);
        (0..rings).step_by(even).map(|first| first..(first + even).min(rings)).collect()
    }

    /// Some rings and as many as `more` before and after them.
    pub(super) fn wider(&self, rings: &Range<usize>, more: usize) -> Range<usize> {
        rings.start.saturating_sub(more)..(rings.end + more).min(self.rings)
    }
}

/// The parts of a vector that belong to these rings, which follow each other, of `nodes` nodes.
pub(super) fn split<T>(
    mut values: &mut [T],
    nodes: usize,
    bands: impl Iterator<Item = Range<usize>>,
) -> Vec<&mut [T]> {
    bands
        .map(|band| {
            let (of_band, rest) = std::mem::take(&mut values).split_at_mut(band.len() * nodes);
            values = rest;
            of_band
        })
        .collect()
}

impl Operator {
    /// The matrix of equations over the rings of a grid.
    pub(in crate::sweep) fn of(
        equations: &Equations,
        grid: &WallGrid,
        smoothness_mm2: f64,
        local: &LocalSmoothness,
    ) -> Self {
        let WallGrid { rings, nodes, .. } = *grid;
        let rows = equations.rows();
        let mut couplings = Couplings {
            along_ring: vec![0.0; rings * (nodes + 1)],
            across: vec![0.0; (rings + 1) * (nodes + 1)],
            diagonal: vec![0.0; (rings + 1) * (nodes + 1)],
        };
        let fill = |planes: &mut [f64], part: usize, rings: usize| {
            let tasks = planes.par_chunks_exact_mut(nodes + 1).with_min_len(TASK_NODES.div_ceil(nodes));
            tasks.zip(rows.par_chunks_exact(nodes)).take(rings).for_each(|(plane, ring)| {
                plane[0] = ring[nodes - 1][part];
                plane[1..].iter_mut().zip(ring).for_each(|(to, row)| *to = row[part]);
            });
        };
        fill(&mut couplings.along_ring, 1, rings);
        fill(&mut couplings.across[nodes + 1..], 2, rings - 1);
        fill(&mut couplings.diagonal[nodes + 1..], 3, rings - 1);
        let own = rows.par_iter().with_min_len(TASK_NODES).map(|row| row[0]).collect();
        Self { couplings: Some(couplings), ..Self::lumped(grid, own, smoothness_mm2, local.clone()) }
    }

    /// The matrix of weights at the nodes themselves.
    pub(in crate::sweep) fn lumped(
        grid: &WallGrid,
        weights: Vec<f64>,
        smoothness_mm2: f64,
        local: LocalSmoothness,
    ) -> Self {
        let WallGrid { step_mm, arc_mm, .. } = *grid;
        let area = grid.cell_mm2() * smoothness_mm2;
        Self {
            grid: *grid,
            own: weights,
            couplings: None,
            smoothness_mm2,
            along: area / step_mm.powi(4),
            around: area / arc_mm.powi(4),
            twist: 2.0 * area / (step_mm * arc_mm).powi(2),
            local,
        }
    }

    /// The same in f32.
    pub(super) fn rounded(&self) -> Operator<f32> {
        let rounded = |values: &Vec<f64>| -> Vec<f32> {
            values.par_iter().with_min_len(TASK_NODES).map(|x| *x as f32).collect()
        };
        let couplings = self.couplings.as_ref().map(|couplings| Couplings {
            along_ring: rounded(&couplings.along_ring),
            across: rounded(&couplings.across),
            diagonal: rounded(&couplings.diagonal),
        });
        let Self { grid, smoothness_mm2, along, around, twist, ref local, .. } = *self;
        let (own, local) = (rounded(&self.own), local.clone());
        Operator { grid, own, couplings, smoothness_mm2, along, around, twist, local }
    }

    /// The diagonal of the matrix.
    pub(in crate::sweep) fn diagonal(&self) -> Vec<f64> {
        let nodes = self.grid.nodes;
        let mut diagonal = self.own.clone();
        let tasks = diagonal.par_chunks_exact_mut(nodes).with_min_len(TASK_NODES.div_ceil(nodes));
        tasks.enumerate().for_each(|(k, ring)| {
            let [below, here, above] = [k.checked_sub(1), Some(k), Some(k + 1)].map(|k| self.bending_of(k));
            let bending = below[0] + 4.0 * here[0] + above[0] + 6.0 * here[1] + 2.0 * (here[2] + below[2]);
            ring.iter_mut().for_each(|own| *own += bending);
        });
        diagonal
    }

    /// The echoes' weights with the couplings added to them. A wall of ones does not bend, to the bit.
    pub(in crate::sweep) fn lumped_weights(&self) -> Vec<f64> {
        let mut weights = vec![0.0; self.own.len()];
        self.apply(&vec![1.0; self.own.len()], &mut weights);
        weights
    }

    /// `out = A x`.
    pub(in crate::sweep) fn apply(&self, x: &[f64], out: &mut [f64]) {
        let nodes = self.grid.nodes;
        let bands = self.grid.bands();
        let parts = split(out, nodes, bands.iter().cloned());
        for_each(bands.into_iter().zip(parts).collect(), |(band, out)| {
            with_windows(
                #[inline(always)]
                |Windows { exact: window, .. }| {
                    let copy = |k: usize, ring: &mut [f64]| ring.copy_from_slice(&x[k * nodes..][..nodes]);
                    window.fill(nodes, self.grid.wider(&band, 2), copy);
                    for (k, out) in band.zip(out.chunks_exact_mut(nodes)) {
                        self.product(k, window, out);
                    }
                },
            );
        });
    }

    /// The next direction of conjugate gradients, `z + beta direction`, and its product with the matrix.
    pub(super) fn advance(
        &self,
        z: &[impl Scalar],
        beta: f64,
        direction: &[f64],
        next: &mut [f64],
        product: &mut [f64],
    ) {
        let nodes = self.grid.nodes;
        let bands = self.grid.bands();
        let [next, product] = [next, product].map(|out| split(out, nodes, bands.iter().cloned()));
        for_each(
            bands.into_iter().zip(next.into_iter().zip(product)).collect(),
            |(band, (next, product))| {
                with_windows(
                    #[inline(always)]
                    |Windows { exact: window, .. }| {
                        window.fill(
                            nodes,
                            self.grid.wider(&band, 2),
                            #[inline(always)]
                            |k, ring| {
                                let (z, direction) =
                                    (&z[k * nodes..][..nodes], &direction[k * nodes..][..nodes]);
                                for ((next, z), direction) in ring.iter_mut().zip(z).zip(direction) {
                                    *next = z.to_f64() + beta * direction;
                                }
                            },
                        );
                        let outs = next.chunks_exact_mut(nodes).zip(product.chunks_exact_mut(nodes));
                        for (k, (next, product)) in band.zip(outs) {
                            next.copy_from_slice(window.ring(k));
                            self.product(k, window, product);
                        }
                    },
                );
            },
        );
    }
}

impl<T: Scalar> Operator<T> {
    /// The factors of λ on the rings.
    pub(in crate::sweep) fn local(&self) -> &LocalSmoothness {
        &self.local
    }

    /// Weights of the bending on ring k: of second differences along the axis, about it, and of twists towards the next
    /// ring. 0 for rings that do not exist.
    fn bending_of(&self, k: Option<usize>) -> [f64; 3] {
        let rings = self.grid.rings;
        let Some(k) = k.filter(|&k| k < rings) else { return [0.0; 3] };
        let factor = self.local.factor(k);
        let only = |condition: bool, weight: f64| if condition { weight * factor } else { 0.0 };
        [only(k >= 1 && k + 1 < rings, self.along), only(true, self.around), only(k + 1 < rings, self.twist)]
    }

    /// The squares of the bending energy at node j of ring k: their weights, and their nodes with coefficients.
    pub(in crate::sweep) fn squares(&self, k: usize, j: usize) -> [(f64, [(usize, f64); 4]); 3] {
        let nodes = self.grid.nodes;
        let [along, around, twist] = self.bending_of(Some(k));
        let at = |ring: usize, node: usize| ring.min(self.grid.rings - 1) * nodes + node % nodes;
        let here = (at(k, j), -2.0);
        [
            (along, [(at(k.saturating_sub(1), j), 1.0), here, (at(k + 1, j), 1.0), (here.0, 0.0)]),
            (around, [(at(k, j + nodes - 1), 1.0), here, (at(k, j + 1), 1.0), (here.0, 0.0)]),
            (twist, [(here.0, 1.0), (at(k, j + 1), -1.0), (at(k + 1, j), -1.0), (at(k + 1, j + 1), 1.0)]),
        ]
    }

    /// `out = right - A x` on ring k.
    #[inline(always)]
    pub(super) fn residual(&self, k: usize, right: &[T], x: &Window<T>, out: &mut [T]) {
        self.product(k, x, out);
        let right = &right[k * self.grid.nodes..];
        out.iter_mut().zip(right).for_each(|(out, right)| *out = *right - *out);
    }

    /// `out = x + weight scale (right - A x)` on ring k, with a `scale` for every node.
    #[inline(always)]
    pub(super) fn relax(
        &self,
        k: usize,
        right: &[T],
        x: &Window<T>,
        (weight, scale): (T, &[T]),
        out: &mut [T],
    ) {
        self.product(k, x, out);
        let of_ring = k * self.grid.nodes;
        let (right, scale) = (&right[of_ring..], &scale[of_ring..]);
        for (((out, x), right), scale) in out.iter_mut().zip(x.ring(k)).zip(right).zip(scale) {
            *out = *x + weight * *scale * (*right - *out);
        }
    }

    /// The product of the matrix with `x` on ring k; `x` has two rings more on either side, as far as there are any.
    #[inline(always)]
    fn product(&self, k: usize, x: &Window<T>, out: &mut [T]) {
        let WallGrid { rings, nodes, .. } = self.grid;
        // Where a ring does not exist, the one at the end stands in with a weight of 0.
        let [k1, k2] = [1, 2].map(|away| k.saturating_sub(away));
        let [k3, k4] = [1, 2].map(|away| (k + away).min(rings - 1));
        let [below, here, above] =
            [k.checked_sub(1), Some(k), Some(k + 1)].map(|k| self.bending_of(k).map(T::from_f64));
        let two = T::from_f64(2.0);
        let [arch_below, arch, arch_above] = [below[0], here[0], above[0]];
        let (around, twist_below, twist_above) = (here[1], below[2], here[2]);

        let out = &mut out[..nodes];
        let [a, b, c] = [k1, k, k3].map(|ring| &x.padded(ring)[..nodes + 4]);
        let [two_below, two_above] = [k2, k4].map(|ring| &x.ring(ring)[..nodes]);
        let own = &self.own[k * nodes..(k + 1) * nodes];
        for j in 0..nodes {
            let x = b[j + 2];
            let (x_below, x_above) = (a[j + 2], c[j + 2]);
            // Second differences from first differences, which are exact where neighbours are alike.
            let [d0, d1, d2, d3] = [b[j + 1] - b[j], x - b[j + 1], b[j + 3] - x, b[j + 4] - b[j + 3]];
            let bends = around * ((d1 - d0) - two * (d2 - d1) + (d3 - d2));
            let (e0, e1, e2, e3) = (x_below - two_below[j], x - x_below, x_above - x, two_above[j] - x_above);
            let arches = arch_below * (e1 - e0) - two * (arch * (e2 - e1)) + arch_above * (e3 - e2);
            let twists_above = (c[j + 3] - x_above - d2) - (x_above - c[j + 1] - d1);
            let twists_below = (d1 - (x_below - a[j + 1])) - (d2 - (a[j + 3] - x_below));
            out[j] = own[j] * x + bends + arches + (twist_above * twists_above + twist_below * twists_below);
        }
        if let Some(Couplings { along_ring, across, diagonal }) = &self.couplings {
            let width = nodes + 1;
            let along_ring = &along_ring[k * width..(k + 1) * width];
            let (up_below, up) =
                (&across[k * width..(k + 1) * width], &across[(k + 1) * width..(k + 2) * width]);
            let (tilted_below, tilted) =
                (&diagonal[k * width..(k + 1) * width], &diagonal[(k + 1) * width..(k + 2) * width]);
            for j in 0..nodes {
                let along = along_ring[j + 1] * b[j + 3] + along_ring[j] * b[j + 1];
                let above = up[j + 1] * c[j + 2] + tilted[j + 1] * c[j + 3];
                let below = up_below[j + 1] * a[j + 2] + tilted_below[j] * a[j + 1];
                out[j] = out[j] + (along + above + below);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: WallGrid = WallGrid { rings: 6, nodes: 8, step_mm: 1.3, arc_mm: 0.9 };

    fn bending(grid: &WallGrid, smoothness: f64, local: LocalSmoothness) -> Operator {
        Operator::lumped(grid, vec![0.0; grid.node_count()], smoothness, local)
    }

    #[test]
    fn a_cone_bends_nowhere() {
        let bending = bending(&GRID, 7.0, LocalSmoothness::default());
        let cone: Vec<f64> = (0..48).map(|i| 5.0 + 0.3 * f64::from(i / 8)).collect();
        let mut gradient = vec![0.0; 48];
        bending.apply(&cone, &mut gradient);
        assert!(gradient.iter().all(|b| b.abs() < 1e-9), "{gradient:?}");
        let mut dented = cone;
        dented[20] += 1.0;
        bending.apply(&dented, &mut gradient);
        assert!(gradient[20] > 1.0);
    }

    /// Products and the diagonal, against squares that are added up one after the other, on grids of few rings and nodes
    /// too, where neighbours coincide.
    #[test]
    fn the_matrix_is_that_of_the_sum_of_squares() {
        for (rings, nodes) in [(2, 3), (3, 4), (4, 5), (7, 8), (9, 13)] {
            let grid = WallGrid { rings, nodes, ..GRID };
            let wave = |i: usize| (0.7 * (i * i) as f64).sin();
            let radii: Vec<f64> = (0..grid.node_count()).map(|i| 5.0 + wave(i)).collect();
            let local = LocalSmoothness::from_bending(&grid, &radii, 0.5);
            let mut equations = Equations::over(&grid, 0..rings);
            let points: Vec<(f64, f64)> = (0..40).map(|i| (4.0 * wave(i) + 4.0, 9.0 * wave(i + 7))).collect();
            points
                .iter()
                .for_each(|&(ring, node)| equations.add(&grid.corners(ring, node), 1.0 + node.abs(), 0.0));
            let operator = Operator::of(&equations, &grid, 0.3, &local);

            let x: Vec<f64> = (0..grid.node_count()).map(|i| wave(i + 3)).collect();
            let mut expected = vec![0.0; x.len()];
            let mut diagonal = vec![0.0; x.len()];
            let mut add = |weight: f64, terms: &[(usize, f64)]| {
                let value: f64 = terms.iter().map(|&(node, c)| c * x[node]).sum();
                for &(node, c) in terms {
                    expected[node] += weight * c * value;
                    let here: f64 = terms.iter().filter(|t| t.0 == node).map(|t| t.1).sum();
                    diagonal[node] += weight * c * here;
                }
            };
            for &(ring, node) in &points {
                let corners = grid.corners(ring, node);
                let terms: Vec<_> = corners.nodes.into_iter().zip(corners.weights).collect();
                add(1.0 + node.abs(), &terms);
            }
            for node in 0..x.len() {
                operator
                    .squares(node / nodes, node % nodes)
                    .iter()
                    .for_each(|(weight, terms)| add(*weight, terms));
            }
            let mut found = vec![f64::NAN; x.len()];
            operator.apply(&x, &mut found);
            let largest = expected.iter().fold(0.0_f64, |max, e| max.max(e.abs()));
            let near = |a: f64, b: f64| (a - b).abs() < 1e-12 * largest;
            assert!(found.iter().zip(&expected).all(|(a, b)| near(*a, *b)), "{rings} × {nodes}");
            if nodes > 4 {
                assert!(
                    operator.diagonal().iter().zip(&diagonal).all(|(a, b)| near(*a, *b)),
                    "{rings} × {nodes}"
                );
            }
            let weights = operator.lumped_weights();
            let all: f64 = points.iter().map(|(_, node)| 1.0 + node.abs()).sum();
            assert!((weights.iter().sum::<f64>() - all).abs() < 1e-9 * all);

            let [mut next, mut product] = [(); 2].map(|()| vec![f64::NAN; x.len()]);
            let half: Vec<f64> = x.iter().map(|x| 0.5 * x).collect();
            operator.advance(&half, 0.25, &half, &mut next, &mut product);
            assert!(
                (0..x.len()).all(|i| near(next[i], 0.625 * x[i]) && near(product[i], 0.625 * expected[i]))
            );
            let mut window = Window::default();
            window.fill(nodes, 0..rings, |k, ring| ring.copy_from_slice(&x[k * nodes..][..nodes]));
            for k in 0..rings {
                let mut ring = vec![f64::NAN; nodes];
                operator.residual(k, &expected, &window, &mut ring);
                assert!(ring.iter().all(|r| near(*r, 0.0)));
                operator.relax(k, &radii, &window, (0.5, &radii), &mut ring);
                let relaxed = |i: usize| x[i] + 0.5 * radii[i] * (radii[i] - found[i]);
                assert!((0..nodes).all(|j| near(ring[j], relaxed(k * nodes + j))));
            }
        }
    }

    /// Tasks of some rings each, on a grid that is worth several threads, give what one task gives.
    #[test]
    fn products_do_not_depend_on_the_tasks() {
        let grid = WallGrid { rings: 301, nodes: 40, ..GRID };
        let wave = |i: usize| (0.7 * (i * i % 997) as f64).sin();
        let x: Vec<f64> = (0..grid.node_count()).map(wave).collect();
        let weights = x.iter().map(|x| 1.0 + x * x).collect();
        let operator = Operator::lumped(&grid, weights, 0.3, LocalSmoothness::default());
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let [mut found, mut next, mut product] = [(); 3].map(|()| vec![f64::NAN; x.len()]);
                operator.apply(&x, &mut found);
                operator.advance(&x, 0.3, &found, &mut next, &mut product);
                (grid.bands().len(), [found, next, product])
            })
        };
        let [(few, expected), (many, found)] = [1, 7].map(on);
        assert!(few < many && expected == found, "{few} {many}");
    }
}
