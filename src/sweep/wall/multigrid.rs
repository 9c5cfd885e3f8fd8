//! The preconditioner: a multigrid cycle over ever coarser grids of the same wall.
//!
//! What is smooth on one grid is rough on a coarser one, where relaxation removes it. So it costs the same few steps
//! whether echoes or bending determine the wall, and however unevenly the echoes lie: in a hole between them too, which
//! the bending alone determines (A. Brandt, *Multi-level adaptive solutions to boundary-value problems*, Mathematics of
//! Computation 31, 1977; W. L. Briggs, V. E. Henson, S. F. McCormick, *A Multigrid Tutorial*, 2000).

use super::operator::{Operator, Windows, for_each, split, with_windows};
use crate::numerics::Scalar;
use crate::numerics::banded::{Banded, BandedFactor};
use crate::sweep::prepare::grid::WallGrid;
use rayon::prelude::*;
use std::ops::Range;

/// A grid of at most this many nodes per ring is solved by factors.
const COARSEST_NODES: usize = 12;
/// Grids are coarsened both ways while the distances of rings and of nodes differ by less than this factor, and only in
/// the direction of the smaller one otherwise: relaxation removes what is rough in the direction of strong coupling.
const MAX_ASPECT: f64 = 1.5;
/// Weights of the two relaxations before the correction by the coarser grid; after it they come in the other order, so that
/// the cycle is symmetric. They are the inverse roots of the Chebyshev polynomial of the interval from 0.5 to 4, which no
/// eigenvalue of the matrix exceeds once its diagonal is scaled to one: it is a sum of squares of at most four values.
pub(super) const RELAXATIONS: [f64; 2] = [0.286_743, 0.987_578];
/// Added to the diagonal of the coarsest grid, in units of the largest one, so that a wall without echoes has a solution.
const FLOOR: f64 = 1e-12;
/// Nodes per parallel task of a transfer between grids.
const TASK_NODES: usize = 2048;

/// The grids, from the finest on.
///
/// The cycle computes in f32: it need not be exact, and half the bytes take less time where rings are wide.
pub(super) struct Multigrid {
    /// All grids but the coarsest.
    levels: Vec<Level>,
    coarsest: WallGrid,
    factored: BandedFactor,
}

/// A grid that is relaxed on.
struct Level {
    operator: Operator<f32>,
    inverse_diagonal: Vec<f32>,
    /// The way to the next coarser grid, and its shape.
    transfer: Transfer<f32>,
    coarser: WallGrid,
}

/// Vectors of one grid: right-hand side, values on the way down, and values at the end.
pub(super) struct Room {
    right: Vec<f32>,
    before: Vec<f32>,
    values: Vec<f32>,
}

impl Multigrid {
    /// `None` where the matrix is not positive definite.
    pub(super) fn of(finest: &Operator) -> Option<Self> {
        let mut coarser: Vec<Operator> = Vec::new();
        let mut weights = finest.lumped_weights();
        loop {
            let operator = coarser.last().unwrap_or(finest);
            if operator.grid.nodes <= COARSEST_NODES {
                break;
            }
            let grid = coarsened(&operator.grid);
            let mut fewer = vec![0.0; grid.node_count()];
            Transfer::between(&operator.grid, &grid).restrict(&weights, &mut fewer);
            let local = operator.local().resampled(operator.grid.rings, grid.rings);
            let next = Operator::lumped(&grid, fewer.clone(), operator.smoothness_mm2, local);
            weights = fewer;
            coarser.push(next);
        }
        let coarsest = coarser.last().unwrap_or(finest);
        let level = |(operator, coarser): (&Operator, &Operator)| {
            let diagonal = operator.diagonal();
            let inverse = diagonal.par_iter().with_min_len(TASK_NODES).map(|x| x.recip() as f32);
            Level {
                inverse_diagonal: inverse.collect(),
                operator: operator.rounded(),
                transfer: Transfer::between(&operator.grid, &coarser.grid),
                coarser: coarser.grid,
            }
        };
        let levels: Vec<_> = std::iter::once(finest).chain(&coarser).zip(&coarser).collect();
        let (factored, levels) =
            rayon::join(|| factored(coarsest, &weights), || levels.into_par_iter().map(level).collect());
        Some(Self { levels, coarsest: coarsest.grid, factored: factored? })
    }

