//! The axes of a vessel's branches, found from its surface alone.
//!
//! Distances along the surface from one end cut it into bands; each connected piece of a band is a slice of one branch.
//! The middles of the slices on the way from an end to the start are a first axis. Planes across it give better middles,
//! the centroids of the lumen, and so on until they stay.

use super::axis::VesselAxis;
use crate::evaluate::Locator;
use crate::geometry::Pose;
use crate::geometry::polyline::resampled;
use crate::numerics::banded::Pentadiagonal;
use crate::numerics::robust::median;
use crate::reconstruction::Lumen;
use crate::surface::{Cutter, Groups, Surface};
use crate::{Error, Result};
use glam::{DMat3, DVec2, DVec3};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::f64::consts::PI;

/// A vessel's branches.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct VesselTree {
    /// Their axes. The first runs between the two ends that lie farthest apart, from the one that holds the lower node
    /// index; the others run from where their lumen is apart from that of an earlier one.
    pub axes: Vec<VesselAxis>,
    /// Of each node of the surface: its branch, as a place in `axes`.
    pub node_branch: Vec<u32>,
}

/// Length of edges in median diameters: longer ones are divided.
const EDGE_DIAMETERS: f64 = 0.2;
/// Height of a band in diameters.
const BAND_DIAMETERS: f64 = 0.25;
/// The least length of a branch that ends blindly, in diameters: shorter ones are bulges.
const BLIND_DIAMETERS: f64 = 1.0;
/// How often the diameter is halved to find the branches of all openings; and how far, in diameters of its opening, a branch
/// that is found so is apart at least.
const HALVINGS: usize = 2;
const APART_DIAMETERS: f64 = 0.5;
/// Most nodes of the divided surface.
const MAX_NODES: usize = 4_000_000;
/// Improvements by planes across the axis.
const ROUNDS: usize = 6;

impl VesselTree {
    /// The axes of a lumen: the centrelines of its branches, that of its one sweep, or those found from the surface.
    ///
    /// # Errors
    /// As [`VesselTree::of`].
    pub fn of_lumen(lumen: &Lumen, surface: &Surface) -> Result<Self> {
        let axes: Option<Result<Vec<VesselAxis>>> = match (lumen.branches(), lumen.cylinder_branches()) {
            (Some(branched), _) => Some(branched.sweeps.iter().map(VesselAxis::of_sweep).collect()),
            (_, Some(branched)) => {
                Some(branched.axes.iter().map(|axis| VesselAxis::through(&axis.points_mm)).collect())
            }
            _ => None,
        };
        if let Some(axes) = axes {
            let branch = surface.array("branch").unwrap_or_default();
            let node_branch = (0..surface.nodes_mm.len()).map(|n| branch.get(n).map_or(0, |b| *b as u32));
            return Ok(Self { axes: axes?, node_branch: node_branch.collect() });
        }
        match lumen.sweep() {
            Some(sweep) => Ok(Self::with_axes(vec![VesselAxis::of_sweep(sweep)?], surface.nodes_mm.len())),
            None => Self::of(surface),
        }
    }

    /// Axes of a vessel whose surface has so many nodes, all of them of branch 0.
    pub fn with_axes(axes: Vec<VesselAxis>, nodes: usize) -> Self {
        Self { axes, node_branch: vec![0; nodes] }
    }

