//! Walls of vessels that branch: the union of round tubes, with fillets where they meet.

use crate::surface::Surface;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// A round tube: spheres about points of its middle, and all between two that follow each other.
pub(super) struct Limb {
    pub middle_mm: Vec<DVec3>,
    pub radius_mm: f64,
}

impl Limb {
    /// Distance from a point to the tube's wall, mm; negative inside.
    fn distance_mm(&self, p: DVec3) -> f64 {
        let to_piece = |pair: &[DVec3]| {
            let (along, from) = (pair[1] - pair[0], p - pair[0]);
            let t = (from.dot(along) / along.length_squared()).clamp(0.0, 1.0);
            from.distance_squared(along * t)
        };
        let nearest = self.middle_mm.windows(2).map(to_piece).fold(f64::INFINITY, f64::min);
        nearest.sqrt() - self.radius_mm
    }
}

/// Distance from a point to the wall of the union, mm; negative inside.
///
/// Where the walls of two tubes are nearer than [`FILLET_MM`] to each other they run into each other smoothly, which
/// moves the wall out by up to a quarter of that (the polynomial smooth minimum of I. Quilez).
pub(super) fn distance_mm(limbs: &[Limb], p: DVec3) -> f64 {
    limbs.iter().map(|limb| limb.distance_mm(p)).fold(f64::INFINITY, |a, b| {
        let near = (1.0 - (a - b).abs() / FILLET_MM).max(0.0);
        a.min(b) - 0.25 * FILLET_MM * near * near
    })
}

/// How far apart walls notice each other, mm.
const FILLET_MM: f64 = 2.0;

/// The wall of a union of tubes within a box, open where the box cuts it.
///
/// Marching tetrahedra: every cell of a lattice is split into six about its diagonal, alike in all cells, so that the
/// triangles of neighbours fit. A. Doi, A. Koide, *An efficient method of triangulating equi-valued surfaces by using
/// tetrahedral cells*, IEICE Transactions 74(1), 1991.
pub(super) fn wall(limbs: &[Limb], low_mm: DVec3, high_mm: DVec3, edge_mm: f64) -> Surface {
    let cells = ((high_mm - low_mm) / edge_mm).ceil().max(DVec3::ONE).as_u64vec3();
    let step = (high_mm - low_mm) / cells.as_dvec3();
    let lattice = cells + 1;
    let at = |i: u64, j: u64, k: u64| (k * lattice.y + j) * lattice.x + i;
    let place = |n: u64| {
        let (i, j, k) = (n % lattice.x, n / lattice.x % lattice.y, n / (lattice.x * lattice.y));
        low_mm + DVec3::new(i as f64, j as f64, k as f64) * step
    };
    let field: Vec<f64> = (0..lattice.element_product())
        .into_par_iter()
        .map(|n| {
            let d = distance_mm(limbs, place(n));
            // No lattice point lies on the wall itself: triangles would shrink to nothing there.
            let least = 0.02 * edge_mm;
            if d < 0.0 { d.min(-least) } else { d.max(least) }
        })
        .collect();
    let mut surface = Surface::default();
    let mut crossings: HashMap<(u64, u64), u32> = HashMap::new();
    let mut crossing = |surface: &mut Surface, a: u64, b: u64| {
        *crossings.entry((a.min(b), a.max(b))).or_insert_with_key(|&(a, b)| {
            let (fa, fb) = (field[a as usize], field[b as usize]);
            surface.nodes_mm.push(place(a).lerp(place(b), fa / (fa - fb)));
            (surface.nodes_mm.len() - 1) as u32
        })
    };
    for k in 0..cells.z {
        for j in 0..cells.y {
            for i in 0..cells.x {
                for path in DIAGONAL_PATHS {
                    // From the cell's lowest corner to its highest, one axis after the other.
                    let mut corner = [i, j, k];
                    let mut tetrahedron = [at(i, j, k); 4];
                    for (node, axis) in tetrahedron[1..].iter_mut().zip(path) {
                        corner[axis] += 1;
                        *node = at(corner[0], corner[1], corner[2]);
                    }
                    let [inside, outside] = [true, false].map(|side| {
                        let here = |n: &u64| (field[*n as usize] < 0.0) == side;
                        tetrahedron.iter().copied().filter(here).collect::<Vec<_>>()
                    });
                    let around = match (inside.as_slice(), outside.as_slice()) {
                        (&[a], &[b, c, d]) => vec![(a, b), (a, c), (a, d)],
                        (&[b, c, d], &[a]) => vec![(a, b), (a, c), (a, d)],
                        (&[a, b], &[c, d]) => vec![(a, c), (a, d), (b, d), (b, c)],
                        _ => continue,
                    };
                    let corners: Vec<u32> =
                        around.iter().map(|&(a, b)| crossing(&mut surface, a, b)).collect();
                    let mean =
                        |nodes: &[u64]| nodes.iter().map(|&n| place(n)).sum::<DVec3>() / nodes.len() as f64;
                    let outward = mean(&outside) - mean(&inside);
                    for pair in corners[1..].windows(2) {
                        let triangle = [corners[0], pair[0], pair[1]];
                        let [a, b, c] = triangle.map(|n| surface.nodes_mm[n as usize]);
                        let faces_out = (b - a).cross(c - a).dot(outward) > 0.0;
                        surface.triangles.push(if faces_out {
                            triangle
                        } else {
                            [triangle[0], triangle[2], triangle[1]]
                        });
                    }
                }
            }
        }
    }
    surface
}

/// The orders in which the three axes lead from one end of a cell's diagonal to the other.
const DIAGONAL_PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_straight_limb_is_a_cylinder_open_at_both_ends() {
        let limb = Limb { middle_mm: vec![DVec3::Z * -20.0, DVec3::Z * 60.0], radius_mm: 8.0 };
        let (low, high) = (DVec3::new(-10.0, -10.0, 0.0), DVec3::new(10.0, 10.0, 40.0));
        let surface = wall(&[limb], low, high, 1.0);
        let topology = surface.topology();
        assert!(topology.is_oriented_manifold());
        assert_eq!((topology.components, topology.boundary_loops, topology.euler_characteristic), (1, 2, 0));
        for p in &surface.nodes_mm {
            // Between two lattice points √3 mm apart the distance is off its chord by at most 3/(8 · 8), plus the 0.02 mm
            // that keep the lattice off the wall.
            assert!((p.truncate().length() - 8.0).abs() < 0.07, "{p}");
        }
    }
}
