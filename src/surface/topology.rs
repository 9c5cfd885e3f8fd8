//! Topology and normals of a surface.

use super::Surface;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

/// A triangle whose area is below this share of its longest edge's square is degenerate: its normal would be rounding
/// noise.
const SMALLEST_AREA_RATIO: f64 = 1e-12;

/// How the triangles of a surface are connected.
///
/// Triangles that name a node twice count as degenerate and nowhere else.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct Topology {
    /// Nodes that some triangle uses.
    pub nodes: usize,
    /// Edges between them, each counted once.
    pub edges: usize,
    /// Triangles.
    pub triangles: usize,
    /// Edges of one triangle only.
    pub boundary_edges: usize,
    /// Connected groups of boundary edges: the openings.
    pub boundary_loops: usize,
    /// Edges of three triangles or more.
    pub non_manifold_edges: usize,
    /// Nodes where parts of the surface touch in a point only: their triangles are not all connected by edges there.
    pub non_manifold_nodes: usize,
    /// Edges of two triangles that both run along them the same way, so that their normals disagree.
    pub inconsistent_edges: usize,
    /// Triangles that name a node twice or have no area (below 1e-12 of their longest edge squared).
    pub degenerate_triangles: usize,
    /// Triangles whose three nodes an earlier one has too, in whatever order.
    pub duplicate_triangles: usize,
    /// Parts that share no node.
    pub components: usize,
    /// Nodes - edges + triangles: 2 for a closed sphere, less 1 per opening and less 2 per handle.
    pub euler_characteristic: i64,
}

impl Topology {
    /// Whether every edge belongs to one or two triangles and two neighbours agree on their orientation.
    pub fn is_oriented_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.inconsistent_edges == 0
    }

    /// Whether there is no boundary.
    pub fn is_closed(&self) -> bool {
        self.boundary_edges == 0
    }
}

/// An edge of a triangle. Corner k of triangle t has the number 3 t + k.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Edge {
    /// In ascending order.
    nodes: [u32; 2],
    /// The triangle's corners there.
    corners: [u32; 2],
}

impl Edge {
    /// Whether the triangle runs along it from the lower node to the higher.
    fn is_upwards(&self) -> bool {
        let [from, to] = self.corners;
        (from + 1) % 3 == to % 3
    }
}

impl Surface {
    /// How its triangles are connected.
    pub fn topology(&self) -> Topology {
        let whole: Vec<[u32; 3]> = self.triangles.iter().copied().filter(|&t| has_three_nodes(t)).collect();
        let mut topology = Topology { triangles: whole.len(), ..Topology::default() };
        let flat = |t: &&[u32; 3]| has_no_area(t.map(|n| self.nodes_mm[n as usize]));
        topology.degenerate_triangles =
            self.triangles.len() - whole.len() + whole.iter().filter(flat).count();

        let mut sorted = whole.clone();
        sorted.iter_mut().for_each(|t| t.sort_unstable());
        sorted.par_sort_unstable();
        topology.duplicate_triangles = sorted.windows(2).filter(|pair| pair[0] == pair[1]).count();

        let edges = edges(&whole);
        let split = || {
            let mut fans = fans(whole.len(), &edges);
            let is_split =
                |node: &&Vec<u32>| node.iter().any(|&corner| fans.root(corner) != fans.root(node[0]));
            corners_of_nodes(self.nodes_mm.len(), &whole).iter().filter(is_split).count()
        };
        let count = || {
            let mut parts = Groups::new(self.nodes_mm.len());
            let mut openings = Groups::new(self.nodes_mm.len());
            for edge in edges.chunk_by(|p, q| p.nodes == q.nodes) {
                topology.edges += 1;
                let [a, b] = edge[0].nodes;
                parts.join(a, b);
                match edge {
                    [_] => {
                        topology.boundary_edges += 1;
                        openings.join(a, b);
                    }
                    [p, q] => {
                        topology.inconsistent_edges += usize::from(p.is_upwards() == q.is_upwards());
                    }
                    _ => topology.non_manifold_edges += 1,
                }
            }
            (parts, openings)
        };
        let ((parts, openings), split) = rayon::join(count, split);
        topology.non_manifold_nodes = split;
        topology.nodes = parts.members();
        topology.components = parts.count();
        topology.boundary_loops = openings.count();
        topology.euler_characteristic =
            topology.nodes as i64 - topology.edges as i64 + topology.triangles as i64;
        topology
    }

