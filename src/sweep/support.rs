//! The data that support each node of a wall, and the standard errors that follow from them.

use super::prepare::echo::Echo;
use super::prepare::grid::WallGrid;
use super::wall::fit::Wall;
use super::wall::residual::is_inlier;
use crate::numerics::robust::median;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Echoes or nodes per parallel task.
const TASK: usize = 8192;

/// The data that support the radius of each node. All lists have one value per node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Support {
    /// Echoes nearer to the node than to the two others of their triangle; with a half-life, their weight.
    pub echoes: Vec<u32>,
    /// Root mean square residual of the echoes about the node, mm; NaN without any.
    pub residual_mm: Vec<f64>,
    /// Standard error of the radius, mm; infinite without echoes about the node.
    pub standard_error_mm: Vec<f64>,
    /// Distance around the lumen over which errors are alike, mm: the integral of their correlation along a ring. An area's
    /// standard error follows from it. NaN where the standard error is infinite.
    pub error_reach_mm: Vec<f64>,
    /// The last frame with an echo of the wall there.
    pub last_frame: Vec<Option<u32>>,
    /// Whether the wall there was measured rather than extrapolated: the standard error is at most 1 % of the lumen's
    /// radius or twice its median (three times that in gaps that such wall encloses), no branch opens there, and some echo
    /// lies as far from the axis.
    pub supported: Vec<bool>,
}

/// Largest standard error of a supported node, in lumen radii …
pub(crate) const MAX_ERROR_RADII: f64 = 0.01;
/// … or, where that is more, in medians: noise must not cut away most of a vessel.
pub(crate) const MAX_ERROR_MEDIANS: f64 = 2.0;
/// Largest standard error of a node in a gap that supported wall encloses, in those of a supported node: there the wall is
/// held from all sides.
const MAX_GAP_ERROR: f64 = 3.0;
/// Largest length and width of such a gap, in lumen radii: a larger one can hide a bulge or a branch.
const MAX_GAP_RADII: f64 = 0.5;
/// Largest share of the echoes about a node that may lie off the wall: with more it is the mouth of a branch.
pub(crate) const MAX_OFF_WALL: f64 = 0.5;
/// Largest radius of a supported node, in distances of the farthest echo from the axis.
const MAX_REACH_RADII: f64 = 1.5;
/// Largest distance of echoes that count as being about a node, as a share of the circumference.
const MAX_REACH: f64 = 0.05;

impl Support {
    /// The support of no nodes.
    pub(super) fn none() -> Self {
        Self {
            echoes: Vec::new(),
            residual_mm: Vec::new(),
            standard_error_mm: Vec::new(),
            error_reach_mm: Vec::new(),
            last_frame: Vec::new(),
            supported: Vec::new(),
        }
    }

    /// Whether there is a value for each of so many nodes.
    pub(super) fn is_of(&self, nodes: usize) -> bool {
        let Self { echoes, residual_mm, standard_error_mm, error_reach_mm, last_frame, supported } = self;
        [residual_mm.len(), standard_error_mm.len(), error_reach_mm.len()] == [nodes; 3]
            && [echoes.len(), last_frame.len(), supported.len()] == [nodes; 3]
    }

    /// Replaces the errors of the nodes with echoes about them.
    pub(super) fn replace_errors(&mut self, errors: NodeErrors) {
        let NodeErrors { standard_error_mm, reach_mm } = errors;
        let has_echoes: Vec<bool> = self.standard_error_mm.iter().map(|e| e.is_finite()).collect();
        for node in (0..self.standard_error_mm.len()).filter(|&n| has_echoes[n]) {
            self.standard_error_mm[node] = standard_error_mm[node];
            self.error_reach_mm[node] = reach_mm[node];
        }
    }

