//! Triangles of even size and shape, by local changes: long edges are split, short ones collapsed, edges flipped to Delaunay's
//! criterion, and nodes moved to the middle of their neighbours, back onto the surface that was given
//! (M. Botsch and L. Kobbelt, *A remeshing approach to multiresolution modeling*, 2004).
//!
//! Patches keep their borders: nodes on a seam, the edges between two patches or at an opening, stay on it.

use super::Locator;
use crate::Result;
use crate::surface::Surface;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Rounds at the end that only better the triangles' shapes.
const LAST_ROUNDS: usize = 4;
/// Edges are split above, and collapsed below, these shares of the length that they should have.
const LONGEST: f64 = 4.0 / 3.0;
const SHORTEST: f64 = 4.0 / 5.0;
/// Sweeps of splitting until no edge is too long, and of flipping until no edge needs it.
const MAX_SWEEPS: usize = 40;
/// Least cosine between a triangle's normals before and after a change, and between two neighbours' after a flip.
const LEAST_COSINE: f64 = 0.5;
/// Triangles with a smaller angle than this are needles, and are collapsed at the end where their neighbours allow it.
const NEEDLE_DEG: f64 = 15.0;

/// Triangles in patches. Neighbouring triangles of different patches meet at a seam.
#[derive(Debug, Clone, Default)]
pub(crate) struct Patches {
    pub nodes_mm: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    /// Of each triangle.
    pub patch: Vec<u32>,
    /// Nodes that stay where they are, as do the edges between two of them; none of the others need be named.
    pub fixed: Vec<u32>,
}

impl Patches {
    /// The triangles of one patch, with the nodes of all.
    pub(crate) fn surface_of(&self, patch: u32) -> Surface {
        let of_patch = self.triangles.iter().zip(&self.patch).filter(|(_, p)| **p == patch);
        Surface {
            nodes_mm: self.nodes_mm.clone(),
            triangles: of_patch.map(|(t, _)| *t).collect(),
            arrays: Vec::new(),
        }
    }

    /// The nodes that one patch uses.
    pub(crate) fn nodes_of(&self, patch: u32) -> Vec<DVec3> {
        let mut nodes: Vec<u32> = self.surface_of(patch).triangles.into_flattened();
        nodes.sort_unstable();
        nodes.dedup();
        nodes.into_iter().map(|n| self.nodes_mm[n as usize]).collect()
    }

    /// All triangles.
    pub(crate) fn surface(&self) -> Surface {
        Surface { nodes_mm: self.nodes_mm.clone(), triangles: self.triangles.clone(), arrays: Vec::new() }
    }

    pub(crate) fn count(&self) -> u32 {
        self.patch.iter().max().map_or(0, |last| last + 1)
    }
}

/// The same surface in triangles whose edges have the length that `edge_mm` gives at a place, after some rounds of all
/// changes: ten make triangles even, fewer leave more of their shapes as they are.
pub(crate) fn remeshed(
    patches: &Patches,
    edge_mm: &(dyn Fn(DVec3) -> f64 + Sync),
    rounds: usize,
) -> Result<Patches> {
    let target = Target::of(patches)?;
    let mut mesh = Mesh::of(patches);
    for _ in 0..rounds {
        mesh.edge_mm = mesh.nodes_mm.par_iter().map(|p| edge_mm(*p)).collect();
        mesh.split_long_edges();
        mesh.collapse_short_edges();
        mesh.flip_edges();
        mesh.move_nodes(&target);
    }
    for _ in 0..LAST_ROUNDS {
        mesh.collapse_needles();
        mesh.flip_edges();
        mesh.move_nodes(&target);
    }
    mesh.flip_edges();
    Ok(mesh.into_patches())
}

/// The surface that was given, to put nodes back onto it.
struct Target {
    of_patch: Vec<Locator>,
    seams: BTreeMap<[u32; 2], Vec<[DVec3; 2]>>,
}

impl Target {
    fn of(patches: &Patches) -> Result<Self> {
        let mesh = Mesh::of(patches);
        let mut seams: BTreeMap<[u32; 2], Vec<[DVec3; 2]>> = BTreeMap::new();
        for [a, b] in mesh.edges() {
            if let Some(pair) = mesh.seam(a, b) {
                seams.entry(pair).or_default().push([a, b].map(|n| mesh.nodes_mm[n as usize]));
            }
        }
        let of_patch = (0..patches.count()).map(|patch| Locator::new(&patches.surface_of(patch)));
        Ok(Self { of_patch: of_patch.collect::<Result<_>>()?, seams })
    }

