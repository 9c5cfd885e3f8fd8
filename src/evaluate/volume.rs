//! The volume inside a surface whose openings are closed.

use crate::surface::Surface;
use crate::{Error, Result};
use glam::DVec3;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// The volumes inside a mesh and inside the truth, each with its openings closed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Volumes {
    /// Of the mesh, mm³.
    pub mesh_mm3: f64,
    /// Of the truth, mm³.
    pub truth_mm3: f64,
    /// Mesh less truth, mm³.
    pub difference_mm3: f64,
}

impl Volumes {
    /// The volumes of both.
    ///
    /// # Errors
    /// [`Error::Surface`] where one of them cannot be closed; it names which.
    pub fn of(mesh: &Surface, truth: &Surface) -> Result<Self> {
        let volume = |name: &str, surface: &Surface| {
            closed_volume_mm3(surface).map_err(|error| match error {
                Error::Surface { what, found, expected } => {
                    Error::Surface { what: format!("{name}: {what}"), found, expected }
                }
                other => other,
            })
        };
        let (mesh_mm3, truth_mm3) = (volume("mesh", mesh)?, volume("truth", truth)?);
        Ok(Self { mesh_mm3, truth_mm3, difference_mm3: mesh_mm3 - truth_mm3 })
    }
}

/// The volume inside a surface, mm³, each of its openings closed by a fan of triangles about the mean of its rim's
/// nodes. Positive where the normals point outwards.
///
/// # Errors
/// [`Error::Surface`] where it cannot be closed: indices out of range, no nodes, an edge that more than two triangles or
/// two triangles of opposite orientation share, or a rim that meets itself.
pub fn closed_volume_mm3(surface: &Surface) -> Result<f64> {
    surface.check()?;
    let fault = |what: String, found: &str, expected: &str| Error::Surface {
        what,
        found: found.into(),
        expected: expected.into(),
    };
    let Some(origin) = surface.nodes_mm.first() else {
        return Err(fault("nodes".into(), "none", "at least one"));
    };
    // About a node of its own, so that a vessel far from the origin loses no digits.
    let cone = |a: DVec3, b: DVec3, c: DVec3| (a - origin).dot((b - origin).cross(c - origin)) / 6.0;
    let mut edges: BTreeSet<(u32, u32)> = BTreeSet::new();
    let mut volume = 0.0;
    for triangle in surface.triangles.iter().filter(|[a, b, c]| a != b && b != c && c != a) {
        let [a, b, c] = *triangle;
        volume +=
            cone(surface.nodes_mm[a as usize], surface.nodes_mm[b as usize], surface.nodes_mm[c as usize]);
        for edge in [(a, b), (b, c), (c, a)] {
            if !edges.insert(edge) {
                return Err(fault(
                    format!("edge between nodes {} and {}", edge.0, edge.1),
                    "two triangles that run along it the same way",
                    "two triangles of the same orientation at most",
                ));
            }
        }
    }
    // The rim runs against the triangles.
    let mut next: BTreeMap<u32, u32> = BTreeMap::new();
    for &(a, b) in edges.iter().filter(|(a, b)| !edges.contains(&(*b, *a))) {
        if next.insert(b, a).is_some() {
            return Err(fault(format!("rim at node {b}"), "a rim that meets itself", "simple rims"));
        }
    }
    while let Some((&start, _)) = next.first_key_value() {
        let mut rim = vec![start];
        let mut at = start;
        while let Some(to) = next.remove(&at) {
            if to == start {
                break;
            }
            rim.push(to);
            at = to;
        }
        let nodes: Vec<DVec3> = rim.iter().map(|&n| surface.nodes_mm[n as usize]).collect();
        let middle = nodes.iter().sum::<DVec3>() / nodes.len() as f64;
        volume += (0..nodes.len()).map(|i| cone(nodes[i], nodes[(i + 1) % nodes.len()], middle)).sum::<f64>();
    }
    Ok(volume)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> Surface {
        Surface {
            nodes_mm: [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p + 300.0).to_vec(),
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
            arrays: Vec::new(),
        }
    }

    #[test]
    fn a_closed_surface_has_its_volume_and_an_opened_one_keeps_it() {
        let mut surface = tetrahedron();
        assert!((closed_volume_mm3(&surface).unwrap() - 1.0 / 6.0).abs() < 1e-12);
        for face in 0..4 {
            let mut open = surface.clone();
            open.triangles.remove(face);
            assert!((closed_volume_mm3(&open).unwrap() - 1.0 / 6.0).abs() < 1e-12, "{face}");
        }
        surface.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert!((closed_volume_mm3(&surface).unwrap() + 1.0 / 6.0).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_closed_is_said() {
        let mut turned = tetrahedron();
        turned.triangles[0].swap(0, 1);
        assert!(closed_volume_mm3(&turned).unwrap_err().to_string().contains("the same way"));
        let mut bow_tie = tetrahedron();
        bow_tie.nodes_mm.push(DVec3::ONE);
        bow_tie.triangles = vec![[0, 1, 2], [0, 3, 4]];
        assert!(closed_volume_mm3(&bow_tie).unwrap_err().to_string().contains("meets itself"));
    }
}
