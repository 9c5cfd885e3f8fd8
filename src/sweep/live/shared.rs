//! What errors that echoes share make of the wall, and how rough the wall is.
//!
//! Echoes of a frame, and of successive frames, err alike: they say less than as many independent ones. The residuals show by
//! how much. Each frame has random signs, alike in successive frames, and the wall through the residuals times these is a
//! draw of the wall's error: the dependent wild bootstrap (Shao, JASA 105, 2010). The equations are those of the wall, and
//! only their right-hand sides are kept beside it; one of a frame's two windows of rings, in turns, is solved for one of them
//! too, in turns. The wall through the residuals as they are shows where it is rougher or smoother than expected.

use crate::sweep::prepare::grid::WallGrid;
use crate::sweep::support::{NodeErrors, sums_about};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Right-hand sides: the residuals as they are, then draws of their signs.
pub(super) const SIGNS: usize = 8;
/// Walls that are kept: through the residuals of each, and through what each of the draws leaves.
pub(super) const WALLS: usize = 2 * SIGNS - 1;
/// Successive frames over which signs are alike: errors that are alike for longer are counted in part.
const ALIKE_FRAMES: u32 = 8;
/// Distance over which squares are averaged, in reaches of an echo, and in rings at most.
const AVERAGED_REACHES: f64 = 3.0;
/// The wall through what bends leave is smaller than the bends' own error by this, as squares: `∫ x²(1-x)²` against `∫ x²`
/// over the spectrum of a thin plate.
const BENDS_PER_FOUND: f64 = 8.0;
/// Squared roughness about a node, in units of the setting's, as in the sweep of a whole recording.
const MIN_ROUGHNESS: f64 = 0.25;
const MAX_ROUGHNESS: f64 = 64.0;

/// Factors of an echo's residual in each right-hand side.
pub(super) type Signs = [f32; SIGNS];

/// The signs of a frame: 1, then random numbers of unit variance, which are alike over [`ALIKE_FRAMES`] frames.
pub(super) fn signs(frame: u32) -> Signs {
    let mut signs = [0.0; SIGNS];
    signs[0] = 1.0;
    for back in 0..ALIKE_FRAMES {
        let bits = mixed(u64::from(frame) + u64::from(ALIKE_FRAMES - back));
        for (k, sign) in signs.iter_mut().enumerate().skip(1) {
            *sign += if bits >> k & 1 == 1 { 1.0 } else { -1.0 };
        }
    }
    signs[1..].iter_mut().for_each(|sign| *sign /= (ALIKE_FRAMES as f32).sqrt());
    signs
}

fn are_finite(signs: &[Signs]) -> bool {
    signs.as_flattened().iter().all(|x| x.is_finite())
}

/// A number whose bits are random: splitmix64 (Steele et al., OOPSLA 2014).
fn mixed(number: u64) -> u64 {
    let mut bits = number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Right-hand sides of the wall's equations for the residuals of echoes, times their signs: for each node that is covered.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Pulls(pub Vec<Signs>);

impl Pulls {
    pub fn new(nodes: usize) -> Self {
        Self(vec![[0.0; SIGNS]; nodes])
    }

    /// Whether they are numbers, for so many nodes.
    pub fn are_sound(&self, nodes: usize) -> bool {
        self.0.len() == nodes && are_finite(&self.0)
    }

    /// Adds those of other echoes, whose node 0 is node `first` here.
    pub fn merge(&mut self, first: usize, other: &Self) {
        for (pull, other) in self.0[first..].iter_mut().zip(&other.0) {
            pull.iter_mut().zip(other).for_each(|(a, b)| *a += b);
        }
    }

    pub fn scale(&mut self, factor: f64) {
        self.0.as_flattened_mut().iter_mut().for_each(|pull| *pull *= factor as f32);
    }
}

/// What is known of a ring.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Ring {
    /// How often its walls were solved for.
    rounds: u32,
    /// The variance of the wall under the echoes' errors, in units of that where they err independently.
    design_effect: f64,
    /// Squared roughness in units of the setting's.
    roughness: f64,
}

/// One of the walls that are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WallOf {
    /// Through the residuals with these signs.
    Residuals(usize),
    /// Through what remains of the residuals with these signs where the wall through them is taken off.
    Remains(usize),
}

/// The errors of a wall's nodes, as the residuals show them.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SharedErrors {
    of_residuals: Vec<Signs>,
    of_remains: Vec<Signs>,
    rings: Vec<Ring>,
}

