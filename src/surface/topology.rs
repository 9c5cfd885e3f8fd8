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

/// An edge of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Edge {
    /// In ascending order.
    nodes: [u32; 2],
    /// Whether the triangle runs along it from the lower node to the higher.
    is_upwards: bool,
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
            let corners = Corners::of_nodes(self.nodes_mm.len(), &whole);
            (0..self.nodes_mm.len()).into_par_iter().filter(|n| corners.fans(*n, &whole).len() > 1).count()
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
                        topology.inconsistent_edges += usize::from(p.is_upwards == q.is_upwards);
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
        let corners = Corners::of_nodes(self.nodes_mm.len(), &self.triangles);
        let touching =
            |node| Some((node, corners.fans(node, &self.triangles))).filter(|(_, fans)| fans.len() > 1);
        let touching: Vec<(usize, Vec<Vec<u32>>)> =
            (0..self.nodes_mm.len()).into_par_iter().filter_map(touching).collect();
        for (node, fans) in touching {
            for fan in fans.into_iter().skip(1) {
                let copy = self.nodes_mm.len() as u32;
                self.nodes_mm.push(self.nodes_mm[node]);
                self.arrays.iter_mut().for_each(|array| array.values.push(array.values[node]));
                for corner in fan {
                    self.triangles[corner as usize / 3][corner as usize % 3] = copy;
                }
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
        let mut keyed: Vec<([u32; 3], u32)> =
            self.triangles.par_iter().map(key).zip(0..self.triangles.len() as u32).collect();
        keyed.par_sort_unstable();
        let mut is_distinct = vec![true; keyed.len()];
        for same in keyed.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
            is_distinct[same[1].1 as usize] = false;
        }
        (0..).zip(is_distinct).filter(|(_, is)| *is).map(|(triangle, _)| triangle).collect()
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
    let of_triangle = |nodes: &[u32; 3]| -> [Edge; 3] {
        std::array::from_fn(|k| {
            let [a, b] = [nodes[k], nodes[(k + 1) % 3]];
            Edge { nodes: [a.min(b), a.max(b)], is_upwards: a < b }
        })
    };
    let mut edges: Vec<Edge> = triangles.par_iter().flat_map_iter(of_triangle).collect();
    edges.par_sort_unstable();
    edges
}

/// The corners of triangles at each node, in ascending order. Corner k of triangle t has the number 3 t + k.
struct Corners {
    /// Where those of each node begin, and the last end.
    starts: Vec<u32>,
    corners: Vec<u32>,
}

impl Corners {
    fn of_nodes(nodes: usize, triangles: &[[u32; 3]]) -> Self {
        let mut starts = vec![0; nodes + 1];
        triangles.iter().flatten().for_each(|&node| starts[node as usize + 1] += 1);
        for node in 0..nodes {
            starts[node + 1] += starts[node];
        }
        let (mut next, mut corners) = (starts.clone(), vec![0; 3 * triangles.len()]);
        for (corner, &node) in (0..).zip(triangles.iter().flatten()) {
            let place = &mut next[node as usize];
            corners[*place as usize] = corner;
            *place += 1;
        }
        Self { starts, corners }
    }

    fn at(&self, node: usize) -> &[u32] {
        &self.corners[self.starts[node] as usize..self.starts[node + 1] as usize]
    }

    /// The corners at a node, in groups that edges connect about it.
    fn fans(&self, node: usize, triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
        let corners = self.at(node);
        let beside = |corner: u32| {
            let (nodes, k) = (triangles[corner as usize / 3], corner as usize % 3);
            [nodes[(k + 1) % 3], nodes[(k + 2) % 3]]
        };
        let share_an_edge = |a: u32, b: u32| beside(a).iter().any(|node| beside(b).contains(node));
        let mut left = corners.to_vec();
        let mut fans: Vec<Vec<u32>> = Vec::new();
        while !left.is_empty() {
            let mut fan = vec![left.remove(0)];
            let mut reached = 0;
            while let Some(&corner) = fan.get(reached) {
                fan.extend(left.extract_if(.., |other| share_an_edge(corner, *other)));
                reached += 1;
            }
            fan.sort_unstable();
            fans.push(fan);
        }
        fans
    }
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