    /// Room for [`precondition`](Self::precondition).
    pub(super) fn room(&self) -> Vec<Room> {
        let of_grid = |grid: &WallGrid| {
            let zeros = || vec![0.0; grid.node_count()];
            Room { right: zeros(), before: zeros(), values: zeros() }
        };
        let relaxed = self.levels.iter().map(|level| of_grid(&level.operator.grid));
        relaxed.chain([of_grid(&self.coarsest)]).collect()
    }

    /// An approximate solution for `right`.
    pub(super) fn precondition<'r>(&self, right: &[f64], room: &'r mut [Room]) -> &'r [f32] {
        let rounded = &mut room[0].right;
        let pairs = rounded.par_iter_mut().with_min_len(TASK_NODES).zip(right);
        pairs.for_each(|(rounded, right)| *rounded = *right as f32);
        self.cycle(0, room);
        Self::found(room)
    }

    /// What [`precondition`](Self::precondition) found last.
    pub(super) fn found(room: &[Room]) -> &[f32] {
        &room[0].values
    }

    fn cycle(&self, level: usize, room: &mut [Room]) {
        let [here, coarser @ ..] = room else { return };
        let Some(of_level) = self.levels.get(level) else {
            let mut values: Vec<f64> = here.right.iter().map(|x| f64::from(*x)).collect();
            self.factored.solve(&mut values);
            here.values.iter_mut().zip(values).for_each(|(rounded, value)| *rounded = value as f32);
            return;
        };
        of_level.descend(&here.right, &mut here.before, &mut coarser[0].right);
        self.cycle(level + 1, coarser);
        of_level.ascend(&here.right, &here.before, &coarser[0].values, &mut here.values);
    }
}

impl Level {
    /// Two relaxations from zero, and the residual on the next coarser grid. A task does all of it for some rings, and once
    /// more for those beside them that its own depend on: threads meet once, not four times.
    fn descend(&self, right: &[f32], values: &mut [f32], right_there: &mut [f32]) {
        let Self { operator, inverse_diagonal: inverse, transfer, coarser: there } = self;
        let grid = &operator.grid;
        let nodes = grid.nodes;
        let [first, second] = RELAXATIONS.map(|weight| weight as f32);
        let fine: Vec<Range<usize>> = grid.bands();
        let starts: Vec<usize> = fine.iter().map(|band| transfer.rings.first_from(band.start)).collect();
        let ends = starts.iter().skip(1).copied().chain([there.rings]);
        let coarse: Vec<Range<usize>> = starts.iter().zip(ends).map(|(start, end)| *start..end).collect();
        let values = split(values, nodes, fine.iter().cloned());
        let right_there = split(right_there, there.nodes, coarse.iter().cloned());
        let tasks = fine.into_iter().zip(coarse).zip(values.into_iter().zip(right_there)).collect();
        for_each(tasks, |((fine, coarse), (values, right_there))| {
            with_windows(
                #[inline(always)]
                |Windows { rounded: [a, b], .. }| {
                    let needed = transfer.rings.needed_for(coarse.clone(), &fine);
                    a.fill(
                        nodes,
                        grid.wider(&needed, 4),
                        #[inline(always)]
                        |k, ring| {
                            let (right, inverse) = (&right[k * nodes..], &inverse[k * nodes..]);
                            for ((x, inverse), right) in ring.iter_mut().zip(inverse).zip(right) {
                                *x = first * inverse * right;
                            }
                        },
                    );
                    b.fill(
                        nodes,
                        grid.wider(&needed, 2),
                        #[inline(always)]
                        |k, ring| operator.relax(k, right, a, (second, inverse), ring),
                    );
                    for (k, values) in fine.zip(values.chunks_exact_mut(nodes)) {
                        values.copy_from_slice(b.ring(k));
                    }
                    a.fill(
                        nodes,
                        needed,
                        #[inline(always)]
                        |k, ring| operator.residual(k, right, b, ring),
                    );
                    let mut sum = vec![0.0; nodes];
                    for (k, right_there) in coarse.zip(right_there.chunks_exact_mut(there.nodes)) {
                        transfer.restrict_ring(
                            k,
                            #[inline(always)]
                            |from| a.ring(from),
                            &mut sum,
                            right_there,
                        );
                    }
                },
            );
        });
    }

