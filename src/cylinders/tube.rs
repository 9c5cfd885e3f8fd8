//! The ring topology of a tube, which every engine shares (`docs/method.md`, "Local cylinder fit").

use crate::settings::Settings;

/// A tube of `levels + 1` rings of `nodes` nodes.
///
/// Node (ℓ, j) has index `ℓ·N + j`. Face (ℓ, j) has index `ℓ·N + j` too and two triangles: **bottom**
/// (a, b, b') with the face's index and **top** (a, b', a') with the face's index + number of faces, where
/// a = (ℓ, j), b = (ℓ, j+1), b' = (ℓ+1, j+1), a' = (ℓ+1, j). Ring ℓ lies at `z = -H/2 + ℓ·H/L`, node j at
/// `θ = 2πj/N`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tube {
    /// N: nodes per ring.
    pub nodes: usize,
    /// L: levels of faces.
    pub levels: usize,
    /// H: height, mm.
    pub height_mm: f64,
}

impl Tube {
    /// The tube that the settings ask for.
    pub fn new(settings: &Settings) -> Self {
        Self {
            nodes: settings.nodes as usize,
            levels: settings.levels as usize,
            height_mm: settings.height_mm,
        }
    }

    /// Number of faces, N·L.
    pub fn face_count(&self) -> usize {
        self.nodes * self.levels
    }

    /// Number of nodes, N·(L + 1).
    pub fn node_count(&self) -> usize {
        self.nodes * (self.levels + 1)
    }

    /// z of ring ℓ, mm.
    pub fn ring_z_mm(&self, ring: usize) -> f64 {
        -self.height_mm / 2.0 + self.height_mm * ring as f64 / self.levels as f64
    }

    /// θ of node j, rad.
    pub fn node_theta_rad(&self, node: usize) -> f64 {
        std::f64::consts::TAU * node as f64 / self.nodes as f64
    }

    /// The node after j on its ring.
    pub fn next(&self, node: usize) -> usize {
        if node + 1 == self.nodes { 0 } else { node + 1 }
    }

    /// The node before j on its ring.
    pub fn previous(&self, node: usize) -> usize {
        if node == 0 { self.nodes - 1 } else { node - 1 }
    }

    /// Edge neighbours of a face's bottom triangle, all of them top triangles, as face indices; the third is
    /// missing on the first level.
    pub fn bottom_neighbours(&self, face: usize) -> ([usize; 2], Option<usize>) {
        let (level, node) = (face / self.nodes, face % self.nodes);
        ([face, level * self.nodes + self.next(node)], face.checked_sub(self.nodes))
    }

    /// Edge neighbours of a face's top triangle, all of them bottom triangles, as face indices; the third is
    /// missing on the last level.
    pub fn top_neighbours(&self, face: usize) -> ([usize; 2], Option<usize>) {
        let (level, node) = (face / self.nodes, face % self.nodes);
        let above = (level + 1 < self.levels).then_some(face + self.nodes);
        ([face, level * self.nodes + self.previous(node)], above)
    }

    /// The triangles that meet in a node, in the order in which their values are summed: below it
    /// top(ℓ-1, j-1), bottom(ℓ-1, j-1), top(ℓ-1, j); above it bottom(ℓ, j-1), top(ℓ, j), bottom(ℓ, j).
    pub fn incident_triangles(&self, node: usize) -> impl Iterator<Item = usize> + use<> {
        let (ring, j) = (node / self.nodes, node % self.nodes);
        let (faces, before) = (self.face_count(), self.previous(j));
        let below = (ring > 0).then(|| {
            let row = (ring - 1) * self.nodes;
            [faces + row + before, row + before, faces + row + j]
        });
        let above = (ring < self.levels).then(|| {
            let row = ring * self.nodes;
            [row + before, faces + row + j, row + j]
        });
        below.into_iter().chain(above).flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};

    const TUBE: Tube = Tube { nodes: 5, levels: 3, height_mm: 9.0 };

    fn triangles() -> Vec<[usize; 3]> {
        let n = TUBE.nodes;
        let corners = |face: usize| {
            let (level, j) = (face / n, face % n);
            let k = TUBE.next(j);
            [level * n + j, level * n + k, (level + 1) * n + k, (level + 1) * n + j]
        };
        let bottom = (0..TUBE.face_count()).map(corners).map(|[a, b, c, _]| [a, b, c]);
        let top = (0..TUBE.face_count()).map(corners).map(|[a, _, c, d]| [a, c, d]);
        bottom.chain(top).collect()
    }

    #[test]
    fn neighbours_are_the_triangles_that_share_an_edge() {
        let mut by_edge: BTreeMap<[usize; 2], Vec<usize>> = BTreeMap::new();
        for (t, c) in triangles().iter().enumerate() {
            for (p, q) in [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])] {
                by_edge.entry([p.min(q), p.max(q)]).or_default().push(t);
            }
        }
        let mut expected = vec![BTreeSet::new(); 2 * TUBE.face_count()];
        for pair in by_edge.values().filter(|p| p.len() == 2) {
            expected[pair[0]].insert(pair[1]);
            expected[pair[1]].insert(pair[0]);
        }
        let faces = TUBE.face_count();
        for face in 0..faces {
            let (two, third) = TUBE.bottom_neighbours(face);
            let found: BTreeSet<usize> = two.into_iter().chain(third).map(|f| f + faces).collect();
            assert_eq!(found, expected[face]);
            let (two, third) = TUBE.top_neighbours(face);
            assert_eq!(two.into_iter().chain(third).collect::<BTreeSet<_>>(), expected[faces + face]);
        }
    }

    #[test]
    fn incident_triangles_are_those_that_have_the_node_as_a_corner() {
        let triangles = triangles();
        for node in 0..TUBE.node_count() {
            let found: Vec<usize> = TUBE.incident_triangles(node).collect();
            let expected: BTreeSet<usize> =
                (0..triangles.len()).filter(|&t| triangles[t].contains(&node)).collect();
            assert_eq!(found.len(), expected.len());
            assert_eq!(found.into_iter().collect::<BTreeSet<_>>(), expected);
        }
    }
}
