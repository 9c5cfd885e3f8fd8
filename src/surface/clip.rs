//! Parts of a surface.

use super::Surface;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// A cut through an edge lies so far from both of its nodes at least, as a share of the edge: no triangle loses its area.
const LEAST_SHARE: f64 = 0.05;

impl Surface {
    /// The triangles that `keeps` chooses by their nodes, with the nodes that they use and no arrays; and which node of this
    /// surface each of them is.
    pub(crate) fn part(&self, mut keeps: impl FnMut([u32; 3]) -> bool) -> (Self, Vec<u32>) {
        let mut number: HashMap<u32, u32> = HashMap::new();
        let (mut part, mut original) = (Self::default(), Vec::new());
        for &triangle in self.triangles.iter().filter(|t| keeps(**t)) {
            part.triangles.push(triangle.map(|n| {
                *number.entry(n).or_insert_with(|| {
                    original.push(n);
                    part.nodes_mm.push(self.nodes_mm[n as usize]);
                    (original.len() - 1) as u32
                })
            }));
        }
        (part, original)
    }

    /// The part where a value of its nodes is positive, cut through the edges at which the value is 0. It has all nodes of
    /// this surface, then those of the cuts, and no arrays.
    pub(crate) fn clipped(&self, value: &[f64]) -> Self {
        let mut part = Self { nodes_mm: self.nodes_mm.clone(), ..Self::default() };
        let mut cuts: HashMap<(u32, u32), u32> = HashMap::new();
        for &triangle in &self.triangles {
            let is_in = triangle.map(|n| value[n as usize] > 0.0);
            let mut cut = |a: u32, b: u32| {
                *cuts.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    let (low, high) = (a.min(b), a.max(b));
                    let [p, q] = [low, high].map(|n| value[n as usize]);
                    let share = (p / (p - q)).clamp(LEAST_SHARE, 1.0 - LEAST_SHARE);
                    part.nodes_mm.push(self.nodes_mm[low as usize].lerp(self.nodes_mm[high as usize], share));
                    (part.nodes_mm.len() - 1) as u32
                })
            };
            let turned = |k: usize| [triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]];
            match is_in.iter().filter(|&&x| x).count() {
                3 => part.triangles.push(triangle),
                1 => {
                    let [a, b, c] = turned(is_in.iter().position(|&x| x).unwrap_or(0));
                    let (ab, ac) = (cut(a, b), cut(a, c));
                    part.triangles.push([a, ab, ac]);
                }
                2 => {
                    let [a, b, c] = turned(is_in.iter().position(|&x| !x).unwrap_or(0));
                    let (ab, ac) = (cut(a, b), cut(a, c));
                    part.triangles.extend([[ab, b, c], [ab, c, ac]]);
                }
                _ => {}
            }
        }
        part
    }

    /// The closed curves of its border, each along its triangles' direction.
    pub(crate) fn rims(&self) -> Vec<Vec<u32>> {
        let sides = || self.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let all: BTreeSet<(u32, u32)> = sides().collect();
        let next: BTreeMap<u32, u32> =
            all.iter().filter(|(a, b)| !all.contains(&(*b, *a))).copied().collect();
        let mut seen = BTreeSet::new();
        let mut rims = Vec::new();
        for &start in next.keys() {
            let (mut rim, mut here) = (Vec::new(), start);
            while seen.insert(here) {
                rim.push(here);
                match next.get(&here) {
                    Some(&next) => here = next,
                    None => break,
                }
            }
            if rim.len() > 2 && here == start {
                rims.push(rim);
            }
        }
        rims
    }

    /// Of each node: those that it shares a triangle with, ascending.
    pub(crate) fn neighbours(&self) -> Vec<Vec<u32>> {
        let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); self.nodes_mm.len()];
        for &[a, b, c] in &self.triangles {
            for (node, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
                neighbours[node as usize].extend(others);
            }
        }
        neighbours.iter_mut().for_each(|of| {
            of.sort_unstable();
            of.dedup();
        });
        neighbours
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// A square of so many cells a side, in the plane z = 0.
    fn square(cells: u32) -> Surface {
        let node = |i: u32, j: u32| i * (cells + 1) + j;
        let corners = (0..=cells).flat_map(|i| (0..=cells).map(move |j| (i, j)));
        let cell = |i: u32, j: u32| {
            let [a, b, c, d] = [node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1)];
            [[a, b, c], [a, c, d]]
        };
        Surface {
            nodes_mm: corners.map(|(i, j)| DVec3::new(f64::from(i), f64::from(j), 0.0)).collect(),
            triangles: (0..cells).flat_map(|i| (0..cells).flat_map(move |j| cell(i, j))).collect(),
            arrays: Vec::new(),
        }
    }

    #[test]
    fn a_disc_is_cut_out_of_a_square() {
        let square = square(40);
        let inside = |p: &DVec3| 15.3 - p.distance(DVec3::new(20.0, 20.0, 0.0));
        let value: Vec<f64> = square.nodes_mm.iter().map(inside).collect();
        let disc = square.clipped(&value);
        let area_mm2 = std::f64::consts::PI * 15.3 * 15.3;
        assert!((disc.area_mm2() / area_mm2 - 1.0).abs() < 0.01, "{}", disc.area_mm2());
        let rims = disc.rims();
        assert_eq!(rims.len(), 1);
        assert!(rims[0].iter().all(|&n| inside(&disc.nodes_mm[n as usize]).abs() < 0.1));
        // What is left has a second rim, and both parts have the whole area.
        let rest = square.clipped(&value.iter().map(|v| -v).collect::<Vec<_>>());
        assert_eq!(rest.rims().len(), 2);
        assert!((rest.area_mm2() + disc.area_mm2() - 1600.0).abs() < 1e-9);
    }

    #[test]
    fn a_part_has_its_own_nodes() {
        let square = square(3);
        let (part, original) = square.part(|t| t.contains(&0));
        assert_eq!((part.triangles.len(), part.nodes_mm.len()), (2, 4));
        for (p, &n) in part.nodes_mm.iter().zip(&original) {
            assert_eq!(*p, square.nodes_mm[n as usize]);
        }
        assert_eq!(square.neighbours()[0], [1, 4, 5]);
    }
}
