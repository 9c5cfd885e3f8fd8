//! Walls of vessels that branch: the union of round tubes, with fillets where they meet.

use crate::surface::Surface;
use crate::surface::marching::{Crossings, Lattice};
use crate::{Error, Result};
use glam::{DVec3, I64Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// A round tube: spheres about points of its middle, and all between two that follow each other.
pub(super) struct Limb {
    pub middle_mm: Vec<DVec3>,
    pub radius_mm: f64,
    /// A ball that holds the middle.
    ball_centre_mm: DVec3,
    ball_radius_mm: f64,
}

impl Limb {
    pub fn new(middle_mm: Vec<DVec3>, radius_mm: f64) -> Self {
        let ball_centre_mm = middle_mm.iter().sum::<DVec3>() / middle_mm.len().max(1) as f64;
        let ball_radius_mm = middle_mm.iter().map(|p| p.distance(ball_centre_mm)).fold(0.0, f64::max);
        Self { middle_mm, radius_mm, ball_centre_mm, ball_radius_mm }
    }

    /// Distance from a point to the tube's wall, mm; negative inside. Farther than [`FAR_MM`] from it, less is
    /// returned.
    fn distance_mm(&self, p: DVec3) -> f64 {
        let at_least_mm = p.distance(self.ball_centre_mm) - self.ball_radius_mm - self.radius_mm;
        if at_least_mm > FAR_MM {
            return at_least_mm;
        }
        let to_piece = |pair: &[DVec3]| {
            let (along, from) = (pair[1] - pair[0], p - pair[0]);
            let t = (from.dot(along) / along.length_squared()).clamp(0.0, 1.0);
            from.distance_squared(along * t)
        };
        let nearest = self.middle_mm.windows(2).map(to_piece).fold(f64::INFINITY, f64::min);
        nearest.sqrt() - self.radius_mm
    }
}

/// A tube farther away than this, mm, has no part in the wall: more than the longest edge, and a fillet.
const FAR_MM: f64 = 25.0;

/// Distance from a point to the wall of the union, mm; negative inside.
///
/// Where the walls of two tubes are nearer than [`FILLET_MM`] to each other they run into each other smoothly,
/// which moves the wall out by up to a quarter of that (the polynomial smooth minimum of I. Quilez).
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
/// # Errors
/// [`Error::Setting`] for edges so short that the wall does not fit in memory.
pub(super) fn wall(limbs: &[Limb], low_mm: DVec3, high_mm: DVec3, edge_mm: f64) -> Result<Surface> {
    not_too_fine(edge_mm, ((high_mm - low_mm) / edge_mm).element_product())?;
    let count = ((high_mm - low_mm) / edge_mm).ceil().max(DVec3::ONE).as_i64vec3();
    let lattice = Lattice { origin_mm: low_mm, step_mm: (high_mm - low_mm) / count.as_dvec3() };
    let half_diagonal_mm = 0.51 * lattice.step_mm.length();
    let cells: Vec<I64Vec3> = (0..count.element_product())
        .into_par_iter()
        .map(|n| I64Vec3::new(n % count.x, n / count.x % count.y, n / (count.x * count.y)))
        .filter(|cell| {
            let middle = low_mm + (cell.as_dvec3() + 0.5) * lattice.step_mm;
            distance_mm(limbs, middle).abs() < half_diagonal_mm
        })
        .collect();
    Ok(lattice.zero_surface(&cells, Crossings::Halved, |p| distance_mm(limbs, p)))
}

/// Refuses edges so short that the wall does not fit in memory.
pub(super) fn not_too_fine(edge_mm: f64, pieces: f64) -> Result<()> {
    const MAX_PIECES: f64 = 3e7;
    if pieces <= MAX_PIECES {
        return Ok(());
    }
    Err(Error::Setting {
        name: "vessel.edge_mm".into(),
        found: format!("{edge_mm}, which makes {pieces:.0} pieces"),
        expected: format!("longer edges, at most {MAX_PIECES:.0} pieces"),
    })
}

/// Where a tube ends: what lies beyond, within `reach_mm` of it, is no part of the vessel.
pub(super) struct End {
    pub middle_mm: DVec3,
    pub onward: DVec3,
    pub reach_mm: f64,
}

/// Opens the wall at an end, where the tube is straight.
pub(super) fn open(surface: &mut Surface, end: &End, edge_mm: f64) {
    // How far beyond the end a node lies. Nodes beside it are moved into it, so that no triangle shrinks to
    // nothing: a straight tube has its wall there too.
    let mut beyond_mm: Vec<f64> = Vec::with_capacity(surface.nodes_mm.len());
    for p in &mut surface.nodes_mm {
        let way = *p - end.middle_mm;
        let along = way.dot(end.onward);
        beyond_mm.push(if way.length() > end.reach_mm {
            f64::NEG_INFINITY
        } else if along.abs() < 0.05 * edge_mm {
            *p -= end.onward * along;
            0.0
        } else {
            along
        });
    }
    let mut crossings: HashMap<(u32, u32), u32> = HashMap::new();
    let mut kept = Vec::with_capacity(surface.triangles.len());
    for triangle in std::mem::take(&mut surface.triangles) {
        let beyond = triangle.map(|n| beyond_mm[n as usize]);
        if beyond.iter().all(|&b| b <= 0.0) {
            kept.push(triangle);
            continue;
        }
        let mut corners: Vec<u32> = Vec::with_capacity(4);
        for i in 0..3 {
            let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
            let (from, to) = (beyond[i], beyond[(i + 1) % 3]);
            if from <= 0.0 {
                corners.push(a);
            }
            if (from < 0.0 && to > 0.0) || (from > 0.0 && to < 0.0) {
                corners.push(*crossings.entry((a.min(b), a.max(b))).or_insert_with_key(|&(a, b)| {
                    let [(p, from), (q, to)] =
                        [a, b].map(|n| (surface.nodes_mm[n as usize], beyond_mm[n as usize]));
                    surface.nodes_mm.push(p.lerp(q, from / (from - to)));
                    (surface.nodes_mm.len() - 1) as u32
                }));
            }
        }
        if beyond.iter().any(|&b| b < 0.0) {
            kept.extend((2..corners.len()).map(|i| [corners[0], corners[i - 1], corners[i]]));
        }
    }
    surface.triangles = kept;
    *surface = std::mem::take(surface).without_loose_nodes();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_straight_limb_is_a_cylinder_open_at_both_ends() {
        let limb = Limb::new(vec![DVec3::Z * -20.0, DVec3::Z * 60.0], 8.0);
        let (low, high) = (DVec3::new(-10.0, -10.0, 0.0), DVec3::new(10.0, 10.0, 40.0));
        let surface = wall(&[limb], low, high, 1.0).unwrap();
        let topology = surface.topology();
        assert!(topology.is_oriented_manifold());
        assert_eq!((topology.components, topology.boundary_loops, topology.euler_characteristic), (1, 2, 0));
        for p in &surface.nodes_mm {
            // Between two lattice points √3 mm apart the distance is off its chord by at most 3/(8 · 8), plus
            // the 0.02 mm that keep the lattice off the wall.
            assert!((p.truncate().length() - 8.0).abs() < 0.07, "{p}");
        }
    }
}
