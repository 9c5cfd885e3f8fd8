//! Openings of a vessel: ends that are cut flat, prolonged and capped, and holes in its wall.

use crate::geometry::polygon::triangulate;
use crate::surface::remesh::Patches;
use crate::surface::{Groups, Surface};
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::f64::consts::PI;

/// An opening about which the wall faces the way that the opening does, by this cosine in the mean, is a hole in the wall.
const HOLE_COSINE: f64 = 0.5;
/// Radius of the wall about an opening that is asked, in radii of the opening.
const ABOUT_RADII: f64 = 1.25;
/// Powers of a matrix that find an eigenvector.
const POWERS: usize = 200;
/// Ends are cut this far within their innermost node, in edges of the mesh.
const CUT_EDGES: f64 = 0.3;

/// The largest piece of a surface, each of its nodes with one fan of triangles.
pub(super) struct Piece {
    pub surface: Surface,
    /// Which node of the given surface each node is.
    pub original: Vec<u32>,
    /// Areas of the pieces that were left out, mm², the largest first.
    pub left_out_mm2: Vec<f64>,
}

impl Piece {
    /// # Errors
    /// [`Error::Surface`] where an edge has more than two triangles, or two triangles disagree about which side is outside.
    pub(super) fn largest_of(surface: &Surface) -> Result<Self> {
        let mut sides: Vec<([u32; 2], bool, u32)> = Vec::new();
        for (t, &[a, b, c]) in (0..).zip(&surface.triangles) {
            sides.extend([[a, b], [b, c], [c, a]].map(|[a, b]| ([a.min(b), a.max(b)], a < b, t)));
        }
        sides.sort_unstable();
        let mut pieces = Groups::new(surface.triangles.len());
        for edge in sides.chunk_by(|p, q| p.0 == q.0) {
            let fault = match edge {
                [_] => continue,
                [one, other] if one.1 != other.1 => {
                    pieces.join(one.2, other.2);
                    continue;
                }
                [_, _] => "two triangles with opposite normals".to_owned(),
                more => format!("{} triangles", more.len()),
            };
            let middle =
                0.5 * (surface.nodes_mm[edge[0].0[0] as usize] + surface.nodes_mm[edge[0].0[1] as usize]);
            return Err(Error::Surface {
                what: format!("edge at {}", place(middle)),
                found: fault,
                expected: "one or two triangles, normals outward".into(),
            });
        }
        let mut area_of: HashMap<u32, f64> = HashMap::new();
        for (t, area) in (0..).zip(surface.triangle_areas_mm2()) {
            *area_of.entry(pieces.root(t)).or_default() += area;
        }
        let mut areas: Vec<(u32, f64)> = area_of.into_iter().collect();
        areas.sort_by(|p, q| q.1.total_cmp(&p.1).then(p.0.cmp(&q.0)));
        let Some(&(largest, _)) = areas.first() else {
            return Err(Error::Surface {
                what: "triangles".into(),
                found: "none".into(),
                expected: "a vessel".into(),
            });
        };
        let kept: Vec<[u32; 3]> = (0..)
            .zip(&surface.triangles)
            .filter(|(t, _)| pieces.root(*t) == largest)
            .map(|(_, corners)| *corners)
            .collect();
        let mut piece = Self {
            surface: Surface::default(),
            original: Vec::new(),
            left_out_mm2: areas[1..].iter().map(|a| a.1).collect(),
        };
        piece.separate_fans(surface, kept);
        Ok(piece)
    }

    /// Gives every fan of triangles about a node a node of its own: where two openings touch at a node, it becomes two.
    fn separate_fans(&mut self, surface: &Surface, triangles: Vec<[u32; 3]>) {
        let corner = |t: usize, k: usize| (3 * t + k) as u32;
        let mut fans = Groups::new(3 * triangles.len());
        let mut sides: HashMap<(u32, u32), (usize, usize)> = HashMap::new();
        for (t, corners) in triangles.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                if let Some((other, from)) = sides.insert((a, b), (t, k)) {
                    sides.insert((a, b), (other, from));
                }
                if let Some(&(other, from)) = sides.get(&(b, a)) {
                    fans.join(corner(t, k), corner(other, (from + 1) % 3));
                    fans.join(corner(t, (k + 1) % 3), corner(other, from));
                }
            }
        }
        let mut number = vec![u32::MAX; 3 * triangles.len()];
        for (t, corners) in triangles.into_iter().enumerate() {
            let node = |k: usize| {
                let number = &mut number[fans.root(corner(t, k)) as usize];
                if *number == u32::MAX {
                    *number = self.original.len() as u32;
                    self.original.push(corners[k]);
                }
                *number
            };
            self.surface.triangles.push([0, 1, 2].map(node));
        }
        self.surface.nodes_mm = self.original.iter().map(|&n| surface.nodes_mm[n as usize]).collect();
    }
}

