//! The grid about the axis that the wall is a function on.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Deviation of a wall of roughness one from a flat triangle, in edge lengths. It counts as noise, so that perfect echoes
/// are not interpolated.
pub(in crate::sweep) const CELL_NOISE: f64 = 0.3;

/// `rings` rings of `nodes` nodes; node (k, j) has index `k·nodes + j` and lies at `θ = 2πj/nodes`. Each cell
/// a, b, b', a' between two rings consists of the triangles (a, b, b') and (a, b', a').
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::sweep) struct WallGrid {
    pub rings: usize,
    pub nodes: usize,
    /// Distance of two rings, mm.
    pub step_mm: f64,
    /// Distance of two nodes of a ring, mm, on a tube of the median radius.
    pub arc_mm: f64,
}

/// Half the length over which the wall's slopes are taken, in standard deviations of the noise. An echo's projection moves with
/// the wall's slope: with that of the nearest triangle, bends shorter than 2π σ attract each other's echoes and grow. See
/// `docs/method.md`, "Wall".
const SLOPE_SDS: f64 = 2.5;
/// The largest share of a ring's nodes to either side.
const MAX_SLOPE_SHARE: f64 = 0.25;

/// How far beyond a triangle's edges the wall's slopes are taken: nodes to either side, and rings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::sweep) struct SlopeReach {
    pub nodes: usize,
    pub rings: usize,
}

/// A place on the grid: its triangle, as node indices, and its barycentric weights there.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::sweep) struct Corners {
    /// a, b or a', b'.
    pub nodes: [usize; 3],
    pub weights: [f64; 3],
    /// Whether it is the bottom triangle (a, b, b').
    pub bottom: bool,
    /// Ring and place on it of a.
    cell: [usize; 2],
}

impl SlopeReach {
    /// Nodes over which the slope about the axis is taken.
    pub(in crate::sweep) fn span_nodes(self) -> f64 {
        (2 * self.nodes + 1) as f64
    }
}

impl Corners {
    /// The value there of a function on the grid.
    pub(in crate::sweep) fn value(&self, x: &[f64]) -> f64 {
        self.nodes.iter().zip(self.weights).map(|(&node, weight)| x[node] * weight).sum()
    }

    /// The node with the largest weight.
    pub(in crate::sweep) fn nearest(&self) -> usize {
        let nearest = (1..3).fold(0, |best, k| if self.weights[k] > self.weights[best] { k } else { best });
        self.nodes[nearest]
    }
}

impl WallGrid {
    pub(in crate::sweep) fn new(rings: usize, nodes: usize, step_mm: f64, radius_mm: f64) -> Self {
        Self { rings, nodes, step_mm, arc_mm: TAU * radius_mm / nodes as f64 }
    }

    pub(in crate::sweep) fn node_count(&self) -> usize {
        self.rings * self.nodes
    }

    /// The triangle at `ring` (0 to rings - 1) and `node` (any number; the grid is closed in that direction).
    #[inline(always)]
    pub(in crate::sweep) fn corners(&self, ring: f64, node: f64) -> Corners {
        let below = (ring.max(0.0) as usize).min(self.rings - 2);
        let up = (ring - below as f64).clamp(0.0, 1.0);
        let around = around(node, self.nodes as f64);
        let j = (around as usize).min(self.nodes - 1);
        let round = (around - j as f64).clamp(0.0, 1.0);
        let next = if j + 1 == self.nodes { 0 } else { j + 1 };
        let (row, cell) = (below * self.nodes, [below, j]);
        let (a, b, b_up, a_up) = (row + j, row + next, row + self.nodes + next, row + self.nodes + j);
        // Values are selected without a branch, which a processor would mispredict for every other echo.
        let bottom = round >= up;
        let (less, more, middle) = if bottom { (up, round, b) } else { (round, up, a_up) };
        Corners { nodes: [a, middle, b_up], weights: [1.0 - more, more - less, less], bottom, cell }
    }

    /// How far slopes reach where echoes have the noise `noise_mm`.
    pub(in crate::sweep) fn slope_reach(&self, noise_mm: f64) -> SlopeReach {
        // Half of the triangle's own edge counts.
        let beyond = |distance_mm: f64| (SLOPE_SDS * noise_mm / distance_mm - 0.5).max(0.0).round();
        let most = (MAX_SLOPE_SHARE * self.nodes as f64).floor();
        let longest_mm = most * self.arc_mm;
        SlopeReach {
            nodes: beyond(self.arc_mm).min(most) as usize,
            rings: beyond(self.step_mm).min(longest_mm / self.step_mm).min(self.rings as f64) as usize,
        }
    }

    /// What the wall rises by about the triangle of a place, mm: over [`SlopeReach::span_nodes`], and over some rings; and the
    /// number of these.
    #[inline(always)]
    pub(in crate::sweep) fn rises(&self, corners: &Corners, radii_mm: &[f64], reach: SlopeReach) -> [f64; 3] {
        let [level, j] = corners.cell;
        // At most one turn too far: cheaper than a remainder.
        let on_ring = |node: usize| if node < self.nodes { node } else { node - self.nodes };
        let at = |ring: usize, node: usize| radii_mm[ring * self.nodes + on_ring(node)];
        let (ring, node) = if corners.bottom { (level, j + 1) } else { (level + 1, j) };
        let around = at(ring, j + 1 + reach.nodes) - at(ring, j + self.nodes - reach.nodes);
        let (low, high) = (level.saturating_sub(reach.rings), (level + 1 + reach.rings).min(self.rings - 1));
        let along = at(high, node) - at(low, node);
        [around, along, (high - low) as f64]
    }

    /// The median radius for which [`arc_mm`](Self::arc_mm) holds, mm.
    pub(in crate::sweep) fn radius_mm(&self) -> f64 {
        self.arc_mm * self.nodes as f64 / TAU
    }

    /// Area per node, mm².
    pub(in crate::sweep) fn cell_mm2(&self) -> f64 {
        self.step_mm * self.arc_mm
    }

    /// The noise of the echoes plus [`CELL_NOISE`] at the roughness τ, mm.
    pub(in crate::sweep) fn smoothed_noise_mm(&self, noise_mm: f64, roughness: f64) -> f64 {
        noise_mm.hypot(self.cell_noise_mm(roughness))
    }

    /// How far a wall of the roughness τ bends away from flat triangles, mm.
    pub(in crate::sweep) fn cell_noise_mm(&self, roughness: f64) -> f64 {
        CELL_NOISE * roughness * self.arc_mm
    }
}

/// `node.rem_euclid(nodes)`, to the bit; most nodes are at most one turn away.
#[inline(always)]
fn around(node: f64, nodes: f64) -> f64 {
    if (0.0..nodes).contains(&node) {
        node
    } else if -nodes < node && node < 0.0 {
        node + nodes
    } else {
        node.rem_euclid(nodes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_taken_onto_the_ring_as_by_a_remainder() {
        for node in [0.0, -0.0, 7.9, 8.0, -1e-300, -0.2, -7.999, -8.0, -8.5, 31.0, f64::NAN] {
            assert_eq!(around(node, 8.0).to_bits(), f64::rem_euclid(node, 8.0).to_bits(), "{node}");
        }
    }

    #[test]
    fn a_place_is_the_weighted_mean_of_its_corners() {
        let grid = WallGrid { rings: 6, nodes: 8, step_mm: 1.3, arc_mm: 0.9 };
        for (ring, node) in [(0.0, 0.0), (0.3, 0.7), (2.7, 7.9), (4.5, -0.2), (5.0, 8.0), (3.0, 3.0)] {
            let corners = grid.corners(ring, node);
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
}
