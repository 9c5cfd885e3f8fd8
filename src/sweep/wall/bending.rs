//! The bending energy of a wall, and its robust prior.

use crate::sweep::prepare::grid::WallGrid;

impl WallGrid {
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

/// The factor of λ on each ring, for a robust (Student-t) bending prior; 1 on all rings by default.
#[derive(Debug, Clone, Default)]
pub(in crate::sweep) struct LocalSmoothness(Vec<f64>);

impl LocalSmoothness {
    /// λ everywhere.
    pub(in crate::sweep) const EVEN: &Self = &Self(Vec::new());

    /// These factors, one for each ring.
    pub(in crate::sweep) fn of(factors: Vec<f64>) -> Self {
        Self(factors)
    }

    /// The factor of a ring.
    pub(in crate::sweep) fn factor(&self, ring: usize) -> f64 {
        self.0.get(ring).copied().unwrap_or(1.0)
    }

    /// The factors of `to` evenly spaced rings over the same length as these `from`.
    pub(in crate::sweep) fn resampled(&self, from: usize, to: usize) -> Self {
        let nearest = |k: usize| (k as f64 * (from - 1) as f64 / (to - 1) as f64).round() as usize;
        Self(if self.0.is_empty() { Vec::new() } else { (0..to).map(|k| self.factor(nearest(k))).collect() })
    }

    /// The factors for a wall with these radii: real vessels do not bend evenly.
    ///
    /// Under a normal prior with the roughness τ, the expected `∫ |bending|²` is τ² for each degree of freedom. Under
    /// Student's t, a ring that bends more has a smaller weight: that of iteratively reweighted least squares.
    pub(in crate::sweep) fn from_bending(grid: &WallGrid, radii_mm: &[f64], roughness: f64) -> Self {
        let energies = grid.ring_energies(radii_mm);
        let about = |k: usize| &energies[k.saturating_sub(1)..(k + 2).min(grid.rings)];
        let weight = |k: usize| {
            let energy = about(k).iter().sum::<f64>() / about(k).len() as f64;
            let freedom = energy / (roughness * roughness);
            ((T_FREEDOM + RING_FREEDOM) / (T_FREEDOM + freedom)).clamp(MIN_FACTOR, 1.0)
        };
        Self((0..grid.rings).map(weight).collect())
    }
}

/// Degrees of freedom of Student's t.
const T_FREEDOM: f64 = 4.0;
/// Degrees of freedom of a ring: about two for each of the lowest two harmonics.
const RING_FREEDOM: f64 = 4.0;
/// The smallest factor: ten times the roughness.
const MIN_FACTOR: f64 = 0.01;

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: WallGrid = WallGrid { rings: 6, nodes: 8, step_mm: 1.3, arc_mm: 0.9 };

    #[test]
    fn smoothness_is_lower_where_a_wall_bends() {
        let cone: Vec<f64> = (0..48).map(|i| 5.0 + 0.3 * f64::from(i / 8)).collect();
        let even = LocalSmoothness::from_bending(&GRID, &cone, 0.1);
        assert!((0..6).all(|k| even.factor(k) == 1.0), "{even:?}");
        let step: Vec<f64> = (0..48).map(|i| if i < 8 { 5.0 } else { 8.0 }).collect();
        let local = LocalSmoothness::from_bending(&GRID, &step, 0.1);
        assert!(local.factor(1) < 0.1 && local.factor(5) == 1.0, "{local:?}");
    }
}
