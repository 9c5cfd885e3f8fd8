//! The least-squares equations of a wall.

use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::{Corners, WallGrid};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Nodes per parallel task of a sum.
const TASK_NODES: usize = 1024;
/// Stiffness of fixed nodes, in units of the largest other one.
const FIXED_STIFFNESS: f64 = 1e6;

/// The normal equations of weighted points on the triangles of a grid.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(in crate::sweep) struct Equations {
    /// The first node covered.
    first: usize,
    /// Per node: coupling to itself, to (k, j+1), (k+1, j) and (k+1, j+1), and the right-hand side.
    rows: Vec<[f64; 5]>,
}

impl Equations {
    /// No points yet, over the rings `rings` of a grid.
    pub(in crate::sweep) fn over(grid: &WallGrid, rings: Range<usize>) -> Self {
        let first = rings.start * grid.nodes;
        Self { first, rows: vec![[0.0; 5]; rings.len() * grid.nodes] }
    }

    /// No points yet, over the rings that the projections of echoes lie between.
    pub(in crate::sweep) fn about(grid: &WallGrid, echoes: &[Echo]) -> Self {
        let last = grid.rings - 2;
        let below = |echo: &Echo| (echo.projection().0.max(0.0) as usize).min(last);
        let (low, high) =
            echoes.iter().map(below).fold((last, 0), |(low, high), below| (low.min(below), high.max(below)));
        Self::over(grid, low..high + 2)
    }

    /// Whether they are those of these rings of a grid.
    pub(in crate::sweep) fn covers(&self, rings: &Range<usize>, grid: &WallGrid) -> bool {
        self.first == rings.start * grid.nodes && self.rows.len() == rings.len() * grid.nodes
    }

    /// Adds a point: `weight · (x(corners) - value)²`.
    #[inline(always)]
    pub(in crate::sweep) fn add(&mut self, corners: &Corners, weight: f64, value: f64) {
        let [p, q, r] = corners.weights;
        let [of_p, of_q, of_r] = corners.weights.map(|share| weight * share);
        let (pq, qr) = (of_p * q, of_q * r);
        // Sums of whole rows, zeros too: a processor adds them side by side.
        // a couples to b along the ring or to a' across; b to b' across, a' to b' along; a to b' always.
        let bottom = corners.bottom;
        let [pq_bottom, qr_bottom] = if bottom { [pq, qr] } else { [0.0; 2] };
        let [pq_top, qr_top] = if bottom { [0.0; 2] } else { [pq, qr] };
        let of_a = [of_p * p, pq_bottom, pq_top, of_p * r, of_p * value];
        let of_m = [of_q * q, qr_top, qr_bottom, 0.0, of_q * value];
        let of_c = [of_r * r, 0.0, 0.0, 0.0, of_r * value];
        for (node, sums) in corners.nodes.into_iter().zip([of_a, of_m, of_c]) {
            self.rows[node - self.first].iter_mut().zip(sums).for_each(|(row, sum)| *row += sum);
        }
    }

    /// Adds the sums of other points on the nodes that are covered here.
    pub(in crate::sweep) fn merge(&mut self, other: &Self) {
        add_rows(&mut self.rows, self.first, &other.rows, other.first);
    }

    /// The sums of parts, over all rings of a grid: node by node in the order of the parts.
    pub(in crate::sweep) fn sum(grid: &WallGrid, parts: &[Self]) -> Self {
        let mut whole = Self::over(grid, 0..grid.rings);
        whole.rows.par_chunks_mut(TASK_NODES).enumerate().for_each(|(task, rows)| {
            let first = task * TASK_NODES;
            for part in parts {
                add_rows(rows, first, &part.rows, part.first);
            }
        });
        whole
    }

    /// The sums of every node.
    pub(in crate::sweep) fn rows(&self) -> &[[f64; 5]] {
        &self.rows
    }