/// A closed way along the border of a surface, the surface on its left seen from outside.
#[derive(Debug, Clone)]
pub(super) struct Opening {
    pub nodes: Vec<u32>,
    pub centre_mm: DVec3,
    /// Area vector, mm²: out of the vessel at an end, out of the wall at a hole.
    area: DVec3,
    /// Which way the vessel runs at an end: a unit vector out of it.
    way_out: DVec3,
    /// Whether it is a hole in the wall rather than an end of the vessel.
    pub is_hole: bool,
}

impl Opening {
    /// The openings of a surface whose nodes have one fan each, in the order of their first nodes.
    pub(super) fn all_of(surface: &Surface) -> Vec<Self> {
        let sides = || surface.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let all: HashSet<(u32, u32)> = sides().collect();
        let next: BTreeMap<u32, u32> = sides().filter(|&(a, b)| !all.contains(&(b, a))).collect();
        let mut is_seen = vec![false; surface.nodes_mm.len()];
        let mut openings = Vec::new();
        for &start in next.keys() {
            let (mut nodes, mut node) = (Vec::new(), start);
            while !std::mem::replace(&mut is_seen[node as usize], true) {
                nodes.push(node);
                let Some(&after) = next.get(&node) else { break };
                node = after;
            }
            if nodes.len() > 2 {
                openings.push(Self::of(surface, nodes));
            }
        }
        openings
    }

    fn of(surface: &Surface, nodes: Vec<u32>) -> Self {
        let points: Vec<DVec3> = nodes.iter().map(|&n| surface.nodes_mm[n as usize]).collect();
        let (centre_mm, area) = centre_and_area(&points);
        let facing = area.normalize_or(DVec3::Z);
        let within = ABOUT_RADII * (area.length() / PI).sqrt();
        let (mut squares, mut middle, mut along, mut whole) = (DMat3::ZERO, DVec3::ZERO, 0.0, 0.0);
        for t in 0..surface.triangles.len() {
            let [a, b, c] = surface.corners_mm(t);
            let centre = (a + b + c) / 3.0;
            if centre.distance(centre_mm) > within {
                continue;
            }
            let normal = (b - a).cross(c - a);
            let (unit, area) = (normal.normalize_or_zero(), normal.length());
            squares += DMat3::from_cols(unit * unit.x, unit * unit.y, unit * unit.z) * area;
            middle += centre * area;
            along += normal.dot(facing).abs();
            whole += area;
        }
        // The vessel runs across the wall's normals: along the eigenvector of the least eigenvalue, by powers.
        let shifted = DMat3::from_diagonal(DVec3::splat(whole)) - squares;
        let mut way_out = facing;
        for _ in 0..POWERS {
            way_out = (shifted * way_out).normalize_or(way_out);
        }
        if way_out.dot(centre_mm - middle / whole) < 0.0 {
            way_out = -way_out;
        }
        Self { nodes, centre_mm, area, way_out, is_hole: along > HOLE_COSINE * whole }
    }

    /// Radius of the circle of the same area, mm.
    pub(super) fn radius_mm(&self) -> f64 {
        (self.area.length() / PI).sqrt()
    }
}

/// Centre of a closed way, by the lengths of its sides, and its area vector; both mm.
fn centre_and_area(points: &[DVec3]) -> (DVec3, DVec3) {
    let sides = || points.iter().zip(points.iter().cycle().skip(1));
    let length: f64 = sides().map(|(p, q)| p.distance(*q)).sum();
    let centre = sides().map(|(p, q)| 0.5 * (*p + *q) * p.distance(*q)).sum::<DVec3>() / length;
    // The border runs with the surface on its left, so that its area vector points into the vessel at an end.
    let area = -0.5 * sides().map(|(p, q)| (*p - centre).cross(*q - centre)).sum::<DVec3>();
    (centre, area)
}