    /// The edges of one triangle only, each in ascending node order.
    pub fn boundary_edges(&self) -> Vec<[u32; 2]> {
        let whole: Vec<[u32; 3]> = self.triangles.iter().copied().filter(|&t| has_three_nodes(t)).collect();
        let edges = edges(&whole);
        let groups = edges.chunk_by(|p, q| p.nodes == q.nodes);
        groups.filter(|edge| edge.len() == 1).map(|edge| edge[0].nodes).collect()
    }

    /// Of each node: the first one in its place.
    pub(crate) fn first_in_place(&self) -> Vec<u32> {
        // Adding zero makes -0 and 0 the same place.
        let place = |p: &DVec3| (*p + DVec3::ZERO).to_array().map(f64::to_bits);
        let mut places: Vec<([u64; 3], u32)> =
            self.nodes_mm.par_iter().map(place).zip(0..self.nodes_mm.len() as u32).collect();
        places.par_sort_unstable();
        let mut first = vec![0; places.len()];
        for same in places.chunk_by(|a, b| a.0 == b.0) {
            same.iter().for_each(|(_, node)| first[*node as usize] = same[0].1);
        }
        first
    }

    /// The surface with triangles that share a node wherever theirs are in one place, as cuts and axes need it: some
    /// programs give every triangle nodes of its own. Triangles that this leaves with fewer than three nodes are dropped.
    #[must_use]
    pub fn joined(mut self) -> Self {
        let first = self.first_in_place();
        self.triangles.iter_mut().for_each(|t| *t = t.map(|node| first[node as usize]));
        self.triangles.retain(|&t| has_three_nodes(t));
        self
    }

    /// The surface with a node for each of the parts that touch in one node only, with the same position and values. The first
    /// part keeps the node, the others' are added behind all nodes.
    #[must_use]
    pub(crate) fn with_touching_parts_split(mut self) -> Self {
        let mut fans = fans(self.triangles.len(), &edges(&self.triangles));
        for (node, corners) in corners_of_nodes(self.nodes_mm.len(), &self.triangles).iter().enumerate() {
            let mut added: Vec<(u32, u32)> = Vec::new();
            for &corner in corners {
                let fan = fans.root(corner);
                if fan == fans.root(corners[0]) {
                    continue;
                }
                let known = added.iter().find(|(known, _)| *known == fan).map(|(_, copy)| *copy);
                let copy = known.unwrap_or_else(|| {
                    let copy = self.nodes_mm.len() as u32;
                    self.nodes_mm.push(self.nodes_mm[node]);
                    self.arrays.iter_mut().for_each(|array| array.values.push(array.values[node]));
                    added.push((fan, copy));
                    copy
                });
                self.triangles[corner as usize / 3][corner as usize % 3] = copy;
            }
        }
        self
    }

    /// The surface without the parts that have less than a share of all triangles.
    #[must_use]
    pub(crate) fn without_small_parts(mut self, least_share: f64) -> Self {
        let mut parts = Groups::new(self.nodes_mm.len());
        for &[a, b, c] in &self.triangles {
            parts.join(a, b);
            parts.join(b, c);
        }
        let mut count = vec![0_usize; self.nodes_mm.len()];
        self.triangles.iter().for_each(|t| count[parts.root(t[0]) as usize] += 1);
        let least = least_share * self.triangles.len() as f64;
        self.triangles.retain(|t| count[parts.root(t[0]) as usize] as f64 >= least);
        self
    }

    /// The surface without the nodes that no triangle uses, and with their arrays.
    #[must_use]
    pub(crate) fn without_loose_nodes(mut self) -> Self {
        let mut number = vec![u32::MAX; self.nodes_mm.len()];
        self.triangles.iter().flatten().for_each(|&n| number[n as usize] = 0);
        let kept: Vec<usize> = (0..number.len()).filter(|&n| number[n] == 0).collect();
        kept.iter().zip(0..).for_each(|(&n, new)| number[n] = new);
        self.triangles.iter_mut().flatten().for_each(|n| *n = number[*n as usize]);
        self.nodes_mm = kept.iter().map(|&n| self.nodes_mm[n]).collect();
        for array in &mut self.arrays {
            array.values = kept.iter().map(|&n| array.values[n]).collect();
        }
        self
    }