    /// The correction by the next coarser grid, and two relaxations; `before` are the values on the way down.
    fn ascend(&self, right: &[f32], before: &[f32], coarse: &[f32], values: &mut [f32]) {
        let Self { operator, inverse_diagonal: inverse, transfer, .. } = self;
        let grid = &operator.grid;
        let nodes = grid.nodes;
        let [first, second] = RELAXATIONS.map(|weight| weight as f32);
        let bands = grid.bands();
        let values = split(values, nodes, bands.iter().cloned());
        for_each(bands.into_iter().zip(values).collect(), |(band, values)| {
            with_windows(
                #[inline(always)]
                |Windows { rounded: [a, b], .. }| {
                    let mut between = vec![0.0; transfer.nodes.to_coarse.len()];
                    a.fill(
                        nodes,
                        grid.wider(&band, 4),
                        #[inline(always)]
                        |k, ring| {
                            ring.copy_from_slice(&before[k * nodes..][..nodes]);
                            transfer.prolong_ring(k, coarse, &mut between, ring);
                        },
                    );
                    b.fill(
                        nodes,
                        grid.wider(&band, 2),
                        #[inline(always)]
                        |k, ring| operator.relax(k, right, a, (second, inverse), ring),
                    );
                    for (k, values) in band.zip(values.chunks_exact_mut(nodes)) {
                        operator.relax(k, right, b, (first, inverse), values);
                    }
                },
            );
        });
    }
}

/// The next coarser grid over the same wall. A ring of one node has nothing about the axis.
pub(super) fn coarsened(grid: &WallGrid) -> WallGrid {
    let WallGrid { rings, nodes, step_mm, arc_mm } = *grid;
    let fewer_rings = rings > 3 && (nodes == 1 || step_mm < MAX_ASPECT * arc_mm);
    let fewer_nodes = nodes > 1 && (!fewer_rings || arc_mm < MAX_ASPECT * step_mm);
    let (new_rings, new_nodes) = (
        if fewer_rings { (rings - 1).div_ceil(2) + 1 } else { rings },
        if fewer_nodes { nodes.div_ceil(2) } else { nodes },
    );
    let step_mm = match new_rings == rings {
        true => step_mm,
        false => step_mm * (rings - 1) as f64 / (new_rings - 1) as f64,
    };
    WallGrid { rings: new_rings, nodes: new_nodes, step_mm, arc_mm: arc_mm * nodes as f64 / new_nodes as f64 }
}

/// The factors of a grid with few nodes per ring, with these weights of the echoes at its nodes.
fn factored(operator: &Operator, weights: &[f64]) -> Option<BandedFactor> {
    let WallGrid { rings, nodes, .. } = operator.grid;
    let mut matrix = Banded::zeros(rings * nodes, 2 * nodes);
    for (node, weight) in weights.iter().enumerate() {
        matrix.add(node, node, *weight);
        for (bending, terms) in operator.squares(node / nodes, node % nodes) {
            for (a, x) in terms {
                for (b, y) in terms.into_iter().filter(|(b, _)| *b <= a) {
                    matrix.add(a, b, bending * x * y);
                }
            }
        }
    }
    matrix.factored(FLOOR)
}

