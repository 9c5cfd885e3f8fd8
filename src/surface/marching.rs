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
/// Halvings of an edge to find where it crosses the surface.
const HALVINGS: usize = 14;

impl Lattice {
    fn corner_mm(&self, corner: I64Vec3) -> DVec3 {
        self.origin_mm + corner.as_dvec3() * self.step_mm
    }

    /// The cell that a point lies in.
    pub(crate) fn cell(&self, point_mm: DVec3) -> I64Vec3 {
        ((point_mm - self.origin_mm) / self.step_mm).floor().as_i64vec3()
    }

    /// The surface where `field` is zero, within some cells, given each once; normals point to where it is positive.
    /// Positions along the lattice's edges are found by bisection, so `field` needs no slope: it may be infinite.
    pub(crate) fn zero_surface(&self, cells: &[I64Vec3], field: impl Fn(DVec3) -> f64 + Sync) -> Surface {
        let corners_of = |cell: I64Vec3| (0..8).map(move |k| cell + I64Vec3::new(k & 1, k >> 1 & 1, k >> 2));
        let key = |c: &I64Vec3| c.to_array();
        let mut corners: Vec<I64Vec3> = cells.iter().copied().flat_map(corners_of).collect();
        corners.par_sort_unstable_by_key(key);
        corners.dedup();
        let least = LEAST * self.step_mm.min_element();
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
                let (mut low, mut high) = (0.0, 1.0);
                let [from, to] = [inside, outside].map(place);
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (low + high);
                    *(if field(from.lerp(to, middle)) < 0.0 { &mut low } else { &mut high }) = middle;
                }
                from.lerp(to, (0.5 * (low + high)).clamp(LEAST, 1.0 - LEAST))
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
        let surface = lattice.zero_surface(&cells, |p| p.truncate().length() - 8.0);
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
    fn without_a_change_of_sign_there_is_no_surface() {
        let lattice = Lattice { origin_mm: DVec3::ZERO, step_mm: DVec3::ONE };
        assert!(lattice.zero_surface(&[I64Vec3::ZERO], |_| f64::INFINITY).triangles.is_empty());
        assert!(lattice.zero_surface(&[], |_| -1.0).triangles.is_empty());
    }
}
