//! The surface on which a function of place is zero.
//!
//! Marching tetrahedra: every cell of a lattice is split into six about its diagonal, alike in all cells, so that the
//! triangles of neighbours fit. A. Doi, A. Koide, *An efficient method of triangulating equi-valued surfaces by using
//! tetrahedral cells*, IEICE Transactions 74(1), 1991.

use super::Surface;
use glam::{DVec3, I64Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// A lattice of cells.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lattice {
    /// The lowest corner of cell 0, mm.
    pub origin_mm: DVec3,
    /// Edges of a cell, mm.
    pub step_mm: DVec3,
}

/// How near to a lattice point, in edges, the surface may pass: triangles would shrink to nothing there.
const LEAST: f64 = 0.02;
/// How near to the surface a crossing lies, in edges, and after so many steps it is found by halving.
const NEAR: f64 = 1e-4;
const SECANTS: usize = 8;
/// Halvings of an edge where crossings are found by these alone.
const HALVINGS: usize = 14;

/// How the places are found where the surface crosses edges of the lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Crossings {
    /// By halving: simulated vessels, so that a seed makes the same recording as ever.
    Halved,
    /// By false position, in a third of the evaluations.
    FalsePosition,
}

impl Lattice {
    fn corner_mm(&self, corner: I64Vec3) -> DVec3 {
        self.origin_mm + corner.as_dvec3() * self.step_mm
    }

    /// The cell that a point lies in.
    pub(crate) fn cell(&self, point_mm: DVec3) -> I64Vec3 {
        ((point_mm - self.origin_mm) / self.step_mm).floor().as_i64vec3()
    }

    /// The surface where `field` is zero, within some cells, given each once; normals point to where it is positive.
    /// `field` may be infinite: false position goes on by halving where it does not get on.
    pub(crate) fn zero_surface(
        &self,
        cells: &[I64Vec3],
        by: Crossings,
        field: impl Fn(DVec3) -> f64 + Sync,
    ) -> Surface {
        let corners_of = |cell: I64Vec3| (0..8).map(move |k| cell + I64Vec3::new(k & 1, k >> 1 & 1, k >> 2));
        let key = |c: &I64Vec3| c.to_array();
        let mut corners: Vec<I64Vec3> = cells.iter().copied().flat_map(corners_of).collect();
        corners.par_sort_unstable_by_key(key);
        corners.dedup();
        let [least, near] = [LEAST, NEAR].map(|share| share * self.step_mm.min_element());
        let values: Vec<f64> = corners
            .par_iter()
            .map(|&corner| {
                let d = field(self.corner_mm(corner));
                if d < 0.0 { d.min(-least) } else { d.max(least) }
            })
            .collect();
        let number = |corner: I64Vec3| corners.binary_search_by_key(&key(&corner), key).unwrap_or(0) as u32;
        // Tetrahedra that the surface cuts, by the numbers of their corners.
        let cut: Vec<[u32; 4]> = cells
            .par_iter()
            .flat_map_iter(|&cell| {
                let low = number(cell);
                let of_path = |path: [usize; 3]| {
                    let mut corner = cell;
                    let mut tetrahedron = [low; 4];
                    for (node, axis) in tetrahedron[1..].iter_mut().zip(path) {
                        corner[axis] += 1;
                        *node = number(corner);
                    }
                    tetrahedron
                };
                let inside = corners_of(cell).filter(|&c| values[number(c) as usize] < 0.0).count();
                let paths = if inside % 8 == 0 { &[][..] } else { &DIAGONAL_PATHS[..] };
                paths.iter().map(move |&path| of_path(path)).collect::<Vec<_>>()
            })
            .filter(|tetrahedron| {
                let inside = tetrahedron.iter().filter(|&&n| values[n as usize] < 0.0).count();
                inside % 4 != 0
            })
            .collect();
        let place = |n: u32| self.corner_mm(corners[n as usize]);
        let mut crossings: HashMap<[u32; 2], u32> = HashMap::new();
        let mut edges: Vec<[u32; 2]> = Vec::new();
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        let mut outward: Vec<DVec3> = Vec::new();
        for tetrahedron in cut {
            let (inside, outside): (Vec<u32>, Vec<u32>) =
                tetrahedron.into_iter().partition(|&n| values[n as usize] < 0.0);
            let around = match (inside.as_slice(), outside.as_slice()) {
                (&[a], &[b, c, d]) => vec![[a, b], [a, c], [a, d]],
                (&[b, c, d], &[a]) => vec![[b, a], [c, a], [d, a]],
                (&[a, b], &[c, d]) => vec![[a, c], [a, d], [b, d], [b, c]],
                _ => continue,
            };
            let mut crossing = |edge: [u32; 2]| {
                *crossings.entry(edge).or_insert_with(|| {
                    edges.push(edge);
                    (edges.len() - 1) as u32
                })
            };
            let nodes: Vec<u32> = around.into_iter().map(&mut crossing).collect();
            let mean = |nodes: &[u32]| nodes.iter().map(|&n| place(n)).sum::<DVec3>() / nodes.len() as f64;
            for pair in nodes[1..].windows(2) {
                triangles.push([nodes[0], pair[0], pair[1]]);
                outward.push(mean(&outside) - mean(&inside));
            }
        }
        let nodes_mm: Vec<DVec3> = edges
            .par_iter()
            .map(|&[inside, outside]| {
                let [from, to] = [inside, outside].map(place);
                let value = |share: f64| field(from.lerp(to, share));
                let share = match by {
                    Crossings::Halved => halved(value),
                    Crossings::FalsePosition => {
                        false_position([inside, outside].map(|n| values[n as usize]), near, value)
                    }
                };
                from.lerp(to, share.clamp(LEAST, 1.0 - LEAST))
            })
            .collect();
        for (triangle, outward) in triangles.iter_mut().zip(outward) {
            let [a, b, c] = triangle.map(|n| nodes_mm[n as usize]);
            if (b - a).cross(c - a).dot(outward) < 0.0 {
                triangle.swap(1, 2);
            }
        }
        Surface { nodes_mm, triangles, arrays: Vec::new() }
    }
}