    /// Multiplies the weights of all points.
    pub(in crate::sweep) fn scale(&mut self, factor: f64) {
        self.rows.as_flattened_mut().iter_mut().for_each(|x| *x *= factor);
    }

    /// Changes the values of all points as those of a surface through them change: by `shift` at the nodes that are covered.
    pub(in crate::sweep) fn shift(&mut self, shift: &[f64], nodes: usize) {
        for n in 0..self.rows.len() {
            let next = if (n + 1).is_multiple_of(nodes) { n + 1 - nodes } else { n + 1 };
            let [own, couplings @ .., _] = self.rows[n];
            self.rows[n][4] += own * shift[n];
            for (m, coupling) in [next, n + nodes, next + nodes].into_iter().zip(couplings) {
                if coupling != 0.0 {
                    self.rows[n][4] += coupling * shift[m];
                    self.rows[m][4] += coupling * shift[n];
                }
            }
        }
    }

    /// Shifts node numbers by `nodes` new nodes in front.
    pub(in crate::sweep) fn renumber(&mut self, nodes: usize) {
        self.first += nodes;
    }

    /// The equations for the change of values on the rings `free` with all others fixed; `product` is that of their
    /// matrix with the values, bending included.
    pub(in crate::sweep) fn of_change(
        mut self,
        grid: &WallGrid,
        smoothness: f64,
        product: &[f64],
        free: Range<usize>,
    ) -> Self {
        let bending = smoothness * grid.cell_mm2() * (grid.step_mm.powi(-4) + grid.arc_mm.powi(-4));
        let stiff = FIXED_STIFFNESS * (bending + self.rows.iter().fold(0.0, |max: f64, row| max.max(row[0])));
        for (node, (row, product)) in self.rows.iter_mut().zip(product).enumerate() {
            row[4] -= product;
            if !free.contains(&(node / grid.nodes)) {
                row[0] += stiff;
                row[4] = 0.0;
            }
        }
        self
    }
}

/// Adds the rows of the nodes from `first_other` on to those from `first` on, where both have the node.
fn add_rows(rows: &mut [[f64; 5]], first: usize, others: &[[f64; 5]], first_other: usize) {
    let skipped = first.saturating_sub(first_other).min(others.len());
    let shift = (first_other + skipped).saturating_sub(first).min(rows.len());
    for (row, other) in rows[shift..].iter_mut().zip(&others[skipped..]) {
        row.iter_mut().zip(other).for_each(|(a, b)| *a += b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: WallGrid = WallGrid { rings: 6, nodes: 8, step_mm: 1.3, arc_mm: 0.9 };

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
        assert_eq!(Equations::sum(&GRID, &[some]).rows, whole.rows);
    }

    #[test]
    fn values_follow_a_surface_that_moves() {
        let at = |corners: &Corners, values: &[f64]| -> f64 {
            corners.nodes.iter().zip(corners.weights).map(|(n, w)| values[n - 2 * GRID.nodes] * w).sum()
        };
        let shift: Vec<f64> = (0..3 * GRID.nodes).map(|n| (n as f64).sin()).collect();
        let [mut shifted, mut expected] = [0; 2].map(|_| Equations::over(&GRID, 2..5));
        for (ring, node, weight) in [(2.6, 7.5, 2.0), (2.2, 7.9, 1.0), (3.3, 0.2, 0.5), (3.9, 4.4, 1.5)] {
            let corners = GRID.corners(ring, node);
            shifted.add(&corners, weight, 3.0);
            expected.add(&corners, weight, 3.0 + at(&corners, &shift));
        }
        let apart = |a: &Equations, b: &Equations| {
            a.rows
                .iter()
                .flatten()
                .zip(b.rows.iter().flatten())
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max)
        };
        assert!(apart(&shifted, &expected) > 0.1);
        shifted.shift(&shift, GRID.nodes);
        assert!(apart(&shifted, &expected) < 1e-12);
    }
}
