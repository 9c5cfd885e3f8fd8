//! Where a surface crosses itself.

use super::Surface;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use robust::{Coord, Coord3D, orient2d, orient3d};

/// Cells of the grid that finds neighbours, in mean sizes of a triangle's box.
const CELL_BOXES: f64 = 2.0;
/// Most cells of the grid along one axis.
const MAX_CELLS: f64 = 1e6;

/// The pairs of triangles that meet elsewhere than at the nodes and edges that they share, ascending.
pub(crate) fn crossings(surface: &Surface) -> Vec<[u32; 2]> {
    let corners: Vec<[DVec3; 3]> = (0..surface.triangles.len()).map(|t| surface.corners_mm(t)).collect();
    let boxes: Vec<[DVec3; 2]> =
        corners.iter().map(|[a, b, c]| [a.min(*b).min(*c), a.max(*b).max(*c)]).collect();
    let Some([low, high]) = surface.bounding_box_mm() else { return Vec::new() };
    let mean = boxes.iter().map(|[p, q]| (*q - *p).max_element()).sum::<f64>() / boxes.len().max(1) as f64;
    let cell_mm = (CELL_BOXES * mean).max((high - low).max_element() / MAX_CELLS).max(f64::MIN_POSITIVE);
    let cell = |p: DVec3| ((p - low) / cell_mm).floor().as_i64vec3();
    let mut entries: Vec<([i64; 3], u32)> = Vec::with_capacity(2 * boxes.len());
    for (t, &[p, q]) in (0..).zip(&boxes) {
        let (from, to) = (cell(p), cell(q));
        for x in from.x..=to.x {
            for y in from.y..=to.y {
                entries.extend((from.z..=to.z).map(|z| ([x, y, z], t)));
            }
        }
    }
    entries.par_sort_unstable();
    let cells: Vec<&[([i64; 3], u32)]> = entries.chunk_by(|p, q| p.0 == q.0).collect();
    let of_cell = |cell: &&[([i64; 3], u32)]| {
        let pairs = cell.iter().enumerate().flat_map(|(k, p)| cell[k + 1..].iter().map(|q| [p.1, q.1]));
        let crossing = pairs.filter(|&[s, t]| {
            let ([p, q], [r, u]) = (boxes[s as usize], boxes[t as usize]);
            p.cmple(u).all() && r.cmple(q).all() && do_cross(surface, [s, t], &corners)
        });
        crossing.collect::<Vec<_>>()
    };
    let mut found: Vec<[u32; 2]> = cells.par_iter().flat_map_iter(of_cell).collect();
    found.sort_unstable();
    found.dedup();
    found
}

fn do_cross(surface: &Surface, pair: [u32; 2], corners: &[[DVec3; 3]]) -> bool {
    let [nodes, others] = pair.map(|t| surface.triangles[t as usize]);
    let [here, there] = pair.map(|t| corners[t as usize]);
    let shared: Vec<u32> = nodes.into_iter().filter(|n| others.contains(n)).collect();
    let side = |nodes: [u32; 3], corners: [DVec3; 3], k: usize| {
        ([nodes[k], nodes[(k + 1) % 3]], [corners[k], corners[(k + 1) % 3]])
    };
    match shared[..] {
        [] => {
            let meets = |nodes: [u32; 3], from: [DVec3; 3], to: [DVec3; 3]| {
                (0..3).any(|k| segment_meets(side(nodes, from, k).1, to))
            };
            meets(nodes, here, there) || meets(others, there, here)
        }
        // The side opposite to the shared node may pierce the other triangle.
        [node] => {
            let pierces = |nodes: [u32; 3], from: [DVec3; 3], to: [DVec3; 3]| {
                let k = (0..3).find(|&k| !side(nodes, from, k).0.contains(&node));
                k.is_some_and(|k| segment_meets(side(nodes, from, k).1, to))
            };
            pierces(nodes, here, there) || pierces(others, there, here)
        }
        // Neighbours meet elsewhere only if they lie on each other.
        [a, b] => {
            let tip = |nodes: [u32; 3], corners: [DVec3; 3]| {
                (0..3).find(|&k| nodes[k] != a && nodes[k] != b).map(|k| corners[k])
            };
            let at = |node| (0..3).find(|&k| nodes[k] == node).map(|k| here[k]);
            let (Some(p), Some(q), Some(c), Some(d)) = (at(a), at(b), tip(nodes, here), tip(others, there))
            else {
                return false;
            };
            let (u, v) = ((q - p).cross(c - p), (q - p).cross(d - p));
            volume(p, q, c, d) == 0.0 && u.dot(v) > 0.0
        }
        _ => true,
    }
}