    /// Finds the axes of a surface that looks like a tube or a tree of tubes, open or closed at its ends. Nodes in one
    /// place count as one; of several pieces the largest counts. Branches are numbered as the node array `branch` numbers them,
    /// where one opening lies in each of them and another one in branch 0.
    ///
    /// # Errors
    /// [`Error::Surface`] where it is no such surface: no area, or hardly any plane across it meets a closed outline.
    pub fn of(surface: &Surface) -> Result<Self> {
        let mut mesh = Graph::of(surface)?;
        let openings = mesh.openings();
        let numbered = numbered(surface.array("branch"), &openings);
        let ends_of = |mesh: &Graph| numbered.clone().unwrap_or_else(|| mesh.ends(openings.clone()));
        let (rims, blind_mm) = (openings.concat(), BLIND_DIAMETERS * mesh.diameter_mm);
        let mut found = Bands::of(&mesh, &ends_of(&mesh), &rims, Least { blind_mm, apart: 0.0 });
        // The mean diameter, of the whole area along the longest way, is too large in a tree: a branch that is apart over less
        // than a band has no slice of its own.
        for _ in 0..HALVINGS {
            if found.hidden == 0 {
                break;
            }
            mesh.diameter_mm /= 2.0;
            mesh.divide(EDGE_DIAMETERS * mesh.diameter_mm);
            mesh.join();
            let finer = Bands::of(&mesh, &ends_of(&mesh), &rims, Least { blind_mm, apart: APART_DIAMETERS });
            if finer.hidden < found.hidden {
                found = finer;
            }
        }
        let Found { paths, node_owner, diameter_mm, .. } = found;
        let node_branch: Vec<u32> = match surface.array("branch").filter(|_| numbered.is_some()) {
            Some(branch) => branch.iter().map(|&number| number as u32).collect(),
            None => mesh.first_at.iter().map(|&node| node_owner[node as usize]).collect(),
        };
        let (cutter, locator) = (Cutter::new(surface)?, Locator::new(surface)?);
        let mut axes = Vec::new();
        for (branch, path) in paths.iter().enumerate() {
            let is_own = |node: u32| node_branch[node as usize] == branch as u32;
            match refined(&cutter, path, diameter_mm, branch > 0, &is_own) {
                Ok(axis) if branch > 0 => axes.push(apart(axis, &locator)?),
                Ok(axis) => axes.push(axis),
                Err(error) if branch == 0 => return Err(error),
                // A branch that no plane cuts closed keeps the middles of its slices.
                Err(_) => axes.push(apart(VesselAxis::through(path)?, &locator)?),
            }
        }
        Ok(Self { axes, node_branch })
    }
}

/// The largest piece of a surface as a graph of short edges.
struct Graph {
    nodes_mm: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Of each node of the surface that was given: the first one in its place.
    first_at: Vec<u32>,
    /// Neighbours of each node with the lengths to them, as ranges of `joined`.
    starts: Vec<usize>,
    joined: Vec<(u32, f64)>,
    diameter_mm: f64,
}