/// Errors of some rings' nodes if the echoes erred independently, and what the averages need.
pub(super) struct Independent<'a> {
    pub grid: &'a WallGrid,
    /// Variance of each node under the echoes' errors, mm²; not finite without echoes.
    pub variance_mm2: &'a [f64],
    /// Distance about the lumen over which errors of the nodes are alike, mm.
    pub alike_mm: &'a [f64],
    /// Weight of the echoes at each node.
    pub weight: &'a [f64],
    /// The reach of an echo, mm.
    pub reach_mm: f64,
}

impl SharedErrors {
    pub fn none() -> Self {
        Self { of_residuals: Vec::new(), of_remains: Vec::new(), rings: Vec::new() }
    }

    /// Whether these are the errors of so many rings and nodes.
    pub fn is_sound(&self, rings: usize, nodes: usize) -> bool {
        let is_sound = |ring: &Ring| {
            let factors = [ring.design_effect, ring.roughness];
            factors.iter().all(|factor| (1e-3..=1e3).contains(factor))
        };
        self.rings.len() == rings
            && [self.of_residuals.len(), self.of_remains.len()] == [rings * nodes; 2]
            && self.rings.iter().all(is_sound)
            && [&self.of_residuals, &self.of_remains].into_iter().all(|walls| are_finite(walls))
    }

    /// Inserts rings in front or behind, of which as much is known as of the last one there.
    pub fn insert(&mut self, at_front: bool, rings: usize, nodes: usize) {
        let unknown = Ring { rounds: 0, design_effect: 1.0, roughness: 1.0 };
        let end = if at_front { self.rings.first() } else { self.rings.last() };
        let ring = Ring { rounds: 0, ..end.copied().unwrap_or(unknown) };
        let at = if at_front { 0 } else { self.rings.len() };
        self.rings.splice(at..at, std::iter::repeat_n(ring, rings));
        for walls in [&mut self.of_residuals, &mut self.of_remains] {
            walls.splice(at * nodes..at * nodes, std::iter::repeat_n([0.0; SIGNS], rings * nodes));
        }
    }

    /// The wall that is next in some rings: each of them has its turn.
    pub fn next(&mut self, rings: &Range<usize>) -> WallOf {
        let turn = self.rings[(rings.start + rings.end) / 2].rounds as usize % WALLS;
        self.rings[rings.clone()].iter_mut().for_each(|ring| ring.rounds = ring.rounds.saturating_add(1));
        if turn < SIGNS { WallOf::Residuals(turn) } else { WallOf::Remains(turn - SIGNS + 1) }
    }

    fn of(&self, wall: WallOf) -> (&[Signs], usize) {
        match wall {
            WallOf::Residuals(k) => (&self.of_residuals, k),
            WallOf::Remains(k) => (&self.of_remains, k),
        }
    }

    /// A wall at some nodes, mm.
    pub fn at(&self, wall: WallOf, nodes: Range<usize>) -> Vec<f64> {
        let (walls, k) = self.of(wall);
        walls[nodes].iter().map(|signs| f64::from(signs[k])).collect()
    }

    /// Changes a wall from node `first` on.
    pub fn add(&mut self, wall: WallOf, first: usize, change_mm: &[f64]) {
        let (walls, k) = match wall {
            WallOf::Residuals(k) => (&mut self.of_residuals, k),
            WallOf::Remains(k) => (&mut self.of_remains, k),
        };
        walls[first..].iter_mut().zip(change_mm).for_each(|(signs, change)| signs[k] += *change as f32);
    }