/// Linear interpolation from a coarser grid, and its transpose.
struct Transfer<T> {
    rings: Interpolation<T>,
    nodes: Interpolation<T>,
}

impl<T: Scalar> Transfer<T> {
    fn between(fine: &WallGrid, coarse: &WallGrid) -> Self {
        Self {
            rings: Interpolation::new(fine.rings, coarse.rings, false),
            nodes: Interpolation::new(fine.nodes, coarse.nodes, true),
        }
    }

    /// The transpose of interpolation: every node's value, shared out among the coarser nodes about it.
    fn restrict(&self, fine: &[T], coarse: &mut [T]) {
        let (wide, narrow) = (self.nodes.to_fine.len(), self.nodes.to_coarse.len());
        let tasks = coarse.par_chunks_mut(narrow).with_min_len(TASK_NODES.div_ceil(wide)).enumerate();
        tasks.for_each_init(
            || vec![T::default(); wide],
            |sum, (k, ring)| self.restrict_ring(k, |from| &fine[from * wide..(from + 1) * wide], sum, ring),
        );
    }

    /// As [`restrict`](Self::restrict), to the coarser ring k.
    #[inline(always)]
    fn restrict_ring<'a>(&self, k: usize, fine: impl Fn(usize) -> &'a [T], sum: &mut [T], ring: &mut [T]) {
        sum.fill(T::default());
        for &(from, weight) in &self.rings.to_coarse[k] {
            sum.iter_mut().zip(fine(from)).for_each(|(sum, x)| *sum = *sum + weight * *x);
        }
        self.nodes.restrict(sum, ring);
    }

    /// Adds the interpolated values of the coarser grid to ring k.
    #[inline(always)]
    fn prolong_ring(&self, k: usize, coarse: &[T], between: &mut [T], ring: &mut [T]) {
        let narrow = between.len();
        let Share { below, above, part } = self.rings.to_fine[k];
        let [a, b] = [below, above].map(|k| &coarse[k * narrow..(k + 1) * narrow]);
        for ((between, a), b) in between.iter_mut().zip(a).zip(b) {
            *between = *a + part * (*b - *a);
        }
        self.nodes.add_prolonged(between, ring);
    }
}

/// A place between two coarser ones.
#[derive(Clone, Copy)]
struct Share<T> {
    below: usize,
    above: usize,
    /// The weight of the one above.
    part: T,
}

/// Linear interpolation in one direction.
struct Interpolation<T> {
    to_fine: Vec<Share<T>>,
    /// Per coarse place: the fine ones that it has a share in, with their weights.
    to_coarse: Vec<Vec<(usize, T)>>,
    /// Whether every second fine place is a coarse one, about a closed ring.
    is_halving: bool,
}

impl<T: Scalar> Interpolation<T> {
    /// From `coarse` evenly spaced places to `fine` ones over the same length, or about the same ring if `closed`.
    fn new(fine: usize, coarse: usize, closed: bool) -> Self {
        let mut to_coarse = vec![Vec::new(); coarse];
        let share = |i: usize| {
            // Coarse intervals for each fine one, as a fraction of integers: exact where places coincide.
            let (coarse_intervals, intervals) = if closed { (coarse, fine) } else { (coarse - 1, fine - 1) };
            let below = i * coarse_intervals / intervals;
            let part = (i * coarse_intervals % intervals) as f64 / intervals as f64;
            let above = if closed { (below + 1) % coarse } else { (below + 1).min(coarse - 1) };
            (Share { below, above, part: T::from_f64(part) }, T::from_f64(1.0 - part))
        };
        let shares: Vec<_> = (0..fine).map(share).collect();
        for (i, &(Share { below, above, part }, rest)) in shares.iter().enumerate() {
            to_coarse[below].push((i, rest));
            if part > T::default() {
                to_coarse[above].push((i, part));
            }
        }
        let to_fine = shares.into_iter().map(|(share, _)| share).collect();
        Self { to_fine, to_coarse, is_halving: closed && fine == 2 * coarse }
    }