impl Graph {
    fn of(surface: &Surface) -> Result<Self> {
        surface.check()?;
        let first_at = surface.first_in_place();
        let triangles = surface.triangles.iter().map(|t| t.map(|n| first_at[n as usize]));
        let whole: Vec<[u32; 3]> = triangles.filter(|[a, b, c]| a != b && b != c && c != a).collect();
        let area = |[a, b, c]: [u32; 3]| {
            let [a, b, c] = [a, b, c].map(|n| surface.nodes_mm[n as usize]);
            (b - a).cross(c - a).length() / 2.0
        };
        let mut pieces = Groups::new(surface.nodes_mm.len());
        whole.iter().for_each(|&[a, b, c]| {
            pieces.join(a, b);
            pieces.join(b, c);
        });
        let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
        whole.iter().for_each(|&t| *areas.entry(pieces.root(t[0])).or_default() += area(t));
        let Some((&largest, &area_mm2)) = areas.iter().max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(a.0)))
        else {
            return Err(no_tube("no triangles".into()));
        };
        if !(area_mm2 > 0.0 && area_mm2.is_finite()) {
            return Err(no_tube(format!("an area of {area_mm2} mm²")));
        }
        let triangles = whole.into_iter().filter(|t| pieces.root(t[0]) == largest).collect();
        let mut graph = Self {
            nodes_mm: surface.nodes_mm.clone(),
            triangles,
            first_at,
            starts: Vec::new(),
            joined: Vec::new(),
            diameter_mm: 0.0,
        };
        graph.join();
        // A tube's area is its length times its circumference.
        let far = |graph: &Self, from: u32| graph.farthest(&graph.distances(&[from]).0);
        let start = far(&graph, graph.triangles[0][0]);
        let length = graph.distances(&[start]).0[far(&graph, start) as usize];
        graph.diameter_mm = area_mm2 / (PI * length);
        graph.divide(EDGE_DIAMETERS * graph.diameter_mm);
        graph.join();
        Ok(graph)
    }

    /// Halves edges until none is longer. Triangles stay joined.
    fn divide(&mut self, longest_mm: f64) {
        loop {
            let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
            let mut divided = Vec::with_capacity(self.triangles.len());
            for &corners in &self.triangles {
                let middle = [0, 1, 2].map(|k| {
                    let (a, b) = (corners[k], corners[(k + 1) % 3]);
                    let (p, q) = (self.nodes_mm[a as usize], self.nodes_mm[b as usize]);
                    (p.distance(q) > longest_mm).then(|| {
                        *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                            self.nodes_mm.push(p.midpoint(q));
                            self.nodes_mm.len() as u32 - 1
                        })
                    })
                });
                divide_triangle(corners, middle, &mut divided);
            }
            let done = middles.is_empty() || self.nodes_mm.len() > MAX_NODES;
            self.triangles = divided;
            if done {
                return;
            }
        }
    }

    fn join(&mut self) {
        let mut edges: Vec<[u32; 2]> = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, a], [b, c], [c, b], [c, a], [a, c]])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let length = |[a, b]: [u32; 2]| self.nodes_mm[a as usize].distance(self.nodes_mm[b as usize]);
        self.joined = edges.iter().map(|&edge| (edge[1], length(edge))).collect();
        self.starts = (0..=self.nodes_mm.len() as u32).map(|n| edges.partition_point(|e| e[0] < n)).collect();
    }

    fn neighbours(&self, node: u32) -> &[(u32, f64)] {
        &self.joined[self.starts[node as usize]..self.starts[node as usize + 1]]
    }

    /// Length along edges from the nearest of some nodes, infinite where none leads there, and the node before.
    fn distances(&self, from: &[u32]) -> (Vec<f64>, Vec<u32>) {
        let mut distance = vec![f64::INFINITY; self.nodes_mm.len()];
        let mut before: Vec<u32> = (0..self.nodes_mm.len() as u32).collect();
        // Bits of positive numbers sort as the numbers do.
        let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
        for &node in from {
            distance[node as usize] = 0.0;
            queue.push(Reverse((0, node)));
        }
        while let Some(Reverse((bits, node))) = queue.pop() {
            let here = f64::from_bits(bits);
            if here > distance[node as usize] {
                continue;
            }
            for &(next, length) in self.neighbours(node) {
                if here + length < distance[next as usize] {
                    distance[next as usize] = here + length;
                    before[next as usize] = node;
                    queue.push(Reverse(((here + length).to_bits(), next)));
                }
            }
        }
        (distance, before)
    }

    /// The reachable node with the largest distance.
    fn farthest(&self, distance: &[f64]) -> u32 {
        let finite = distance.iter().enumerate().filter(|(_, d)| d.is_finite());
        finite.fold((0, -1.0), |best, (n, &d)| if d > best.1 { (n, d) } else { best }).0 as u32
    }

    /// The nodes where the first axis starts; then those of its end and of the ends of other branches.
    fn ends(&self, mut openings: Vec<Vec<u32>>) -> Vec<Vec<u32>> {
        let reach = |from: &[u32], to: &[u32]| {
            let distance = self.distances(from).0;
            to.iter().map(|&n| distance[n as usize]).fold(f64::INFINITY, f64::min)
        };
        if openings.len() >= 2 {
            let mut farthest = (0.0, [0, 1]);
            for a in 0..openings.len() {
                let distance = self.distances(&openings[a]).0;
                for (b, other) in openings.iter().enumerate().skip(a + 1) {
                    let near = other.iter().map(|&n| distance[n as usize]).fold(f64::INFINITY, f64::min);
                    if near > farthest.0 {
                        farthest = (near, [a, b]);
                    }
                }
            }
            let [a, b] = farthest.1;
            openings.swap(1, b.max(a));
            openings.swap(0, a.min(b));
            // The others from the farthest on.
            let source = openings[0].clone();
            openings[2..].sort_by(|p, q| reach(&source, q).total_cmp(&reach(&source, p)));
            return openings;
        }
        if let Some(source) = openings.pop() {
            let end = self.farthest(&self.distances(&source).0);
            return vec![source, vec![end]];
        }
        let a = self.farthest(&self.distances(&[self.triangles[0][0]]).0);
        let b = self.farthest(&self.distances(&[a]).0);
        vec![vec![a.min(b)], vec![a.max(b)]]
    }

    /// Twice the mean distance of a rim's nodes from their middle, mm.
    fn width_mm(&self, rim: &[u32]) -> f64 {
        let at = |n: &u32| self.nodes_mm[*n as usize];
        let middle = rim.iter().map(at).sum::<DVec3>() / rim.len() as f64;
        2.0 * rim.iter().map(|n| at(n).distance(middle)).sum::<f64>() / rim.len() as f64
    }

    /// The openings at which a tube ends, by their nodes; not the holes in a tube's side, whose rims lie in the wall. By
    /// their lowest nodes.
    fn openings(&self) -> Vec<Vec<u32>> {
        const MOST: usize = 24;
        let mut edges: BTreeMap<(u32, u32), (u32, DVec3)> = BTreeMap::new();
        for &[a, b, c] in &self.triangles {
            let [p, q, r] = [a, b, c].map(|n| self.nodes_mm[n as usize]);
            let normal = (q - p).cross(r - p).normalize_or_zero();
            for (a, b) in [(a, b), (b, c), (c, a)] {
                edges.entry((a.min(b), a.max(b))).or_insert((0, if a < b { normal } else { -normal })).0 += 1;
            }
        }
        let rim: Vec<RimEdge> =
            edges.into_iter().filter(|(_, (count, _))| *count == 1).map(|(edge, (_, n))| (edge, n)).collect();
        let mut groups = Groups::new(self.nodes_mm.len());
        rim.iter().for_each(|&((a, b), _)| groups.join(a, b));
        let mut rims: BTreeMap<u32, Vec<RimEdge>> = BTreeMap::new();
        for &edge in &rim {
            rims.entry(groups.root(edge.0.0)).or_default().push(edge);
        }
        let mut openings: Vec<(f64, Vec<u32>)> = Vec::new();
        for rim in rims.values() {
            let origin = self.nodes_mm[rim[0].0.0 as usize];
            let at = |n: u32| self.nodes_mm[n as usize] - origin;
            let mut nodes: Vec<u32> = rim.iter().flat_map(|&((a, b), _)| [a, b]).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let normal = plane_normal(&nodes.iter().map(|&n| at(n)).collect::<Vec<_>>());
            let across = rim.iter().map(|(_, n)| n.dot(normal).abs()).sum::<f64>() / rim.len() as f64;
            let length: f64 = rim.iter().map(|&((a, b), _)| at(a).distance(at(b))).sum();
            if across < 0.6 && nodes.len() >= 3 {
                openings.push((length, nodes));
            }
        }
        openings.sort_by(|a, b| b.0.total_cmp(&a.0));
        openings.truncate(MOST);
        openings.sort_by_key(|(_, nodes)| nodes[0]);
        openings.into_iter().map(|(_, nodes)| nodes).collect()
    }
}