    /// Inserts nodes without support.
    pub(super) fn insert(&mut self, at: usize, count: usize) {
        use std::iter::repeat_n;
        self.echoes.splice(at..at, repeat_n(0, count));
        self.residual_mm.splice(at..at, repeat_n(f64::NAN, count));
        self.standard_error_mm.splice(at..at, repeat_n(f64::INFINITY, count));
        self.error_reach_mm.splice(at..at, repeat_n(f64::NAN, count));
        self.last_frame.splice(at..at, repeat_n(None, count));
        self.supported.splice(at..at, repeat_n(false, count));
    }

    /// The support of a wall's nodes by echoes with their projections on it.
    pub(super) fn of(grid: &WallGrid, echoes: &[Echo], wall: &Wall) -> Self {
        let placed = echoes.par_iter().with_min_len(TASK).map(|echo| {
            let (ring, node) = echo.projection();
            let squares_mm2 = f64::from(echo.weight) * echo.single_residual_mm().powi(2);
            (grid.corners(ring, node).nearest(), is_inlier(echo, wall.noise_mm), squares_mm2)
        });
        let placed: Vec<(usize, bool, f64)> = placed.collect();
        let mut tally = Tally::new(grid.node_count());
        for (echo, (node, on_wall, squares_mm2)) in echoes.iter().zip(placed) {
            tally.add(node, on_wall, f64::from(echo.weight), squares_mm2, echo.frame);
        }
        let density = median(&mut tally.own().filter(|&n| n > 0.0).collect::<Vec<_>>()) / grid.cell_mm2();
        let statistics = tally.statistics(grid, density, wall.smoothness_mm2, 0.0);
        let mut errors: Vec<f64> =
            statistics.errors.standard_error_mm.iter().copied().filter(|e| e.is_finite()).collect();
        let max_mm = max_error_mm(median(&mut errors), grid);
        let farthest_mm = echoes
            .iter()
            .filter(|echo| is_inlier(echo, wall.noise_mm))
            .fold(0.0_f64, |farthest, echo| farthest.max(echo.radius_mm));
        let within = |max_mm: f64| {
            let is_within = |node: usize| {
                statistics.errors.standard_error_mm[node] <= max_mm
                    && !statistics.is_mouth[node]
                    && is_in_reach(wall.radii_mm[node], farthest_mm)
            };
            (0..grid.node_count()).map(is_within).collect::<Vec<bool>>()
        };
        let mut supported = within(max_mm);
        close_gaps(grid, &mut supported, &within(MAX_GAP_ERROR * max_mm));
        Self {
            echoes: tally.own().map(|n| n as u32).collect(),
            supported,
            residual_mm: statistics.residual_mm,
            standard_error_mm: statistics.errors.standard_error_mm,
            error_reach_mm: statistics.errors.reach_mm,
            last_frame: tally.last_frame,
        }
    }
}

/// Makes small gaps supported that reach neither end of the grid and in which every node may be.
fn close_gaps(grid: &WallGrid, supported: &mut [bool], may_be: &[bool]) {
    let WallGrid { rings, nodes, .. } = *grid;
    let mut is_seen = supported.to_vec();
    for first in 0..supported.len() {
        if is_seen[first] {
            continue;
        }
        is_seen[first] = true;
        let mut gap = vec![first];
        let (mut next, mut is_closed) = (0, true);
        while next < gap.len() {
            let (ring, node) = (gap[next] / nodes, gap[next] % nodes);
            is_closed &= may_be[gap[next]] && ring > 0 && ring + 1 < rings;
            // The six nodes that share a triangle with it.
            let (after, before) = ((node + 1) % nodes, (node + nodes - 1) % nodes);
            let beside = [(ring, after), (ring, before), (ring + 1, node), (ring + 1, after)];
            let below = ring.checked_sub(1).into_iter().flat_map(|below| [(below, node), (below, before)]);
            for (ring, node) in beside.into_iter().chain(below).filter(|(ring, _)| *ring < rings) {
                let other = ring * nodes + node;
                if !is_seen[other] {
                    is_seen[other] = true;
                    gap.push(other);
                }
            }
            next += 1;
        }
        let extent_mm = |of: fn(usize, usize) -> usize, distance_mm: f64| {
            let mut lines: Vec<usize> = gap.iter().map(|&n| of(n, nodes)).collect();
            lines.sort_unstable();
            lines.dedup();
            lines.len() as f64 * distance_mm
        };
        let largest_mm =
            extent_mm(|n, nodes| n / nodes, grid.step_mm).max(extent_mm(|n, nodes| n % nodes, grid.arc_mm));
        if is_closed && largest_mm <= MAX_GAP_RADII * grid.radius_mm() {
            gap.into_iter().for_each(|node| supported[node] = true);
        }
    }
}

