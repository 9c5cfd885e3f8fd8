//! The bending energy of a wall, and its robust prior.

use crate::sweep::prepare::grid::WallGrid;

impl WallGrid {
    /// Adds the gradient of the bending energy `½ ∫ r_ss² + 2 r_sθ² + r_θθ² dA` at `x`, times `weight` and the rings'
    /// `local` factors, to `out`.
    ///
    /// Second differences along the axis are left out on the end rings: the ends are free, so a cone has no bending energy.
    pub(in crate::sweep) fn add_bending(
        &self,
        x: &[f64],
        weight: f64,
        local: &LocalSmoothness,
        out: &mut [f64],
    ) {
        let Self { rings, nodes, step_mm, arc_mm } = *self;
        let area = self.cell_mm2() * weight;
        let along = area / step_mm.powi(4);
        let around = area / arc_mm.powi(4);
        let twist = 2.0 * area / (step_mm * arc_mm).powi(2);
        let next = |j: usize| if j + 1 == nodes { 0 } else { j + 1 };
        let mut bend = vec![0.0; nodes];
        for k in 0..rings {
            let row = k * nodes;
            let [along, around, twist] = [along, around, twist].map(|weight| weight * local.factor(k));
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

    /// The factor of a ring.
    pub(in crate::sweep) fn factor(&self, ring: usize) -> f64 {
        self.0.get(ring).copied().unwrap_or(1.0)
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
    fn a_cone_bends_nowhere() {
        let cone: Vec<f64> = (0..48).map(|i| 5.0 + 0.3 * f64::from(i / 8)).collect();
        let mut bending = vec![0.0; 48];
        GRID.add_bending(&cone, 7.0, LocalSmoothness::EVEN, &mut bending);
        assert!(bending.iter().all(|b| b.abs() < 1e-9), "{bending:?}");
        let mut dented = cone;
        dented[20] += 1.0;
        GRID.add_bending(&dented, 7.0, LocalSmoothness::EVEN, &mut bending);
        assert!(bending[20] > 1.0);
    }

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