    /// The first coarse place at or behind a fine one.
    fn first_from(&self, fine: usize) -> usize {
        let Share { below, part, .. } = self.to_fine[fine];
        if part > T::default() { below + 1 } else { below }
    }

    /// The fine places that have a share in some coarse ones, and these.
    fn needed_for(&self, coarse: Range<usize>, fine: &Range<usize>) -> Range<usize> {
        let with_share = || coarse.clone().flat_map(|k| &self.to_coarse[k]).map(|(from, _)| *from);
        let first = with_share().fold(fine.start, usize::min);
        first..with_share().map(|from| from + 1).fold(fine.end, usize::max)
    }

    /// Values of fine places, shared out among the coarse ones.
    #[inline(always)]
    fn restrict(&self, fine: &[T], coarse: &mut [T]) {
        if self.is_halving {
            // The same weights, without lists.
            let half = T::from_f64(0.5);
            let mut before = fine[fine.len() - 1];
            for (x, pair) in coarse.iter_mut().zip(fine.chunks_exact(2)) {
                *x = pair[0] + half * (before + pair[1]);
                before = pair[1];
            }
        } else if fine.len() == coarse.len() {
            coarse.copy_from_slice(fine);
        } else {
            for (x, from) in coarse.iter_mut().zip(&self.to_coarse) {
                *x = from.iter().fold(T::default(), |sum, &(j, weight)| sum + weight * fine[j]);
            }
        }
    }