/// The openings in the order of the branches that end there: both of branch 0, that with the lowest node first, and one of
/// each other branch. `None` where the numbers of the nodes' branches are missing or say something else.
fn numbered(branch: Option<&[f64]>, openings: &[Vec<u32>]) -> Option<Vec<Vec<u32>>> {
    let branch = branch?;
    let number = |rim: &Vec<u32>| {
        let mut of: Vec<f64> = rim.iter().filter_map(|&node| branch.get(node as usize).copied()).collect();
        median(&mut of)
    };
    let mut ordered: Vec<(f64, &Vec<u32>)> = openings.iter().map(|rim| (number(rim), rim)).collect();
    ordered.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1[0].cmp(&b.1[0])));
    let expected = (0..openings.len()).map(|k| k.saturating_sub(1) as f64);
    let fits = openings.len() > 2 && ordered.iter().map(|(number, _)| *number).eq(expected);
    fits.then(|| ordered.into_iter().map(|(_, rim)| rim.clone()).collect())
}

/// An edge of one triangle only, and that triangle's normal, whichever its sign.
type RimEdge = ((u32, u32), DVec3);

/// The direction in which points spread least.
fn plane_normal(points: &[DVec3]) -> DVec3 {
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let spread = points.iter().fold(DMat3::ZERO, |sum, p| {
        let q = *p - mean;
        sum + DMat3::from_cols(q * q.x, q * q.y, q * q.z)
    });
    let trace = spread.x_axis.x + spread.y_axis.y + spread.z_axis.z;
    // Inverse iteration; a share of the trace keeps a plane's matrix regular.
    let inverse = (spread + DMat3::IDENTITY * (1e-9 * trace + f64::MIN_POSITIVE)).inverse();
    let start = [DVec3::X, DVec3::Y, DVec3::Z]
        .into_iter()
        .max_by(|a, b| (inverse * *a).length().total_cmp(&(inverse * *b).length()))
        .unwrap_or(DVec3::Z);
    (0..20).fold(start, |v, _| (inverse * v).normalize_or(v))
}