    fn on_seam(&self, pair: [u32; 2], p: DVec3) -> DVec3 {
        let closest = |&[a, b]: &[DVec3; 2]| {
            let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            if along.is_nan() { a } else { a + (b - a) * along }
        };
        let points = self.seams.get(&pair).into_iter().flatten().map(closest);
        points.min_by(|q, r| q.distance_squared(p).total_cmp(&r.distance_squared(p))).unwrap_or(p)
    }
}

/// Where a node lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Inside,
    /// On a seam: it stays on it.
    Seam,
    /// Where seams meet: it stays where it is.
    Corner,
    /// It stays where it is, and so do edges to others of the kind.
    Fixed,
}

/// Marks a triangle that is no more.
const GONE: [u32; 3] = [u32::MAX; 3];
/// The patch beyond an opening.
const NOTHING: u32 = u32::MAX;

struct Mesh {
    nodes_mm: Vec<DVec3>,
    place: Vec<Place>,
    /// Length that the edges at each node should have, mm.
    edge_mm: Vec<f64>,
    triangles: Vec<[u32; 3]>,
    patch: Vec<u32>,
    /// Triangles at each node, in no order.
    about: Vec<Vec<u32>>,
}

impl Mesh {
    fn of(patches: &Patches) -> Self {
        let Patches { nodes_mm, triangles, patch, fixed } = patches.clone();
        let mut about = vec![Vec::new(); nodes_mm.len()];
        for (t, corners) in (0..).zip(&triangles) {
            corners.iter().for_each(|&n| about[n as usize].push(t));
        }
        let (place, edge_mm) = (vec![Place::Inside; nodes_mm.len()], vec![0.0; nodes_mm.len()]);
        let mut mesh = Self { nodes_mm, place, edge_mm, triangles, patch, about };
        let mut seams = vec![0; mesh.nodes_mm.len()];
        for [a, b] in mesh.edges() {
            if mesh.seam(a, b).is_some() {
                [a, b].iter().for_each(|&n| seams[n as usize] += 1);
            }
        }
        let place = |count| match count {
            0 => Place::Inside,
            2 => Place::Seam,
            _ => Place::Corner,
        };
        mesh.place = seams.into_iter().map(place).collect();
        fixed.into_iter().for_each(|n| mesh.place[n as usize] = Place::Fixed);
        mesh
    }

    fn into_patches(self) -> Patches {
        let mut number = vec![u32::MAX; self.nodes_mm.len()];
        let mut patches = Patches::default();
        for (corners, patch) in self.triangles.into_iter().zip(self.patch).filter(|(t, _)| *t != GONE) {
            let corners = corners.map(|n| {
                let number = &mut number[n as usize];
                if *number == u32::MAX {
                    *number = patches.nodes_mm.len() as u32;
                    patches.nodes_mm.push(self.nodes_mm[n as usize]);
                }
                *number
            });
            patches.triangles.push(corners);
            patches.patch.push(patch);
        }
        patches
    }