/// A place, for messages.
pub(super) fn place(p: DVec3) -> String {
    format!("({:.2}, {:.2}, {:.2}) mm", p.x, p.y, p.z)
}

/// A flat end of a vessel.
#[derive(Debug, Clone)]
pub(super) struct FlatEnd {
    /// Its border, the vessel on its left seen from outside.
    pub nodes: Vec<u32>,
    /// Unit vector out of the vessel.
    pub normal: DVec3,
    /// Length that was cut off the vessel to make it flat, mm.
    pub cut_mm: f64,
}

/// The part of a vessel beyond a plane across an end, just within the innermost node of its border.
pub(super) struct Stub {
    normal: DVec3,
    /// Height of the plane along the normal, mm.
    cut: f64,
    /// Whether each node belongs to it.
    pub is_beyond: Vec<bool>,
    /// Of each triangle: whether one of its nodes does.
    is_touched: Vec<bool>,
    /// Its length, mm.
    length_mm: f64,
}

impl Stub {
    pub(super) fn of(nodes_mm: &[DVec3], triangles: &[[u32; 3]], end: &Opening) -> Self {
        let normal = end.way_out;
        let height = |n: u32| nodes_mm[n as usize].dot(normal);
        let innermost = end.nodes.iter().map(|&n| height(n)).fold(f64::INFINITY, f64::min);
        let outermost = end.nodes.iter().map(|&n| height(n)).fold(f64::NEG_INFINITY, f64::max);
        let sides = end.nodes.iter().zip(end.nodes.iter().cycle().skip(1));
        let length = |(&p, &q): (&u32, &u32)| nodes_mm[p as usize].distance(nodes_mm[q as usize]);
        let edge = sides.map(length).sum::<f64>() / end.nodes.len() as f64;
        // Not through a node: the pieces of its triangles would have no area.
        let mut cut = innermost - CUT_EDGES * edge;
        while nodes_mm.iter().any(|p| (p.dot(normal) - cut).abs() < 1e-6 * edge) {
            cut -= 0.0137 * edge;
        }
        let mut at_node: Vec<Vec<u32>> = vec![Vec::new(); nodes_mm.len()];
        for (t, corners) in (0..).zip(triangles) {
            corners.iter().for_each(|&n| at_node[n as usize].push(t));
        }
        let mut is_beyond = vec![false; nodes_mm.len()];
        let mut is_touched = vec![false; triangles.len()];
        let mut waiting: Vec<u32> = end.nodes.clone();
        while let Some(node) = waiting.pop() {
            if std::mem::replace(&mut is_beyond[node as usize], true) {
                continue;
            }
            for &t in &at_node[node as usize] {
                is_touched[t as usize] = true;
                let corners = triangles[t as usize];
                waiting.extend(corners.iter().filter(|&&n| !is_beyond[n as usize] && height(n) > cut));
            }
        }
        Self { normal, cut, is_beyond, is_touched, length_mm: outermost - cut }
    }

    /// Whether a whole opening lies in it.
    pub(super) fn holds(&self, opening: &Opening) -> bool {
        opening.nodes.iter().all(|&n| self.is_beyond[n as usize])
    }
}