/// Pushes what halving some edges makes of a triangle.
fn divide_triangle([a, b, c]: [u32; 3], middle: [Option<u32>; 3], divided: &mut Vec<[u32; 3]>) {
    match middle {
        [None, None, None] => divided.push([a, b, c]),
        [Some(m), None, None] => divided.extend([[a, m, c], [m, b, c]]),
        [None, Some(m), None] => divided.extend([[b, m, a], [m, c, a]]),
        [None, None, Some(m)] => divided.extend([[c, m, b], [m, a, b]]),
        [Some(m), Some(n), None] => divided.extend([[m, b, n], [a, m, n], [a, n, c]]),
        [None, Some(m), Some(n)] => divided.extend([[m, c, n], [b, m, n], [b, n, a]]),
        [Some(n), None, Some(m)] => divided.extend([[m, a, n], [c, m, n], [c, n, b]]),
        [Some(m), Some(n), Some(o)] => divided.extend([[a, m, o], [m, b, n], [n, c, o], [m, n, o]]),
    }
}

/// The slices of a surface: connected nodes at similar distances from the start.
struct Bands {
    distance: Vec<f64>,
    before: Vec<u32>,
    /// Of each node: the lowest node of its slice.
    slice: Vec<u32>,
}

/// How long branches are at least.
#[derive(Clone, Copy)]
struct Least {
    /// Those that end blindly, mm.
    blind_mm: f64,
    /// How far the branch of an opening is apart, in diameters of the opening.
    apart: f64,
}

/// The branches of a surface.
struct Found {
    /// The middles of the slices along each branch from its start on.
    paths: Vec<Vec<DVec3>>,
    /// Of each node its branch.
    node_owner: Vec<u32>,
    /// Openings at which no branch ends.
    hidden: usize,
    /// The diameter that the height of the bands was taken from.
    diameter_mm: f64,
}

impl Bands {
    /// The branches between the first of some ends and the others.
    fn of(mesh: &Graph, ends: &[Vec<u32>], rims: &[u32], least: Least) -> Found {
        Self::from(mesh, &ends[0]).branches(mesh, &ends[1..], rims, least)
    }

    fn from(mesh: &Graph, source: &[u32]) -> Self {
        let (distance, before) = mesh.distances(source);
        let height = BAND_DIAMETERS * mesh.diameter_mm;
        let band = |node: u32| (distance[node as usize] / height) as u64;
        let mut groups = Groups::new(mesh.nodes_mm.len());
        for node in 0..mesh.nodes_mm.len() as u32 {
            for &(next, _) in mesh.neighbours(node) {
                if distance[node as usize].is_finite() && band(node) == band(next) {
                    groups.join(node, next);
                }
            }
        }
        let slice = (0..mesh.nodes_mm.len() as u32).map(|node| groups.root(node)).collect();
        Self { distance, before, slice }
    }