/// Whether a radius is one that echoes show, where the farthest of the wall lies so far from the axis. Others come from
/// slopes that a few echoes leave open.
pub(super) fn is_in_reach(radius_mm: f64, farthest_mm: f64) -> bool {
    0.0 < radius_mm && radius_mm <= MAX_REACH_RADII * farthest_mm
}

/// The largest standard error of a supported node, mm, where the median is `median_mm`.
pub(super) fn max_error_mm(median_mm: f64, grid: &WallGrid) -> f64 {
    (MAX_ERROR_MEDIANS * median_mm).max(MAX_ERROR_RADII * grid.radius_mm())
}

/// Sums over the echoes nearest to each node of a grid.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Tally {
    /// Per node: weight of the echoes on the wall, of those off it, and the former's squared residuals, mm².
    sums: Vec<[f64; 3]>,
    /// The last frame with an echo of the wall there.
    pub(super) last_frame: Vec<Option<u32>>,
}

/// Errors of the radii, node by node.
pub(super) struct NodeErrors {
    pub standard_error_mm: Vec<f64>,
    /// Distance around the lumen over which they are alike, mm.
    pub reach_mm: Vec<f64>,
}

/// Statistics of a [`Tally`] for each node.
pub(super) struct NodeStatistics {
    pub residual_mm: Vec<f64>,
    pub errors: NodeErrors,
    /// Whether most echoes about the node lie off the wall.
    pub is_mouth: Vec<bool>,
}

impl Tally {
    pub(super) fn new(nodes: usize) -> Self {
        Self { sums: vec![[0.0; 3]; nodes], last_frame: vec![None; nodes] }
    }

    /// Whether it is one of so many nodes.
    pub(super) fn covers(&self, nodes: usize) -> bool {
        self.sums.len() == nodes && self.last_frame.len() == nodes
    }

    /// Adds echoes of some weight whose squared residuals, times weight, sum to `squares_mm2`.
    pub(super) fn add(&mut self, node: usize, on_wall: bool, weight: f64, squares_mm2: f64, frame: u32) {
        let [own, off_wall, squares] = &mut self.sums[node];
        if on_wall {
            *own += weight;
            *squares += squares_mm2;
            self.last_frame[node] = self.last_frame[node].max(Some(frame));
        } else {
            *off_wall += weight;
        }
    }

    /// Adds another tally, whose node `theirs` is node `mine` here, and so on.
    pub(super) fn merge(&mut self, mine: usize, other: &Self, theirs: usize) {
        for (sums, others) in self.sums.iter_mut().skip(mine).zip(other.sums.iter().skip(theirs)) {
            sums.iter_mut().zip(others).for_each(|(a, b)| *a += b);
        }
        for (last, other) in self.last_frame.iter_mut().skip(mine).zip(other.last_frame.iter().skip(theirs)) {
            *last = (*last).max(*other);
        }
    }

    /// Multiplies the weights of all echoes.
    pub(super) fn scale(&mut self, factor: f64) {
        self.sums.as_flattened_mut().iter_mut().for_each(|x| *x *= factor);
    }