    /// Errors of the nodes of the rings `window` that the echoes' errors and the wall's bends cause, where the grid of
    /// `independent` begins at ring `first`.
    pub fn node_errors(
        &mut self,
        window: &Range<usize>,
        first: usize,
        independent: &Independent,
    ) -> NodeErrors {
        let Independent { grid, variance_mm2, alike_mm, weight, reach_mm } = *independent;
        let nodes = grid.nodes;
        let reach = [grid.step_mm, grid.arc_mm]
            .map(|spacing| ((AVERAGED_REACHES * reach_mm / spacing).round() as usize).min(nodes / 4).max(1));
        let is_known = |n: usize| {
            self.rings[first + n / nodes].rounds as usize >= WALLS
                && weight[n] > 0.0
                && variance_mm2[n].is_finite()
        };
        let about = |value: &dyn Fn(usize) -> f64| {
            let values: Vec<f64> =
                (0..grid.node_count()).map(|n| if is_known(n) { value(n) } else { 0.0 }).collect();
            sums_about(grid, &values, reach)
        };
        let draws = |walls: &[Signs], n: usize| {
            let squares = walls[first * nodes + n][1..].iter().map(|&x| f64::from(x).powi(2));
            squares.sum::<f64>() / (SIGNS - 1) as f64
        };
        let noise = about(&|n| draws(&self.of_residuals, n));
        let excess = about(&|n| {
            f64::from(self.of_residuals[first * nodes + n][0]).powi(2) - draws(&self.of_remains, n)
        });
        // As rough as the setting says, a wall has bends of the size of independent noise.
        let expected = about(&|n| variance_mm2[n]);
        let mut errors = NodeErrors { standard_error_mm: Vec::new(), reach_mm: Vec::new() };
        for k in window.clone() {
            let (mut effects, mut logarithms, mut count) = (0.0, 0.0, 0.0);
            let drawn_mm = self.alike_nodes(k, reach[0]).map(|count| count * grid.arc_mm);
            for n in (k - first) * nodes..(k - first + 1) * nodes {
                let (design_effect, roughness) = if expected[n] > 0.0 {
                    let design_effect = (noise[n] / expected[n]).max(1.0);
                    let roughness = BENDS_PER_FOUND * excess[n] / expected[n];
                    let roughness = roughness.clamp(MIN_ROUGHNESS, MAX_ROUGHNESS);
                    effects += design_effect;
                    logarithms += roughness.ln();
                    count += 1.0;
                    (design_effect, roughness)
                } else {
                    (self.rings[k].design_effect, self.rings[k].roughness)
                };
                let both = design_effect + roughness;
                let drawn_mm = drawn_mm.unwrap_or(alike_mm[n]);
                errors.standard_error_mm.push((variance_mm2[n] * both).sqrt());
                errors.reach_mm.push((design_effect * drawn_mm + roughness * alike_mm[n]) / both);
            }
            let ring = &mut self.rings[k];
            if count > 0.0 {
                ring.design_effect = (effects / count).clamp(1.0, 1e3);
                ring.roughness = (logarithms / count).exp().clamp(MIN_ROUGHNESS, MAX_ROUGHNESS);
            }
        }
        errors
    }

    /// Number of nodes of a ring whose drawn errors are alike: the variance of their sum over the sum of their variances. It
    /// is a mean over the rings at most `away` from it; `None` where too little is known of them.
    fn alike_nodes(&self, ring: usize, away: usize) -> Option<f64> {
        let nodes = self.of_residuals.len() / self.rings.len();
        let (mut of_sums, mut of_each) = (0.0, 0.0);
        let known = |k: &usize| self.rings[*k].rounds as usize >= WALLS;
        for k in (ring.saturating_sub(away)..(ring + away + 1).min(self.rings.len())).filter(known) {
            for draw in 1..SIGNS {
                let of_ring =
                    self.of_residuals[k * nodes..(k + 1) * nodes].iter().map(|s| f64::from(s[draw]));
                let (sum, squares) = of_ring.fold((0.0, 0.0), |(sum, squares), x| (sum + x, squares + x * x));
                of_sums += sum * sum;
                of_each += squares;
            }
        }
        (of_each > 0.0).then(|| (of_sums / of_each).clamp(1.0, nodes as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_are_alike_in_successive_frames_only() {
        let all: Vec<Signs> = (0..20_000).map(signs).collect();
        let mean = |k: usize, l: usize, lag: usize| {
            let products = all.iter().zip(&all[lag..]).map(|(a, b)| f64::from(a[k] * b[l]));
            products.sum::<f64>() / (all.len() - lag) as f64
        };
        for k in 1..SIGNS {
            for (lag, expected) in [(0, 1.0), (2, 0.75), (4, 0.5), (8, 0.0), (40, 0.0)] {
                assert!((mean(k, k, lag) - expected).abs() < 0.08, "{k} {lag}: {}", mean(k, k, lag));
            }
            assert!(mean(k, 0, 0).abs() < 0.08, "{k}: {}", mean(k, 0, 0));
            assert!((1..k).all(|l| mean(k, l, 0).abs() < 0.08), "{k}");
        }
        assert!(all.iter().all(|signs| signs[0] == 1.0));
    }
}