    fn branches(&self, mesh: &Graph, ends: &[Vec<u32>], rims: &[u32], least: Least) -> Found {
        let mut sums: BTreeMap<u32, (DVec3, f64)> = BTreeMap::new();
        let mut top: BTreeMap<u32, u32> = BTreeMap::new();
        for node in 0..mesh.nodes_mm.len() as u32 {
            if !self.distance[node as usize].is_finite() {
                continue;
            }
            let sum = sums.entry(self.slice[node as usize]).or_default();
            *sum = (sum.0 + mesh.nodes_mm[node as usize], sum.1 + 1.0);
            let best = top.entry(self.slice[node as usize]).or_insert(node);
            if self.distance[node as usize] > self.distance[*best as usize] {
                *best = node;
            }
        }
        let middle = |slice: u32| sums.get(&slice).map_or(DVec3::NAN, |(sum, count)| *sum / *count);
        // Slices that go no farther: where branches end blindly.
        let goes_on = |slice: u32, node: u32| {
            mesh.neighbours(node).iter().any(|&(next, _)| {
                self.slice[next as usize] != slice
                    && self.distance[next as usize] > self.distance[node as usize]
            })
        };
        let mut leads_on: BTreeMap<u32, bool> = top.keys().map(|&slice| (slice, false)).collect();
        for node in 0..mesh.nodes_mm.len() as u32 {
            if let Some(leads) = leads_on.get_mut(&self.slice[node as usize])
                && !*leads
            {
                *leads = goes_on(self.slice[node as usize], node);
            }
        }
        // The farther side of an opening is no end of its own.
        for &node in rims {
            leads_on.insert(self.slice[node as usize], true);
        }
        let mut blind: Vec<u32> =
            leads_on.iter().filter(|(_, leads)| !**leads).map(|(slice, _)| top[slice]).collect();
        blind.sort_by(|&a, &b| {
            self.distance[b as usize].total_cmp(&self.distance[a as usize]).then(a.cmp(&b))
        });

        let mut owner: BTreeMap<u32, u32> = BTreeMap::new();
        let mut paths: Vec<Vec<DVec3>> = Vec::new();
        let mut hidden = 0;
        let known = ends.iter().map(|rim| (rim[0], Some(rim)));
        for (end, opening) in known.chain(blind.into_iter().map(|end| (end, None))) {
            // From the end back to the start, or to a branch that is known.
            let mut slices = Vec::new();
            let mut node = end;
            let joins = loop {
                let slice = self.slice[node as usize];
                if let Some(&branch) = owner.get(&slice) {
                    break Some((slice, branch));
                }
                if slices.last() != Some(&slice) {
                    slices.push(slice);
                }
                let before = self.before[node as usize];
                if before == node {
                    break None;
                }
                node = before;
            };
            let start = self.distance[node as usize];
            let is_branch = match (joins, opening) {
                (None, _) => paths.is_empty(),
                (Some(_), Some(rim)) => {
                    let farthest = rim.iter().map(|&n| self.distance[n as usize]).fold(0.0, f64::max);
                    slices.len() >= 2 && farthest - start >= least.apart * mesh.width_mm(rim)
                }
                (Some(_), None) => self.distance[end as usize] - start >= least.blind_mm,
            };
            hidden += usize::from(!is_branch && opening.is_some());
            let branch = match joins {
                _ if is_branch => paths.len() as u32,
                Some((_, branch)) => branch,
                None => 0,
            };
            owner.extend(slices.iter().map(|&slice| (slice, branch)));
            if is_branch {
                let start = joins.map(|(slice, _)| slice);
                paths.push(start.into_iter().chain(slices.into_iter().rev()).map(middle).collect());
            }
        }
        // Slices beside all ways belong where the ways to them come from, nearer ones first.
        let mut rest: Vec<u32> = top.keys().copied().filter(|slice| !owner.contains_key(slice)).collect();
        rest.sort_by(|&a, &b| {
            self.distance[a as usize].total_cmp(&self.distance[b as usize]).then(a.cmp(&b))
        });
        for slice in rest {
            let mut node = slice;
            let branch = loop {
                if let Some(&branch) = owner.get(&self.slice[node as usize]) {
                    break branch;
                }
                let before = self.before[node as usize];
                if before == node {
                    break 0;
                }
                node = before;
            };
            owner.insert(slice, branch);
        }
        let node_owner = self.slice.iter().map(|slice| owner.get(slice).copied().unwrap_or(0)).collect();
        Found { paths, node_owner, hidden, diameter_mm: mesh.diameter_mm }
    }
}