    /// Weight of the echoes on the wall, node by node.
    pub(super) fn own(&self) -> impl Iterator<Item = f64> + '_ {
        self.sums.iter().map(|sums| sums[0])
    }

    /// Statistics of every node, where the median density is `density` echoes per mm². In standard errors echoes count with
    /// a noise of `least_noise_mm` at least.
    pub(super) fn statistics(
        &self,
        grid: &WallGrid,
        density: f64,
        smoothness_mm2: f64,
        least_noise_mm: f64,
    ) -> NodeStatistics {
        let count = grid.node_count();
        // The bending term spreads the effect of an echo over ℓ = (λ/ρ)^¼, ρ being echoes per area.
        let reach_mm = (smoothness_mm2 / density.max(f64::MIN_POSITIVE)).powf(0.25);
        let max_reach_mm = MAX_REACH * std::f64::consts::TAU * grid.radius_mm();
        let reach = [grid.step_mm, grid.arc_mm]
            .map(|spacing| 1.max((reach_mm.min(max_reach_mm) / spacing).round() as usize));
        let window = reach.iter().map(|&reach| 2.0 * reach as f64 + 1.0).product::<f64>();
        let window_mm2 = window * grid.cell_mm2();

        let of = |k: usize| self.sums.iter().map(|sums| sums[k]).collect::<Vec<_>>();
        let about = Moments::about(grid, &of(0), reach);
        let off_wall = Moments::about(grid, &of(1), reach);
        let squares = Moments::about(grid, &of(2), reach);
        let variance = |node: usize| squares[node].sum / about[node].sum;
        let standard_error = |node: usize| {
            if about[node].sum == 0.0 {
                return f64::INFINITY;
            }
            // The variance of a thin plate on evenly spread points: σ² / (8 √(λρ)).
            let noise_mm2 = variance(node).max(least_noise_mm * least_noise_mm);
            let plate = noise_mm2 / (8.0 * (smoothness_mm2 * about[node].sum / window_mm2).sqrt());
            (plate * about[node].leverage()).sqrt()
        };
        // Its errors correlate along a line as e^(-u/√2ℓ) (cos u/√2ℓ + sin u/√2ℓ), whose integral is 2√2 ℓ.
        let error_reach = |node: usize| match about[node].sum {
            0.0 => f64::NAN,
            sum => 8.0_f64.sqrt() * (smoothness_mm2 * window_mm2 / sum).powf(0.25),
        };
        NodeStatistics {
            residual_mm: (0..count).map(|node| variance(node).sqrt()).collect(),
            errors: NodeErrors {
                standard_error_mm: (0..count).map(standard_error).collect(),
                reach_mm: (0..count).map(error_reach).collect(),
            },
            is_mouth: (0..count)
                .map(|node| off_wall[node].sum / (off_wall[node].sum + about[node].sum) > MAX_OFF_WALL)
                .collect(),
        }
    }
}

/// Sums of values about every node, over the nodes at most so many rings and nodes away.
pub(super) fn sums_about(grid: &WallGrid, values: &[f64], [rings_away, nodes_away]: [usize; 2]) -> Vec<f64> {
    let WallGrid { rings, nodes, .. } = *grid;
    let add = |sums: &mut [f64], values: &[f64]| sums.iter_mut().zip(values).for_each(|(sum, x)| *sum += x);
    let mut sums = vec![0.0; values.len()];
    let mut column = vec![0.0; nodes];
    for (k, around) in sums.chunks_exact_mut(nodes).enumerate() {
        column.fill(0.0);
        for other in k.saturating_sub(rings_away)..(k + rings_away + 1).min(rings) {
            add(&mut column, &values[other * nodes..(other + 1) * nodes]);
        }
        for offset in 0..=2 * nodes_away {
            // Node j takes what lies `offset - nodes_away` after it.
            let first = (nodes + offset - nodes_away) % nodes;
            add(around, &column[first..]);
            add(&mut around[nodes - first..], &column[..first]);
        }
    }
    sums
}