/// Cuts a vessel flat at an end. Its stub is dropped.
pub(super) fn cut_flat(patches: &mut Patches, end: &Opening) -> Result<FlatEnd> {
    let Stub { normal, cut, is_beyond, is_touched, length_mm } =
        Stub::of(&patches.nodes_mm, &patches.triangles, end);
    let mut on_plane: HashMap<(u32, u32), u32> = HashMap::new();
    let (triangles, patch) = (std::mem::take(&mut patches.triangles), std::mem::take(&mut patches.patch));
    let mut border: BTreeMap<u32, u32> = BTreeMap::new();
    for (t, (corners, patch)) in triangles.into_iter().zip(patch).enumerate() {
        if !is_touched[t] {
            patches.triangles.push(corners);
            patches.patch.push(patch);
            continue;
        }
        let beyond = corners.map(|n| is_beyond[n as usize]);
        let mut crossing = |kept: u32, gone: u32| {
            *on_plane.entry((kept, gone)).or_insert_with(|| {
                let [p, q] = [kept, gone].map(|n| patches.nodes_mm[n as usize]);
                let share = (cut - p.dot(normal)) / (q.dot(normal) - p.dot(normal));
                patches.nodes_mm.push(p + (q - p) * share);
                patches.nodes_mm.len() as u32 - 1
            })
        };
        match beyond.iter().filter(|b| **b).count() {
            1 => {
                let k = beyond.iter().position(|b| *b).unwrap_or(0);
                let [gone, b, c] = [corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]];
                let (ab, ac) = (crossing(b, gone), crossing(c, gone));
                patches.triangles.extend([[ab, b, c], [ab, c, ac]]);
                patches.patch.extend([patch; 2]);
                border.insert(ac, ab);
            }
            2 => {
                let k = beyond.iter().position(|b| !*b).unwrap_or(0);
                let [kept, b, c] = [corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]];
                let (ab, ac) = (crossing(kept, b), crossing(kept, c));
                patches.triangles.push([kept, ab, ac]);
                patches.patch.push(patch);
                border.insert(ab, ac);
            }
            _ => {}
        }
    }
    let start = border.keys().next().copied();
    let mut nodes: Vec<u32> = start.into_iter().collect();
    while let Some(&next) = nodes.last().and_then(|last| border.get(last)) {
        if Some(next) == start || nodes.len() > border.len() {
            break;
        }
        nodes.push(next);
    }
    if nodes.len() < 3 || nodes.len() != border.len() {
        return Err(Error::Surface {
            what: format!("cross-section at the end at {}", place(end.centre_mm)),
            found: match border.is_empty() {
                true => "none",
                false => "an outline that is open or in several parts",
            }
            .into(),
            expected: "one closed outline; reconstruct with --keep-unsupported, or cut the end off".into(),
        });
    }
    Ok(FlatEnd { nodes, normal, cut_mm: length_mm })
}

/// Prolongs a vessel at a flat end by rings of nodes, and returns the new end. The outline becomes a circle of the same area
/// over the first half, where every ray from its centre meets it once.
pub(super) fn prolong(
    patches: &mut Patches,
    end: &FlatEnd,
    length_mm: f64,
    edge_mm: f64,
    patch: u32,
) -> FlatEnd {
    let outline: Vec<DVec3> = end.nodes.iter().map(|&n| patches.nodes_mm[n as usize]).collect();
    let (centre, area) = centre_and_area(&outline);
    let offsets: Vec<DVec3> = outline.iter().map(|p| *p - centre).collect();
    let circle = (area.length() / PI).sqrt();
    let turn = |k: usize| offsets[(k + 1) % offsets.len()].cross(offsets[k]).dot(end.normal);
    let is_star_shaped = (0..offsets.len()).all(|k| turn(k) > 0.0);
    let steps = (length_mm / edge_mm).ceil().max(2.0) as usize;
    let mut last = end.nodes.clone();
    for step in 1..=steps {
        let share = step as f64 / steps as f64;
        let s = (2.0 * share).min(1.0);
        let round = if is_star_shaped { s * s * (3.0 - 2.0 * s) } else { 0.0 };
        let first = patches.nodes_mm.len() as u32;
        for offset in &offsets {
            let on_circle = offset.normalize_or_zero() * circle;
            let p = centre + offset.lerp(on_circle, round) + end.normal * (share * length_mm);
            patches.nodes_mm.push(p);
        }
        let count = offsets.len() as u32;
        let ring: Vec<u32> = (first..first + count).collect();
        for k in 0..ring.len() {
            let j = (k + 1) % ring.len();
            // The border runs with the vessel on its left: new triangles run along it the other way.
            patches.triangles.extend([[last[j], last[k], ring[k]], [last[j], ring[k], ring[j]]]);
            patches.patch.extend([patch; 2]);
        }
        last = ring;
    }
    FlatEnd { nodes: last, ..end.clone() }
}