/// A better axis than a path: through the centroids of the lumen in planes across it, smoothed, and as long as planes
/// across it meet closed outlines.
fn refined(
    cutter: &Cutter,
    path: &[DVec3],
    diameter_mm: f64,
    is_branch: bool,
    is_own: &dyn Fn(u32) -> bool,
) -> Result<VesselAxis> {
    // Smoothing over about (STIFFNESS)^¼ steps.
    const STIFFNESS: f64 = 4.0;
    const STEP_DIAMETERS: f64 = 0.25;
    let step = STEP_DIAMETERS * diameter_mm;
    // The centroid of the lumen and its distance from the outline.
    let centroid = |pose: &Pose| -> Option<(DVec3, f64)> {
        let cut = cutter.cut(pose);
        let reach = |k: usize| match cut.outlines[k].contains(DVec2::ZERO) {
            true => 0.0,
            false => cut.outlines[k].distance_mm(DVec2::ZERO),
        };
        let nearest = (0..cut.outlines.len()).min_by(|&a, &b| reach(a).total_cmp(&reach(b)))?;
        let outline = &cut.outlines[nearest];
        let radius = (outline.area_mm2() / PI).sqrt();
        let middle = outline.centroid_mm();
        let pure = cut.on_edges[nearest].iter().all(|on| on.nodes.iter().all(|&n| is_own(n)));
        (pure && reach(nearest) <= 0.5 * radius && middle.length() <= radius)
            .then(|| (pose.transform_point(middle.extend(0.0)), outline.distance_mm(middle)))
    };
    let mut points = path.to_vec();
    if points.len() < 2 {
        return Err(no_tube("a piece as short as it is wide".into()));
    }
    let mut seen = Vec::new();
    for round in 0..ROUNDS {
        points = resampled(&points, step);
        if round == 0 {
            let last = points.len() - 1;
            // Both ends lie half a band inside; a branch starts within its parent.
            let back = (points[0] - points[last.min(3)]).normalize_or_zero();
            let on = (points[last] - points[last.saturating_sub(3)]).normalize_or_zero();
            let (start, end) = (points[0], points[last]);
            points.extend((1..=6).map(|k| end + on * step * f64::from(k)));
            if !is_branch {
                points.splice(0..0, (1..=6).rev().map(|k| start + back * step * f64::from(k)));
            }
        }
        let axis = VesselAxis::through(&points)?;
        let stations: Vec<f64> = crate::geometry::polyline::lengths(&points);
        let whole = stations[stations.len() - 1];
        let mut middles: Vec<Option<(DVec3, f64)>> =
            stations.iter().map(|s| centroid(&axis.pose(s / whole * axis.length_mm()))).collect();
        without_corners(&mut middles);
        middles.reverse();
        without_corners(&mut middles);
        middles.reverse();
        let middles: Vec<Option<DVec3>> = middles.into_iter().map(|m| m.map(|(middle, _)| middle)).collect();
        let mut matrix = Pentadiagonal::second_differences(points.len(), STIFFNESS);
        let mut right = vec![DVec3::ZERO; points.len()];
        for (k, middle) in middles.iter().enumerate() {
            // Between outlines the axis is as straight as it can be; beyond them it goes on as it bends there.
            let is_beyond =
                !middles[..=k].iter().any(Option::is_some) || !middles[k..].iter().any(Option::is_some);
            let weight = if middle.is_some() {
                1.0
            } else if is_beyond {
                0.3
            } else {
                1e-9
            };
            matrix.add_diagonal(k, weight);
            right[k] = middle.unwrap_or(points[k]) * weight;
        }
        if let Some(factored) = matrix.factored() {
            points = factored.solve(right);
        }
        seen = middles.iter().map(Option::is_some).collect();
        prolong(&mut points, &seen);
        let reversed: Vec<bool> = seen.iter().rev().copied().collect();
        points.reverse();
        prolong(&mut points, &reversed);
        points.reverse();
    }
    let (Some(first), Some(last)) = (seen.iter().position(|&s| s), seen.iter().rposition(|&s| s)) else {
        return Err(no_tube("no plane across it that meets a closed outline".into()));
    };
    let closed = seen[first..=last].iter().filter(|&&s| s).count();
    // A branch may be apart over no more than a diameter: a line through two outlines is nearer to it than its slices.
    if last < first + if is_branch { 1 } else { 2 } || 4 * closed < last - first {
        return Err(no_tube(format!("closed outlines in {closed} of {} planes across it", seen.len())));
    }
    // To the last closed outline on both sides.
    let axis = VesselAxis::through(&points)?;
    let at = |k: usize| axis.station_mm(points[k]);
    let edge = |mut inside: f64, mut outside: f64| {
        for _ in 0..24 {
            let middle = (inside + outside) / 2.0;
            if centroid(&axis.pose(middle)).is_some() { inside = middle } else { outside = middle }
        }
        inside
    };
    let start = if is_branch || first == 0 { at(first) } else { edge(at(first), at(first - 1)) };
    let end = if last + 1 == points.len() { at(last) } else { edge(at(last), at(last + 1)) };
    // Not in the plane of a rim.
    let margin = 1e-3 * diameter_mm;
    axis.part([start + margin, end - margin])
}