    /// The triangles whose corners do not lie where those of an earlier one do, in whatever order; ascending.
    pub(crate) fn distinct_triangles(&self) -> Vec<u32> {
        let first = self.first_in_place();
        let key = |triangle: &[u32; 3]| {
            let mut corners = triangle.map(|node| first[node as usize]);
            corners.sort_unstable();
            corners
        };
        let mut keyed: Vec<([u32; 3], u32)> = self.triangles.iter().map(key).zip(0..).collect();
        keyed.par_sort_unstable();
        keyed.dedup_by_key(|(corners, _)| *corners);
        let mut distinct: Vec<u32> = keyed.into_iter().map(|(_, triangle)| triangle).collect();
        distinct.sort_unstable();
        distinct
    }

    /// The area of each triangle, mm².
    pub fn triangle_areas_mm2(&self) -> Vec<f64> {
        (0..self.triangles.len()).into_par_iter().map(|t| area(self.corners_mm(t))).collect()
    }

    /// Its whole area, mm².
    pub fn area_mm2(&self) -> f64 {
        self.triangle_areas_mm2().iter().sum()
    }

    /// The area about each node: a third of each triangle that touches it, mm².
    pub fn node_areas_mm2(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.nodes_mm.len()];
        for (triangle, area) in self.triangles.iter().zip(self.triangle_areas_mm2()) {
            for &node in triangle {
                areas[node as usize] += area / 3.0;
            }
        }
        areas
    }

    /// The unit normal of each triangle; zero for a degenerate one.
    pub fn triangle_normals(&self) -> Vec<DVec3> {
        let normal = |t| {
            let corners @ [a, b, c] = self.corners_mm(t);
            if has_no_area(corners) { DVec3::ZERO } else { (b - a).cross(c - a).normalize_or_zero() }
        };
        (0..self.triangles.len()).into_par_iter().map(normal).collect()
    }

    /// The unit normal at each node: its triangles' normals, each weighted by its angle there (the pseudo-normal of
    /// Bærentzen and Aanæs, *Signed distance computation using the angle weighted pseudonormal*, 2005); zero where they
    /// cancel or there are none.
    pub fn node_normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.nodes_mm.len()];
        let weighted = |(t, normal): (usize, DVec3)| -> [DVec3; 3] {
            let corners = self.corners_mm(t);
            std::array::from_fn(|k| {
                let [at, next, last] = [corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]];
                if normal == DVec3::ZERO { normal } else { normal * (next - at).angle_between(last - at) }
            })
        };
        let weighted: Vec<[DVec3; 3]> =
            self.triangle_normals().into_par_iter().enumerate().map(weighted).collect();
        for (nodes, weighted) in self.triangles.iter().zip(weighted) {
            nodes.iter().zip(weighted).for_each(|(&node, normal)| normals[node as usize] += normal);
        }
        normals.into_iter().map(DVec3::normalize_or_zero).collect()
    }
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

fn has_no_area(corners @ [a, b, c]: [DVec3; 3]) -> bool {
    let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
    area(corners) <= SMALLEST_AREA_RATIO * longest
}

fn has_three_nodes([a, b, c]: [u32; 3]) -> bool {
    a != b && b != c && c != a
}

/// All edges of triangles, sorted, so that those of neighbours follow each other.
fn edges(triangles: &[[u32; 3]]) -> Vec<Edge> {
    let of_triangle = |(t, nodes): (usize, &[u32; 3])| -> [Edge; 3] {
        std::array::from_fn(|k| {
            let next = (k + 1) % 3;
            let ([a, b], [p, q]) = ([nodes[k], nodes[next]], [k, next].map(|k| (3 * t + k) as u32));
            if a < b {
                Edge { nodes: [a, b], corners: [p, q] }
            } else {
                Edge { nodes: [b, a], corners: [q, p] }
            }
        })
    };
    let mut edges: Vec<Edge> = triangles.iter().enumerate().flat_map(of_triangle).collect();
    edges.par_sort_unstable();
    edges
}

