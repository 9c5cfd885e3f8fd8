//! The matrix of a grid of the multigrid cycle (`shaders/sweep/common/matrix.wgsl`).

use super::coupled::coupled;
use super::{Level, WallParameters, bending};

/// A grid's matrix. The finest one has the couplings of echoes, coarser ones have weights at the nodes themselves.
#[derive(Debug, Clone, Copy)]
pub struct Matrix<'a> {
    /// Of the wall.
    pub parameters: &'a WallParameters,
    /// The grid.
    pub level: &'a Level,
    /// The couplings of the finest grid; the others ignore them.
    pub rows: &'a [[f32; 4]],
    /// Per node of the grid: the echoes' weight, and the inverse of the matrix's diagonal.
    pub own: &'a [[f32; 2]],
}

impl Matrix<'_> {
    /// The product with `x` at a node.
    fn times(&self, x: &[f32], node: usize) -> f32 {
        let (k, j) = (node / self.level.nodes as usize, node % self.level.nodes as usize);
        let of_echoes = match self.level.first {
            0 => coupled(self.level, self.rows, x, k, j),
            _ => self.own[node][0] * x[node],
        };
        of_echoes + bending(self.level, x, k, j)
    }

    /// What `x` leaves of a right-hand side.
    pub(super) fn left(&self, right: &[f32], x: &[f32]) -> Vec<f32> {
        (0..right.len()).map(|node| right[node] - self.times(x, node)).collect()
    }

    /// `x` after a relaxation of that weight.
    pub(super) fn relaxed(&self, right: &[f32], x: &[f32], relaxation: f32) -> Vec<f32> {
        let left = self.left(right, x);
        (0..x.len()).map(|node| x[node] + (relaxation * self.own[node][1]) * left[node]).collect()
    }
}