/// Moments of a value per node within a window about one of them; offsets in nodes.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    sum: f64,
    /// First and second moments along the axis and about it.
    along: [f64; 2],
    around: [f64; 2],
}

impl Moments {
    /// About every node, over the nodes at most `reach` rings and nodes away.
    fn about(grid: &WallGrid, values: &[f64], [rings_away, nodes_away]: [usize; 2]) -> Vec<Self> {
        let (rings, nodes) = (grid.rings, grid.nodes);
        let tasks = TASK.div_ceil(nodes);
        let mut columns = vec![[0.0; 3]; values.len()];
        columns.par_chunks_mut(nodes).with_min_len(tasks).enumerate().for_each(|(k, columns)| {
            for other in k.saturating_sub(rings_away)..(k + rings_away + 1).min(rings) {
                let offset = other as f64 - k as f64;
                for j in 0..nodes {
                    let value = values[other * nodes + j];
                    let column = &mut columns[j];
                    column[0] += value;
                    column[1] += offset * value;
                    column[2] += offset * offset * value;
                }
            }
        });
        let mut moments = vec![Self::default(); values.len()];
        moments.par_chunks_mut(nodes).zip(columns.par_chunks(nodes)).with_min_len(tasks).for_each(
            |(moments, columns)| {
                for (j, moments) in moments.iter_mut().enumerate() {
                    for i in 0..=2 * nodes_away {
                        let offset = i as f64 - nodes_away as f64;
                        let [sum, first, second] = columns[(j + nodes + i - nodes_away) % nodes];
                        moments.sum += sum;
                        moments.along[0] += first;
                        moments.along[1] += second;
                        moments.around[0] += offset * sum;
                        moments.around[1] += offset * offset * sum;
                    }
                }
            },
        );
        moments
    }

    /// The variance of a plane through the echoes at the node, relative to that at their centre: 1 among echoes, 4 at a
    /// straight edge of them, more beyond it.
    fn leverage(&self) -> f64 {
        // The variance of an echo's place within its cell.
        let cell = 1.0 / 12.0;
        let offset = |[first, second]: [f64; 2]| {
            let mean = first / self.sum;
            mean * mean / (second / self.sum - mean * mean + cell)
        };
        1.0 + offset(self.along) + offset(self.around)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_the_moments() {
        let grid = WallGrid { rings: 9, nodes: 11, step_mm: 1.0, arc_mm: 1.0 };
        let values: Vec<f64> = (0..99).map(|n| f64::from(n * n % 31)).collect();
        for reach in [[1, 1], [2, 3], [8, 5]] {
            let moments = Moments::about(&grid, &values, reach);
            let sums = sums_about(&grid, &values, reach);
            assert!(sums.iter().zip(&moments).all(|(sum, moments)| *sum == moments.sum), "{reach:?}");
        }
        assert_ne!(sums_about(&grid, &values, [1, 1]), sums_about(&grid, &values, [2, 1]));
    }

    #[test]
    fn gaps_are_closed_where_all_of_their_nodes_may_be() {
        // Half a radius is 3.2 mm.
        let grid = WallGrid { rings: 10, nodes: 40, step_mm: 1.0, arc_mm: 1.0 };
        let at = |ring: usize, node: usize| ring * 40 + node;
        let closed = [at(2, 39), at(2, 0), at(3, 1), at(4, 6)];
        // At an end, with a node that must stay open, and too long.
        let open = [at(1, 3), at(1, 4), at(3, 20), at(4, 20), at(5, 20), at(6, 20), at(9, 4)];
        let mut supported = vec![true; 400];
        closed.iter().chain(&open).for_each(|&node| supported[node] = false);
        let mut may_be = vec![true; 400];
        may_be[at(1, 4)] = false;
        close_gaps(&grid, &mut supported, &may_be);
        assert_eq!((0..400).filter(|&node| !supported[node]).collect::<Vec<_>>(), open);
    }
}
