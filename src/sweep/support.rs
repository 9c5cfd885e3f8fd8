//! What every node rests on.

use super::grid::Grid;
use super::wall::{Echo, Wall};

/// What the radius of every node rests on. All lists have one value per node.
#[derive(Debug, Clone, PartialEq)]
pub struct Support {
    /// Echoes on the triangles that meet in the node and are nearest to it.
    pub echoes: Vec<u32>,
    /// Root mean square distance of the echoes about the node to the wall, mm; NaN without any.
    pub residual_mm: Vec<f64>,
    /// Standard error of the radius, mm; infinite without echoes about.
    pub standard_error_mm: Vec<f64>,
    /// The last frame that saw the wall there.
    pub last_frame: Vec<Option<u32>>,
    /// Whether the wall there was measured rather than made up.
    pub supported: Vec<bool>,
}

/// Fewest echoes within the reach of a node.
const FEWEST_ECHOES: f64 = 3.0;
/// Most echoes within the reach of a node that passed the wall by: more, and there is no wall but the mouth of a branch.
const MOST_OFF_WALL: f64 = 0.5;

impl Support {
    pub(super) fn of(grid: &Grid, echoes: &[Echo], wall: &Wall) -> Self {
        let count = grid.node_count();
        let mut on_wall = vec![0.0; count];
        let mut off_wall = vec![0.0; count];
        let mut squares = vec![0.0; count];
        let mut last_frame = vec![None; count];
        for echo in echoes {
            let (ring, node) = echo.foot();
            let corners = grid.corners(ring, node);
            let nearest =
                (1..3).fold(0, |best, k| if corners.weights[k] > corners.weights[best] { k } else { best });
            let node = corners.nodes[nearest];
            if echo.is_inlier(wall.noise_mm) {
                on_wall[node] += 1.0;
                squares[node] += echo.miss_mm * echo.miss_mm;
                last_frame[node] = last_frame[node].max(Some(echo.frame));
            } else {
                off_wall[node] += 1.0;
            }
        }
        let own: Vec<u32> = on_wall.iter().map(|&n| n as u32).collect();
        // Bending spreads an echo's pull over ℓ = (λ/ρ)^¼, ρ being echoes per area.
        let mut densities: Vec<f64> = on_wall.iter().copied().filter(|&n| n > 0.0).collect();
        let density = super::median(&mut densities) / grid.cell_mm2();
        let reach_mm = (wall.smoothness_mm2 / density.max(f64::MIN_POSITIVE)).powf(0.25);
        let reach = (reach_mm / grid.step_mm).round().clamp(1.0, 0.05 * grid.nodes as f64 + 1.0) as usize;
        for field in [&mut on_wall, &mut off_wall, &mut squares] {
            spread(grid, field, reach);
        }
        let window_mm2 = ((2 * reach + 1) as f64).powi(2) * grid.cell_mm2();
        let mut support = Self {
            echoes: own,
            residual_mm: Vec::with_capacity(count),
            standard_error_mm: Vec::with_capacity(count),
            last_frame,
            supported: Vec::with_capacity(count),
        };
        for node in 0..count {
            let variance = squares[node] / on_wall[node];
            let density = on_wall[node] / window_mm2;
            support.residual_mm.push(variance.sqrt());
            // Of a thin plate on evenly spread points: σ² / (8 √(λρ)).
            let standard_error = (variance / (8.0 * (wall.smoothness_mm2 * density).sqrt())).sqrt();
            support.standard_error_mm.push(if on_wall[node] > 0.0 { standard_error } else { f64::INFINITY });
            let share = off_wall[node] / (on_wall[node] + off_wall[node]);
            support.supported.push(on_wall[node] >= FEWEST_ECHOES && share <= MOST_OFF_WALL);
        }
        support
    }
}

/// Replaces every value by the sum over the nodes at most `reach` rings and nodes away.
fn spread(grid: &Grid, field: &mut [f64], reach: usize) {
    let (rings, nodes) = (grid.rings, grid.nodes);
    let mut along = vec![0.0; field.len()];
    for k in 0..rings {
        for other in k.saturating_sub(reach)..(k + reach + 1).min(rings) {
            for j in 0..nodes {
                along[k * nodes + j] += field[other * nodes + j];
            }
        }
    }
    for (ring, out) in along.chunks_exact(nodes).zip(field.chunks_exact_mut(nodes)) {
        for (j, sum) in out.iter_mut().enumerate() {
            *sum = (0..=2 * reach).map(|i| ring[(j + nodes + i - reach) % nodes]).sum();
        }
    }
}