    /// All edges, each once, its nodes in ascending order.
    fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges = Vec::with_capacity(3 * self.about.len());
        let mut others = Vec::new();
        for node in 0..self.about.len() as u32 {
            others.clear();
            self.add_neighbours(node, &mut others);
            edges.extend(others.iter().filter(|other| **other > node).map(|other| [node, *other]));
        }
        edges
    }

    fn at(&self, node: u32) -> DVec3 {
        self.nodes_mm[node as usize]
    }

    fn length(&self, [a, b]: [u32; 2]) -> f64 {
        self.at(a).distance(self.at(b))
    }

    /// The length that an edge should have, mm.
    fn wanted(&self, [a, b]: [u32; 2]) -> f64 {
        0.5 * (self.edge_mm[a as usize] + self.edge_mm[b as usize])
    }

    /// The triangles at an edge.
    fn beside(&self, a: u32, b: u32) -> impl Iterator<Item = u32> + '_ {
        let has_b = move |t: &u32| self.triangles[*t as usize].contains(&b);
        self.about[a as usize].iter().copied().filter(has_b)
    }

    /// The corner of a triangle that is neither of the two.
    fn opposite(&self, t: u32, a: u32, b: u32) -> u32 {
        let other = self.triangles[t as usize].into_iter().find(|&n| n != a && n != b);
        other.unwrap_or(a)
    }

    /// The neighbours of a node, in ascending order.
    fn neighbours(&self, node: u32) -> Vec<u32> {
        let mut neighbours = Vec::new();
        self.add_neighbours(node, &mut neighbours);
        neighbours
    }

    /// Fills an empty list with them.
    fn add_neighbours(&self, node: u32, neighbours: &mut Vec<u32>) {
        for &t in &self.about[node as usize] {
            neighbours.extend(self.triangles[t as usize].iter().filter(|n| **n != node));
        }
        neighbours.sort_unstable();
        neighbours.dedup();
    }

    /// The patches that meet at an edge, in ascending order, where they are two.
    fn seam(&self, a: u32, b: u32) -> Option<[u32; 2]> {
        let mut patches = [NOTHING; 2];
        self.beside(a, b).zip(&mut patches).for_each(|(t, patch)| *patch = self.patch[t as usize]);
        patches.sort_unstable();
        (patches[0] != patches[1]).then_some(patches)
    }

    /// A triangle's normal, as long as twice its area, with one node elsewhere.
    fn normal(&self, corners: [u32; 3], node: u32, elsewhere: DVec3) -> DVec3 {
        let [a, b, c] = corners.map(|n| if n == node { elsewhere } else { self.at(n) });
        (b - a).cross(c - a)
    }

    fn normal_of(&self, corners: [u32; 3]) -> DVec3 {
        self.normal(corners, u32::MAX, DVec3::ZERO)
    }

    /// Whether the triangles at a node, but for some, keep their direction and an area when the node is moved.
    fn can_move(&self, node: u32, to_mm: DVec3, but: &[u32]) -> bool {
        self.about[node as usize].iter().filter(|t| !but.contains(t)).all(|&t| {
            let corners = self.triangles[t as usize];
            let (before, after) = (self.normal_of(corners), self.normal(corners, node, to_mm));
            let least = LEAST_COSINE * before.length() * after.length();
            // Triangles without an area have no direction to keep.
            after.length_squared() > 0.0 && (before.dot(after) >= least || is_flat(before, corners, self))
        })
    }

    fn split_long_edges(&mut self) {
        for _ in 0..MAX_SWEEPS {
            let is_fixed = |edge: &[u32; 2]| edge.iter().all(|&n| self.place[n as usize] == Place::Fixed);
            let is_long =
                |edge: &[u32; 2]| self.length(*edge) > LONGEST * self.wanted(*edge) && !is_fixed(edge);
            let mut long: Vec<[u32; 2]> = self.edges().into_iter().filter(is_long).collect();
            // The longest first: halving the longest side of a triangle does not narrow it.
            long.sort_by(|p, q| self.length(*q).total_cmp(&self.length(*p)).then(p.cmp(q)));
            if long.is_empty() {
                break;
            }
            for [a, b] in long {
                self.split(a, b);
            }
            self.flip_edges();
        }
    }

    fn split(&mut self, a: u32, b: u32) {
        let middle = self.nodes_mm.len() as u32;
        let beside: Vec<u32> = self.beside(a, b).collect();
        self.place.push(if self.seam(a, b).is_some() { Place::Seam } else { Place::Inside });
        self.nodes_mm.push(0.5 * (self.at(a) + self.at(b)));
        self.edge_mm.push(self.wanted([a, b]));
        self.about.push(Vec::new());
        for t in beside {
            let corners = self.triangles[t as usize];
            let new = self.triangles.len() as u32;
            let with = |from: u32| corners.map(|n| if n == from { middle } else { n });
            let (kept, added) = (with(b), with(a));
            self.triangles[t as usize] = kept;
            self.triangles.push(added);
            self.patch.push(self.patch[t as usize]);
            let opposite = self.opposite(t, a, middle);
            self.about[b as usize].retain(|&other| other != t);
            self.about[b as usize].push(new);
            self.about[opposite as usize].push(new);
            self.about[middle as usize].extend([t, new]);
        }
    }

    fn collapse_short_edges(&mut self) {
        let is_short = |edge: &[u32; 2]| self.length(*edge) < SHORTEST * self.wanted(*edge);
        let mut short: Vec<[u32; 2]> = self.edges().into_iter().filter(is_short).collect();
        short.sort_by(|p, q| self.length(*p).total_cmp(&self.length(*q)).then(p.cmp(q)));
        for edge in short {
            let is_alive = self.beside(edge[0], edge[1]).next().is_some();
            if is_alive && self.length(edge) < SHORTEST * self.wanted(edge) {
                self.collapse(edge, LONGEST);
            }
        }
    }

    /// Makes one node of an edge's two, where that changes no topology, folds nothing, and makes no edge longer than
    /// `longest` times the wanted length.
    fn collapse(&mut self, edge: [u32; 2], longest: f64) -> bool {
        let [mut gone, mut kept] = edge;
        if self.place[gone as usize] > self.place[kept as usize] {
            std::mem::swap(&mut gone, &mut kept);
        }
        let on_seam = self.seam(gone, kept).is_some();
        let to_mm = match (self.place[gone as usize], self.place[kept as usize]) {
            (Place::Corner | Place::Fixed, _) => return false,
            (Place::Inside, Place::Inside) => 0.5 * (self.at(gone) + self.at(kept)),
            (Place::Inside, _) => self.at(kept),
            (Place::Seam, Place::Seam) if on_seam => 0.5 * (self.at(gone) + self.at(kept)),
            (Place::Seam, Place::Corner | Place::Fixed) if on_seam => self.at(kept),
            _ => return false,
        };
        let beside: Vec<u32> = self.beside(gone, kept).collect();
        let mut opposite: Vec<u32> = beside.iter().map(|&t| self.opposite(t, gone, kept)).collect();
        opposite.sort_unstable();
        let (of_gone, of_kept) = (self.neighbours(gone), self.neighbours(kept));
        let common: Vec<u32> = of_gone.iter().copied().filter(|n| of_kept.binary_search(n).is_ok()).collect();
        // Nodes of three triangles would be left with two, lying on each other.
        let is_least =
            |&n: &u32| self.about[n as usize].len() <= 3 && self.place[n as usize] == Place::Inside;
        if common != opposite || opposite.iter().any(is_least) {
            return false;
        }
        let is_long = |&&n: &&u32| {
            n != gone && n != kept && self.at(n).distance(to_mm) > longest * self.wanted([n, kept])
        };
        let mut about = of_gone.iter().chain(&of_kept);
        if about.any(|n| is_long(&n))
            || !self.can_move(gone, to_mm, &beside)
            || !self.can_move(kept, to_mm, &beside)
        {
            return false;
        }
        self.nodes_mm[kept as usize] = to_mm;
        for &t in &beside {
            for n in std::mem::replace(&mut self.triangles[t as usize], GONE) {
                self.about[n as usize].retain(|&other| other != t);
            }
        }
        for t in std::mem::take(&mut self.about[gone as usize]) {
            let corners = &mut self.triangles[t as usize];
            *corners = corners.map(|n| if n == gone { kept } else { n });
            self.about[kept as usize].push(t);
        }
        true
    }

    fn flip_edges(&mut self) {
        let mut edges = self.edges();
        for _ in 0..MAX_SWEEPS {
            let flipped: Vec<u32> =
                edges.into_iter().filter_map(|[a, b]| self.flip(a, b)).flatten().collect();
            if flipped.is_empty() {
                break;
            }
            // Only edges of these may need a flip now.
            edges = edges_of(flipped.iter().map(|&t| &self.triangles[t as usize]));
        }
    }

    /// Joins the two other corners at an edge instead, where Delaunay's criterion asks for it: opposite angles that add up to
    /// more than 180°. Returns the two triangles where it does.
    fn flip(&mut self, a: u32, b: u32) -> Option<[u32; 2]> {
        let mut beside = self.beside(a, b);
        let [Some(s), Some(t), None] = [(); 3].map(|()| beside.next()) else { return None };
        drop(beside);
        if self.patch[s as usize] != self.patch[t as usize] {
            return None;
        }
        // In `first` the edge runs from a to b.
        let corners = self.triangles[s as usize];
        let runs = |k: usize| corners[k] == a && corners[(k + 1) % 3] == b;
        let (first, second) = if (0..3).any(runs) { (s, t) } else { (t, s) };
        let [c, d] = [first, second].map(|t| self.opposite(t, a, b));
        let [at_a, at_b, at_c, at_d] = [a, b, c, d].map(|n| self.at(n));
        let cotangent = |u: DVec3, v: DVec3| u.dot(v) / u.cross(v).length();
        let sum = cotangent(at_a - at_c, at_b - at_c) + cotangent(at_a - at_d, at_b - at_d);
        // A small margin: nodes on one circle flip no end otherwise.
        if sum.is_nan() || sum >= -1e-6 || c == d || self.beside(c, d).next().is_some() {
            return None;
        }
        let old = [first, second].map(|t| self.normal_of(self.triangles[t as usize]));
        let new = [[a, d, c], [b, c, d]];
        let normals = new.map(|corners| self.normal_of(corners));
        let lengths = normals.map(DVec3::length);
        let cosine = |[u, v]: [DVec3; 2]| u.dot(v) / (u.length() * v.length());
        let folds = lengths.contains(&0.0) || normals.iter().any(|n| n.dot(old[0] + old[1]) <= 0.0);
        if folds || cosine(normals) < LEAST_COSINE.min(cosine(old)) {
            return None;
        }
        for (t, corners) in [first, second].into_iter().zip(new) {
            self.triangles[t as usize] = corners;
        }
        self.about[a as usize].retain(|&t| t != second);
        self.about[b as usize].retain(|&t| t != first);
        self.about[c as usize].push(second);
        self.about[d as usize].push(first);
        Some([first, second])
    }

    /// Collapses the shortest sides of needles, whatever the length of the others.
    fn collapse_needles(&mut self) {
        let least = NEEDLE_DEG.to_radians();
        for t in 0..self.triangles.len() {
            let corners = self.triangles[t];
            if corners == GONE || smallest_angle_rad(corners.map(|n| self.at(n))) >= least {
                continue;
            }
            let [a, b, c] = corners;
            let mut sides = [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]);
            sides.sort_by(|p, q| self.length(*p).total_cmp(&self.length(*q)).then(p.cmp(q)));
            let _ = sides[..2].iter().any(|&side| self.collapse(side, 1.6));
        }
    }

    /// Moves nodes to the middle of their neighbours, along the surface.
    fn move_nodes(&mut self, target: &Target) {
        let moved: Vec<DVec3> =
            (0..self.nodes_mm.len() as u32).into_par_iter().map(|node| self.moved(node, target)).collect();
        for (node, to_mm) in (0..).zip(moved) {
            if to_mm != self.at(node) && self.can_move(node, to_mm, &[]) {
                self.nodes_mm[node as usize] = to_mm;
            }
        }
    }

    fn moved(&self, node: u32, target: &Target) -> DVec3 {
        let here = self.at(node);
        let triangles = &self.about[node as usize];
        match self.place[node as usize] {
            _ if triangles.is_empty() => here,
            Place::Corner | Place::Fixed => here,
            Place::Seam => {
                let mut along =
                    self.neighbours(node).into_iter().filter_map(|n| Some((n, self.seam(node, n)?)));
                let (Some((p, pair)), Some((q, _))) = (along.next(), along.next()) else { return here };
                target.on_seam(pair, 0.5 * (self.at(p) + self.at(q)))
            }
            Place::Inside => {
                let (mut middle, mut area, mut normal) = (DVec3::ZERO, 0.0, DVec3::ZERO);
                for &t in triangles {
                    let corners = self.triangles[t as usize];
                    let of_t = self.normal_of(corners);
                    // Larger triangles where the wanted length is larger.
                    let wanted: f64 = corners.iter().map(|&n| self.edge_mm[n as usize]).sum();
                    let weight = of_t.length() / (wanted * wanted).max(f64::MIN_POSITIVE);
                    middle += weight * corners.map(|n| self.at(n) - here).iter().sum::<DVec3>() / 3.0;
                    area += weight;
                    normal += of_t;
                }
                let step = if area > 0.0 { middle / area } else { DVec3::ZERO };
                let normal = normal.normalize_or_zero();
                let to_mm = here + step - normal * normal.dot(step);
                let closest = target.of_patch[self.patch[triangles[0] as usize] as usize].closest(to_mm);
                if closest.point_mm.is_finite() { closest.point_mm } else { here }
            }
        }
    }
}

/// The edges of triangles, each once, its nodes in ascending order.
fn edges_of<'a>(triangles: impl Iterator<Item = &'a [u32; 3]>) -> Vec<[u32; 2]> {
    let of = |&[a, b, c]: &[u32; 3]| [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]);
    let mut edges: Vec<[u32; 2]> = triangles.flat_map(of).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// Whether a triangle's normal is rounding noise.
fn is_flat(normal: DVec3, corners: [u32; 3], mesh: &Mesh) -> bool {
    let [a, b, c] = corners.map(|n| mesh.at(n));
    let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
    normal.length() <= 1e-9 * longest
}

/// The smallest angle of a triangle, rad; 0 where it has no area.
pub(crate) fn smallest_angle_rad([a, b, c]: [DVec3; 3]) -> f64 {
    let angle = |at: DVec3, p: DVec3, q: DVec3| {
        let (u, v) = (p - at, q - at);
        u.cross(v).length().atan2(u.dot(v))
    };
    angle(a, b, c).min(angle(b, c, a)).min(angle(c, a, b))
}