    /// Adds what is interpolated from coarse places to fine ones.
    #[inline(always)]
    fn add_prolonged(&self, coarse: &[T], fine: &mut [T]) {
        if self.is_halving {
            let half = T::from_f64(0.5);
            let next = coarse[1..].iter().chain(&coarse[..1]);
            for ((pair, here), next) in fine.chunks_exact_mut(2).zip(coarse).zip(next) {
                pair[0] = pair[0] + *here;
                pair[1] = pair[1] + half * (*here + *next);
            }
        } else if fine.len() == coarse.len() {
            fine.iter_mut().zip(coarse).for_each(|(fine, coarse)| *fine = *fine + *coarse);
        } else {
            for (x, &Share { below, above, part }) in fine.iter_mut().zip(&self.to_fine) {
                *x = *x + (coarse[below] + part * (coarse[above] - coarse[below]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::wall::bending::LocalSmoothness;
    use crate::sweep::wall::equations::Equations;

    /// Echoes with a hole, on a grid.
    fn equations(grid: &WallGrid) -> Equations {
        let mut equations = Equations::over(grid, 0..grid.rings);
        for i in 0..4 * grid.node_count() {
            let [ring, node] = [0.618_033_988_7, 0.414_213_562_3].map(|step| (step * i as f64).fract());
            if !(0.4..0.6).contains(&ring) || node > 0.5 {
                let corners = grid.corners(ring * (grid.rings - 1) as f64, node * grid.nodes as f64);
                equations.add(&corners, 0.1 + node, 1.0);
            }
        }
        equations
    }

    #[test]
    fn the_cycle_is_symmetric_and_positive_and_nearly_the_inverse() {
        for (rings, nodes, step_mm) in
            [(40, 24, 1.0), (41, 65, 1.1), (9, 90, 3.0), (3, 32, 0.2), (60, 16, 0.5)]
        {
            let grid = WallGrid { rings, nodes, step_mm, arc_mm: 1.0 };
            for smoothness in [0.02, 1.0, 300.0] {
                let operator = Operator::of(&equations(&grid), &grid, smoothness, LocalSmoothness::EVEN);
                let multigrid = Multigrid::of(&operator).unwrap();
                let mut room = multigrid.room();
                let wave = |seed: usize| -> Vec<f64> {
                    (0..grid.node_count()).map(|i| (0.37 * (i * (i + seed) % 977) as f64).sin()).collect()
                };
                let mut cycle = |right: &[f64]| -> Vec<f64> {
                    multigrid.precondition(right, &mut room).iter().map(|x| f64::from(*x)).collect()
                };
                let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                let (a, b) = (wave(1), wave(5));
                let (of_a, of_b) = (cycle(&a), cycle(&b));
                let size = (dot(&of_a, &a) * dot(&of_b, &b)).sqrt();
                // To rounding in f32.
                assert!(size > 0.0 && (dot(&of_a, &b) - dot(&a, &of_b)).abs() < 1e-6 * size, "{grid:?}");
                // Not the inverse, but by a bounded factor, at whatever smoothness.
                let mut product = a.clone();
                operator.apply(&a, &mut product);
                let found = cycle(&product);
                let ratio = dot(&found, &product) / dot(&a, &product);
                assert!((0.5..2.0).contains(&ratio), "{grid:?}, {smoothness}: {ratio}");
            }
        }
    }

    /// On a grid that is worth several threads, and with bands that end beside coarse rings and between them.
    #[test]
    fn the_cycle_does_not_depend_on_the_threads() {
        let grid = WallGrid { rings: 302, nodes: 50, step_mm: 1.0, arc_mm: 1.0 };
        let operator = Operator::of(&equations(&grid), &grid, 0.3, LocalSmoothness::EVEN);
        let right: Vec<f64> = (0..grid.node_count()).map(|i| (0.37 * (i * i % 977) as f64).sin()).collect();
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let multigrid = Multigrid::of(&operator).unwrap();
                (grid.bands().len(), multigrid.precondition(&right, &mut multigrid.room()).to_vec())
            })
        };
        let (few, expected) = on(1);
        for threads in [2, 7, 11] {
            let (many, found) = on(threads);
            assert!((threads == 2 || few < many) && expected == found, "{threads}");
        }
    }

    #[test]
    fn a_grid_and_the_next_coarser_one_cover_the_same_wall() {
        for (rings, nodes, step_mm, fewer) in
            [(40, 24, 1.0, (21, 12)), (41, 65, 0.5, (21, 65)), (9, 90, 3.0, (9, 45)), (3, 32, 0.2, (3, 16))]
        {
            let grid = WallGrid { rings, nodes, step_mm, arc_mm: 1.0 };
            let coarse = coarsened(&grid);
            assert_eq!((coarse.rings, coarse.nodes), fewer);
            let length = |grid: &WallGrid| (grid.rings - 1) as f64 * grid.step_mm;
            assert!((length(&coarse) - length(&grid)).abs() < 1e-12);
            assert!((coarse.radius_mm() - grid.radius_mm()).abs() < 1e-12);
            let transfer = Transfer::between(&grid, &coarse);
            // Linear functions along the axis are interpolated exactly, and no weight is lost on the way back.
            let along =
                |g: &WallGrid| (0..g.node_count()).map(|i| (i / g.nodes) as f64 * g.step_mm).collect();
            let (mut fine, expected): (Vec<f64>, Vec<f64>) = (vec![0.0; grid.node_count()], along(&grid));
            let mut between = vec![0.0; coarse.nodes];
            for (k, ring) in fine.chunks_exact_mut(nodes).enumerate() {
                transfer.prolong_ring(k, &along(&coarse), &mut between, ring);
            }
            assert!(fine.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{fine:?}");
            let mut sums = vec![0.0; coarse.node_count()];
            transfer.restrict(&expected, &mut sums);
            let [a, b] = [&sums, &expected].map(|x| x.iter().sum::<f64>());
            assert!((a - b).abs() < 1e-9 * b, "{a} {b}");
        }
    }
}