/// Where a function that is negative at 0 and positive at 1 changes its sign.
fn halved(value: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        *(if value(middle) < 0.0 { &mut low } else { &mut high }) = middle;
    }
    0.5 * (low + high)
}

/// Where a function that is `ends[0]` < 0 at 0 and `ends[1]` > 0 at 1 is within `near` of zero, or where it jumps.
///
/// The Illinois variant of false position: an end that stays twice counts half (M. Dowell, P. Jarratt, *A modified regula falsi
/// method for computing the root of an equation*, BIT 11, 1971).
fn false_position(ends: [f64; 2], near: f64, value: impl Fn(f64) -> f64) -> f64 {
    let ([mut low, mut high], [mut below, mut above]) = ([0.0, 1.0], ends);
    let mut last = 0;
    for step in 0..64 {
        let secant = low - below * (high - low) / (above - below);
        let middle = 0.5 * (low + high);
        let at = if step < SECANTS && secant > low && secant < high { secant } else { middle };
        let found = value(at);
        if found.abs() <= near || high - low <= NEAR {
            return at;
        }
        if found < 0.0 {
            (low, below) = (at, found);
            above *= if last < 0 { 0.5 } else { 1.0 };
            last = -1;
        } else {
            (high, above) = (at, found);
            below *= if last > 0 { 0.5 } else { 1.0 };
            last = 1;
        }
    }
    0.5 * (low + high)
}

/// The orders in which the three axes lead from one end of a cell's diagonal to the other.
const DIAGONAL_PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tube_is_open_where_the_cells_end() {
        let lattice = Lattice { origin_mm: DVec3::new(-10.0, -10.0, 0.0), step_mm: DVec3::ONE };
        let cells: Vec<I64Vec3> =
            (0..20 * 20 * 30).map(|k| I64Vec3::new(k % 20, k / 20 % 20, k / 400)).collect();
        for crossings in [Crossings::Halved, Crossings::FalsePosition] {
            check_tube(&lattice.zero_surface(&cells, crossings, |p| p.truncate().length() - 8.0));
        }
    }

    fn check_tube(surface: &Surface) {
        let topology = surface.topology();
        assert!(topology.is_oriented_manifold());
        assert_eq!((topology.components, topology.boundary_loops, topology.euler_characteristic), (1, 2, 0));
        for p in &surface.nodes_mm {
            // Off the wall by what keeps it off the lattice.
            assert!((p.truncate().length() - 8.0).abs() < 1.8 * LEAST, "{p}");
        }
        let outward = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|n| surface.nodes_mm[n as usize]);
            (b - a).cross(c - a).dot(a.truncate().extend(0.0)) > 0.0
        };
        assert!(surface.triangles.iter().all(outward));
    }

    #[test]
    fn crossings_of_straight_bent_and_jumping_functions_are_found_in_few_steps() {
        let count = std::cell::Cell::new(0);
        let found = |value: &dyn Fn(f64) -> f64| {
            count.set(0);
            let ends = [value(0.0), value(1.0)];
            let at = false_position(ends, 1e-4, |x| {
                count.set(count.get() + 1);
                value(x)
            });
            (at, count.get())
        };
        assert_eq!(found(&|x| x - 0.25), (0.25, 1));
        let (at, steps) = found(&|x| x * x * x - 0.1);
        assert!((at - 0.1_f64.cbrt()).abs() < 1e-3 && steps <= 8, "{at} {steps}");
        for place in [0.0005, 0.3, 0.9995] {
            let jump = |x: f64| if x < place { -0.2 } else { f64::INFINITY };
            let (at, steps) = found(&jump);
            assert!((at - place).abs() <= 1e-4 && steps <= SECANTS + 14, "{at} {steps}");
            let (at, steps) = found(&|x| if x < place { f64::NEG_INFINITY } else { 3.0 });
            assert!((at - place).abs() <= 1e-4 && steps <= SECANTS + 14, "{at} {steps}");
        }
    }

    #[test]
    fn without_a_change_of_sign_there_is_no_surface() {
        let lattice = Lattice { origin_mm: DVec3::ZERO, step_mm: DVec3::ONE };
        let surface = |cells: &[I64Vec3], value| lattice.zero_surface(cells, Crossings::Halved, |_| value);
        assert!(surface(&[I64Vec3::ZERO], f64::INFINITY).triangles.is_empty());
        assert!(surface(&[], -1.0).triangles.is_empty());
    }
}