/// The part of a branch's axis from where it lies as deep in its lumen as farther on: before that, outlines are still of
/// the wedge at which it parts from another.
fn apart(axis: VesselAxis, locator: &Locator) -> Result<VesselAxis> {
    const DEEP: f64 = 0.75;
    let points = axis.points_mm();
    let depth: Vec<f64> = locator.closest_all(points).iter().map(|c| c.distance_mm).collect();
    let half = points.len() / 2;
    let typical = median(&mut depth[half..].to_vec());
    match depth[..half].iter().position(|&d| d >= DEEP * typical) {
        Some(first) if first > 0 => axis.part([axis.arc_mm()[first], axis.length_mm()]),
        _ => Ok(axis),
    }
}

/// Leaves out the first outlines where they are much smaller than those a diameter on: of the corners of a closed end or of
/// the wedge where two branches part, not of a lumen.
fn without_corners(middles: &mut [Option<(DVec3, f64)>]) {
    const SMALL: f64 = 0.75;
    const ON: usize = 4;
    for k in 0..middles.len().saturating_sub(ON) {
        match (middles[k], middles[k + ON]) {
            (None, _) => {}
            (Some((_, size)), Some((_, on))) if size < SMALL * on => middles[k] = None,
            _ => return,
        }
    }
}

/// Places the points behind the last one that was seen on the parabola through those before it, but with no bend closer than a
/// diameter, and not much longer steps: of a short branch the bend is hardly known, and every round adds to what the one before made
/// of it.
fn prolong(points: &mut [DVec3], seen: &[bool]) {
    /// Points over which the bend is taken, the most that it turns from one to the next, a quarter of a diameter on, rad, and the
    /// longest step, in those before.
    const OVER: usize = 4;
    const MAX_TURN: f64 = 0.25;
    const MAX_GROWTH: f64 = 1.3;
    let Some(last) = seen.iter().rposition(|&s| s).filter(|&last| last > OVER) else { return };
    let bend = |k: usize| points[k + 1] - points[k] * 2.0 + points[k - 1];
    let bend = (last - OVER..last).map(bend).sum::<DVec3>() / OVER as f64;
    let mut step = points[last] - points[last - 1];
    let length_mm = step.length();
    let bend = bend.clamp_length_max(MAX_TURN * length_mm);
    for k in last + 1..points.len() {
        step = (step + bend).clamp_length_max(MAX_GROWTH * length_mm);
        points[k] = points[k - 1] + step;
    }
}

fn no_tube(found: String) -> Error {
    Error::Surface {
        what: "vessel".into(),
        found,
        expected: "a tube, or a tree of tubes, whose wall is closed around the lumen".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_behind_the_last_outline_do_not_run_away() {
        let seen: Vec<bool> = (0..20).map(|k| k < 7).collect();
        let prolonged = |bend_mm: f64| {
            let place = |k: usize| DVec3::new(k as f64, 0.5 * bend_mm * (k * k) as f64, 0.0);
            let mut points: Vec<DVec3> = (0..20).map(place).collect();
            prolong(&mut points, &seen);
            let off_mm = (7..20).map(|k| points[k].distance(place(k))).fold(0.0, f64::max);
            let steps_mm = points.windows(2).map(|pair| pair[0].distance(pair[1]));
            (off_mm, steps_mm.skip(6).fold(0.0, f64::max) / points[5].distance(points[6]))
        };
        // A parabola goes on, and one of a close bend goes on otherwise.
        assert!(prolonged(0.03).0 < 1e-9);
        let (off_mm, growth) = prolonged(0.5);
        assert!(off_mm > 10.0 && growth < 1.31, "{off_mm} {growth}");
    }
}