/// Six times the signed volume of a tetrahedron; its sign is exact.
fn volume(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|p| Coord3D { x: p.x, y: p.y, z: p.z });
    orient3d(a, b, c, d)
}

/// Whether a segment and a triangle have a point in common.
fn segment_meets([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> bool {
    let (at_p, at_q) = (volume(a, b, c, p), volume(a, b, c, q));
    if at_p == 0.0 && at_q == 0.0 {
        return flat_segment_meets([p, q], [a, b, c]);
    }
    if (at_p > 0.0 && at_q > 0.0) || (at_p < 0.0 && at_q < 0.0) {
        return false;
    }
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0)
}

/// The same in the triangle's plane, along the axis that the plane faces most.
fn flat_segment_meets([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> bool {
    let normal = (b - a).cross(c - a).abs();
    let flat = |p: DVec3| match normal.max_element() {
        most if most == normal.x => DVec2::new(p.y, p.z),
        most if most == normal.y => DVec2::new(p.z, p.x),
        _ => DVec2::new(p.x, p.y),
    };
    let [p, q, a, b, c] = [p, q, a, b, c].map(flat);
    let turn = |a: DVec2, b: DVec2, c: DVec2| {
        let [a, b, c] = [a, b, c].map(|p| Coord { x: p.x, y: p.y });
        orient2d(a, b, c)
    };
    let within = |p: DVec2| {
        let turns = [turn(a, b, p), turn(b, c, p), turn(c, a, p)];
        turns.iter().all(|t| *t >= 0.0) || turns.iter().all(|t| *t <= 0.0)
    };
    let meets = |r: DVec2, s: DVec2| {
        let opposite = |x: f64, y: f64| (x <= 0.0 && y >= 0.0) || (x >= 0.0 && y <= 0.0);
        let on_line = turn(p, q, r) == 0.0 && turn(p, q, s) == 0.0;
        let overlaps = p.min(q).cmple(r.max(s)).all() && r.min(s).cmple(p.max(q)).all();
        opposite(turn(p, q, r), turn(p, q, s))
            && opposite(turn(r, s, p), turn(r, s, q))
            && (!on_line || overlaps)
    };
    within(p) || within(q) || meets(a, b) || meets(b, c) || meets(c, a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(nodes: &[[f64; 3]], triangles: &[[u32; 3]]) -> Option<[u32; 2]> {
        let nodes_mm = nodes.iter().map(|p| DVec3::from_array(*p)).collect();
        crossings(&Surface { nodes_mm, triangles: triangles.to_vec(), arrays: Vec::new() }).first().copied()
    }

    #[test]
    fn triangles_that_cross_are_found_and_neighbours_are_not() {
        let flat = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
        let with = |more: &[[f64; 3]]| [&flat[..], more].concat();
        let apart = [[0, 1, 2], [3, 4, 5]];
        // Pierced, touched by a corner, and free.
        assert_eq!(of(&with(&[[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [5.0, 5.0, 0.0]]), &apart), Some([0, 1]));
        assert_eq!(of(&with(&[[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]]), &apart), Some([0, 1]));
        assert_eq!(of(&with(&[[1.0, 1.0, 0.1], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]]), &apart), None);
        // In one plane: overlapping, within, and beside each other.
        assert_eq!(of(&with(&[[1.0, 1.0, 0.0], [5.0, 1.0, 0.0], [1.0, 5.0, 0.0]]), &apart), Some([0, 1]));
        assert_eq!(of(&with(&[[0.5, 0.5, 0.0], [1.0, 0.5, 0.0], [0.5, 1.0, 0.0]]), &apart), Some([0, 1]));
        assert_eq!(of(&with(&[[4.0, 4.0, 0.0], [5.0, 4.0, 0.0], [4.0, 5.0, 0.0]]), &apart), None);
        // Neighbours by a node and by an edge; folded onto each other.
        assert_eq!(of(&with(&[[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), &[[0, 1, 2], [0, 3, 4]]), None);
        assert_eq!(of(&with(&[[1.0, 1.0, -1.0], [1.0, 1.0, 1.0]]), &[[0, 1, 2], [0, 3, 4]]), Some([0, 1]));
        assert_eq!(of(&with(&[[4.0, 4.0, 0.0]]), &[[0, 1, 2], [1, 3, 2]]), None);
        assert_eq!(of(&with(&[[1.0, 1.0, 0.0]]), &[[0, 1, 2], [1, 3, 2]]), Some([0, 1]));
    }
}
