//! What every node rests on.

use super::echo::Echo;
use super::grid::Grid;
use super::median;
use super::wall::Wall;

/// What the radius of every node rests on. All lists have one value per node.
#[derive(Debug, Clone, PartialEq)]
pub struct Support {
    /// Echoes nearer to the node than to the two others of their triangle.
    pub echoes: Vec<u32>,
    /// Root mean square distance to the wall of the echoes about the node, mm; NaN without any.
    pub residual_mm: Vec<f64>,
    /// Standard error of the radius, mm; infinite without echoes about.
    pub standard_error_mm: Vec<f64>,
    /// The last frame that saw the wall there.
    pub last_frame: Vec<Option<u32>>,
    /// Whether the wall there was measured rather than made up: the standard error is at most 1 % of the lumen's
    /// radius or twice its median, and no branch opens there.
    pub supported: Vec<bool>,
}

/// Largest standard error of a supported node, in lumen radii …
const LARGEST_ERROR_RADII: f64 = 0.01;
/// … or, where that is more, in medians: a noisy recording is no reason to cut most of the vessel.
const LARGEST_ERROR_MEDIANS: f64 = 2.0;
/// Most of the echoes about a node that may lie off the wall: with more it is the mouth of a branch.
const MOST_OFF_WALL: f64 = 0.5;
/// Farthest that echoes count as being about a node, as a share of the way round.
const FARTHEST_REACH: f64 = 0.05;

impl Support {
    pub(super) fn of(grid: &Grid, echoes: &[Echo], wall: &Wall) -> Self {
        let count = grid.node_count();
        let (mut own, mut off_wall, mut squares) = (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        let mut last_frame = vec![None; count];
        for echo in echoes {
            let (ring, node) = echo.foot();
            let node = grid.corners(ring, node).nearest();
            if echo.is_inlier(wall.noise_mm) {
                own[node] += 1.0;
                squares[node] += echo.miss_mm * echo.miss_mm;
                last_frame[node] = last_frame[node].max(Some(echo.frame));
            } else {
                off_wall[node] += 1.0;
            }
        }
        // Bending spreads the pull of an echo over ℓ = (λ/ρ)^¼, ρ being echoes per area.
        let density =
            median(&mut own.iter().copied().filter(|&n| n > 0.0).collect::<Vec<_>>()) / grid.cell_mm2();
        let reach_mm = (wall.smoothness_mm2 / density.max(f64::MIN_POSITIVE)).powf(0.25);
        let farthest_mm = FARTHEST_REACH * std::f64::consts::TAU * grid.radius_mm();
        let reach = [grid.step_mm, grid.arc_mm]
            .map(|spacing| 1.max((reach_mm.min(farthest_mm) / spacing).round() as usize));
        let window = reach.iter().map(|&reach| 2.0 * reach as f64 + 1.0).product::<f64>();
        let window_mm2 = window * grid.cell_mm2();

        let about = Moments::about(grid, &own, reach);
        let off_wall = Moments::about(grid, &off_wall, reach).sums;
        let squares = Moments::about(grid, &squares, reach).sums;
        let variance = |node: usize| squares[node] / about.sums[node];
        let standard_error_mm: Vec<f64> = (0..count)
            .map(|node| {
                if about.sums[node] == 0.0 {
                    return f64::INFINITY;
                }
                // Of a thin plate on evenly spread points: σ² / (8 √(λρ)).
                let plate =
                    variance(node) / (8.0 * (wall.smoothness_mm2 * about.sums[node] / window_mm2).sqrt());
                (plate * about.leverage(node)).sqrt()
            })
            .collect();
        let mut errors: Vec<f64> = standard_error_mm.iter().copied().filter(|e| e.is_finite()).collect();
        let largest =
            (LARGEST_ERROR_MEDIANS * median(&mut errors)).max(LARGEST_ERROR_RADII * grid.radius_mm());
        let supported = (0..count)
            .map(|node| {
                let share = off_wall[node] / (off_wall[node] + about.sums[node]);
                standard_error_mm[node] <= largest && share <= MOST_OFF_WALL
            })
            .collect();
        Self {
            echoes: own.iter().map(|&n| n as u32).collect(),
            residual_mm: (0..count).map(|node| variance(node).sqrt()).collect(),
            standard_error_mm,
            last_frame,
            supported,
        }
    }
}

/// How a value per node is spread about each node, within a window; offsets in nodes.
struct Moments {
    sums: Vec<f64>,
    /// First and second moments along the axis and about it.
    along: Vec<[f64; 2]>,
    around: Vec<[f64; 2]>,
}

impl Moments {
    /// Over the nodes at most `reach` rings and nodes away.
    fn about(grid: &Grid, values: &[f64], [rings_away, nodes_away]: [usize; 2]) -> Self {
        let (rings, nodes) = (grid.rings, grid.nodes);
        let mut columns = vec![[0.0; 3]; values.len()];
        for k in 0..rings {
            for other in k.saturating_sub(rings_away)..(k + rings_away + 1).min(rings) {
                let offset = other as f64 - k as f64;
                for j in 0..nodes {
                    let value = values[other * nodes + j];
                    let column = &mut columns[k * nodes + j];
                    column[0] += value;
                    column[1] += offset * value;
                    column[2] += offset * offset * value;
                }
            }
        }
        let mut moments = Self {
            sums: vec![0.0; values.len()],
            along: vec![[0.0; 2]; values.len()],
            around: vec![[0.0; 2]; values.len()],
        };
        for node in 0..values.len() {
            let (row, j) = (node / nodes * nodes, node % nodes);
            for i in 0..=2 * nodes_away {
                let offset = i as f64 - nodes_away as f64;
                let [sum, first, second] = columns[row + (j + nodes + i - nodes_away) % nodes];
                moments.sums[node] += sum;
                moments.along[node][0] += first;
                moments.along[node][1] += second;
                moments.around[node][0] += offset * sum;
                moments.around[node][1] += offset * offset * sum;
            }
        }
        moments
    }

    /// By how much the variance of a plane through the echoes is larger at the node than in their middle: 1 amid
    /// echoes, 4 at a straight edge of them, more beyond it.
    fn leverage(&self, node: usize) -> f64 {
        let sum = self.sums[node];
        // Within its cell an echo may be anywhere.
        let cell = 1.0 / 12.0;
        let pull = |[first, second]: [f64; 2]| {
            let mean = first / sum;
            mean * mean / (second / sum - mean * mean + cell)
        };
        1.0 + pull(self.along[node]) + pull(self.around[node])
    }
}