/// Closes a flat end.
pub(super) fn cap(patches: &mut Patches, end: &FlatEnd, patch: u32) -> Result<()> {
    let corners: Vec<DVec3> = end.nodes.iter().rev().map(|&n| patches.nodes_mm[n as usize]).collect();
    let triangles = triangulate(&corners).ok_or_else(|| Error::Surface {
        what: format!("outline of the end at {}", place(corners[0])),
        found: "edges that cross".into(),
        expected: "a simple outline".into(),
    })?;
    let last = end.nodes.len() - 1;
    patches.triangles.extend(triangles.into_iter().map(|t| t.map(|k| end.nodes[last - k])));
    patches.patch.resize(patches.triangles.len(), patch);
    Ok(())
}

/// Height of the dome that a cap becomes, in radii: a micrometre on an aorta.
const DOME_RADII: f64 = 1e-4;

/// Makes a cap a very flat dome outward. Where many triangles lie in one plane but for rounding, programs that look for
/// crossing triangles in floating point find some where there are none.
pub(super) fn dome(patches: &mut Patches, patch: u32) {
    let of_cap = |(_, p): &(&[u32; 3], &u32)| **p == patch;
    let (mut is_on_rim, mut area) = (vec![false; patches.nodes_mm.len()], DVec3::ZERO);
    for (&[a, b, c], p) in patches.triangles.iter().zip(&patches.patch) {
        if *p == patch {
            let [a, b, c] = [a, b, c].map(|n| patches.nodes_mm[n as usize]);
            area += 0.5 * (b - a).cross(c - a);
        } else {
            [a, b, c].iter().for_each(|&n| is_on_rim[n as usize] = true);
        }
    }
    let corners = patches.triangles.iter().zip(&patches.patch).filter(of_cap).flat_map(|(t, _)| *t);
    let mut inside: Vec<u32> = corners.filter(|&n| !is_on_rim[n as usize]).collect();
    inside.sort_unstable();
    inside.dedup();
    let centre = inside.iter().map(|&n| patches.nodes_mm[n as usize]).sum::<DVec3>() / inside.len() as f64;
    let radius = (area.length() / PI).sqrt();
    for n in inside {
        let p = &mut patches.nodes_mm[n as usize];
        let share = p.distance_squared(centre) / (radius * radius);
        *p += area.normalize_or_zero() * (DOME_RADII * radius / (1.0 + share));
    }
}

/// Largest border that is filled: the time grows with the cube of its nodes.
const MAX_FILLED: usize = 1500;

/// Closes a hole by the triangles of least area between its nodes (G. Barequet and M. Sharir, *Filling gaps in the boundary
/// of a polyhedron*, 1995).
pub(super) fn fill(patches: &mut Patches, hole: &Opening, patch: u32) -> Result<()> {
    let border: Vec<u32> = hole.nodes.iter().rev().copied().collect();
    let count = border.len();
    if count > MAX_FILLED {
        return Err(Error::Surface {
            what: format!("hole at {}", place(hole.centre_mm)),
            found: format!("a border of {count} nodes"),
            expected: format!("at most {MAX_FILLED}; reconstruct with --keep-unsupported instead"),
        });
    }
    let at = |k: usize| patches.nodes_mm[border[k] as usize];
    let area = |i: usize, j: usize, k: usize| (at(j) - at(i)).cross(at(k) - at(i)).length();
    // Of the part of the border from i to k: the least area, and the corner of the triangle on its chord.
    let mut least = vec![(0.0, 0); count * count];
    for span in 2..count {
        for i in 0..count - span {
            let k = i + span;
            let total = |j: usize| least[i * count + j].0 + least[j * count + k].0 + area(i, j, k);
            let best =
                (i + 1..k).map(|j| (total(j), j)).min_by(|p, q| p.0.total_cmp(&q.0).then(p.1.cmp(&q.1)));
            least[i * count + k] = best.unwrap_or((0.0, i + 1));
        }
    }
    let mut parts = vec![(0, count - 1)];
    while let Some((i, k)) = parts.pop() {
        if k - i < 2 {
            continue;
        }
        let j = least[i * count + k].1;
        patches.triangles.push([border[i], border[j], border[k]]);
        parts.extend([(i, j), (j, k)]);
    }
    patches.patch.resize(patches.triangles.len(), patch);
    Ok(())
}