/// The corners of so many triangles, in groups that the edges of a surface connect about a node.
fn fans(triangles: usize, edges: &[Edge]) -> Groups {
    let mut fans = Groups::new(3 * triangles);
    for pair in edges.windows(2).filter(|pair| pair[0].nodes == pair[1].nodes) {
        fans.join(pair[0].corners[0], pair[1].corners[0]);
        fans.join(pair[0].corners[1], pair[1].corners[1]);
    }
    fans
}

/// The corners at each node, in ascending order.
fn corners_of_nodes(nodes: usize, triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut of_nodes = vec![Vec::new(); nodes];
    (0..).zip(triangles.iter().flatten()).for_each(|(corner, &node)| of_nodes[node as usize].push(corner));
    of_nodes
}

/// Nodes joined into groups (union-find with path halving).
pub(crate) struct Groups {
    parent: Vec<u32>,
    joined: Vec<bool>,
}

impl Groups {
    pub(crate) fn new(nodes: usize) -> Self {
        Self { parent: (0..nodes as u32).collect(), joined: vec![false; nodes] }
    }

    /// The member that stands for the node's group: its lowest.
    pub(crate) fn root(&mut self, mut node: u32) -> u32 {
        while self.parent[node as usize] != node {
            let above = self.parent[self.parent[node as usize] as usize];
            self.parent[node as usize] = above;
            node = above;
        }
        node
    }

    pub(crate) fn join(&mut self, a: u32, b: u32) {
        self.joined[a as usize] = true;
        self.joined[b as usize] = true;
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    fn members(&self) -> usize {
        self.joined.iter().filter(|&&joined| joined).count()
    }

    fn count(&self) -> usize {
        let roots = self.parent.iter().enumerate().filter(|&(node, &parent)| node as u32 == parent);
        roots.filter(|&(node, _)| self.joined[node]).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn parts_that_touch_in_a_node_get_nodes_of_their_own() {
        let corners = |n: u32| (0..n).map(|k| DVec3::new(f64::from(k), f64::from(k * k % 7), 0.0)).collect();
        // Two fans about node 0, the second of them of two triangles.
        let surface = Surface {
            nodes_mm: corners(6),
            triangles: vec![[0, 1, 2], [0, 3, 4], [0, 4, 5]],
            arrays: Vec::new(),
        };
        let topology = surface.topology();
        assert_eq!((topology.non_manifold_nodes, topology.components), (1, 1));
        let split = surface.with_touching_parts_split();
        assert_eq!(split.triangles, [[0, 1, 2], [6, 3, 4], [6, 4, 5]]);
        let topology = split.topology();
        assert_eq!((topology.non_manifold_nodes, topology.components), (0, 2));
    }

    #[test]
    fn a_grid_with_holes_becomes_a_manifold_at_the_same_place() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
        let nodes_mm: Vec<DVec3> =
            (0..400).map(|k| DVec3::new(f64::from(k % 20), f64::from(k / 20), 0.0)).collect();
        let face = |k: u32| super::super::face_triangles(k, k + 1, k + 21, k + 20);
        let mut triangles: Vec<[u32; 3]> = (0..380).filter(|k| k % 20 < 19).flat_map(face).collect();
        triangles.retain(|_| rng.random::<f64>() < 0.6);
        let mut surface = Surface { nodes_mm, triangles, arrays: Vec::new() };
        surface.set_array("node", (0..400).map(f64::from).collect());
        assert!(surface.topology().non_manifold_nodes > 20);
        let split = surface.clone().with_touching_parts_split();
        assert_eq!(split.topology().non_manifold_nodes, 0);
        split.check().unwrap();
        let places = |surface: &Surface| -> Vec<[f64; 3]> {
            let node = surface.array("node").unwrap();
            surface.triangles.iter().map(|t| t.map(|n| node[n as usize])).collect()
        };
        assert_eq!(places(&split), places(&surface));
        assert_eq!(
            (0..split.triangles.len()).map(|t| split.corners_mm(t)).collect::<Vec<_>>(),
            (0..surface.triangles.len()).map(|t| surface.corners_mm(t)).collect::<Vec<_>>()
        );
        assert_eq!(split.clone().with_touching_parts_split(), split);
    }
}
