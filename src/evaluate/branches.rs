//! Errors branch by branch, and where branches part.

use super::Distances;
use crate::surface::{Closest, Groups, Surface};
use glam::DVec3;
use serde::Serialize;

/// The truth is reproduced where the mesh is at most so far away, mm.
const NEAR_MM: f64 = 1.0;

/// The errors of a part of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PartErrors {
    /// Its nodes to the truth.
    pub mesh_to_truth: Distances,
    /// Mean signed distance of its nodes, mm; positive outside the truth.
    pub signed_mean_mm: f64,
    /// The covered nodes of the truth that are nearest to it; none without any.
    pub truth_to_mesh: Option<Distances>,
    /// Share of the area about these that lies within 1 mm of the mesh; none without any.
    pub within_1_mm: Option<f64>,
}

/// The errors of one branch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BranchErrors {
    /// Its number in the mesh's array `branch`.
    pub branch: u32,
    /// Its errors.
    #[serde(flatten)]
    pub errors: PartErrors,
}

/// What the parts of a mesh are measured from.
pub(super) struct Measured<'a> {
    pub mesh: &'a Surface,
    pub signed_error_mm: &'a [f64],
    /// Of each node of the truth: the nearest point of the mesh, and the covered area.
    pub back: &'a [Closest],
    pub covered_mm2: &'a [f64],
}

impl Measured<'_> {
    /// The errors of the branches, in ascending order, and of what lies about the partings; none where the mesh's array
    /// `branch` does not name two.
    pub(super) fn branches(&self) -> (Vec<BranchErrors>, Option<PartErrors>) {
        let Some(branch) = self.mesh.array("branch") else { return (Vec::new(), None) };
        let mut numbers: Vec<u32> = branch.iter().filter(|b| b.is_finite()).map(|b| *b as u32).collect();
        numbers.sort_unstable();
        numbers.dedup();
        if numbers.len() < 2 {
            return (Vec::new(), None);
        }
        let of_branch = |&number: &u32| {
            let errors = self.part(&|node| branch[node] == f64::from(number))?;
            Some(BranchErrors { branch: number, errors })
        };
        let about = about_partings(self.mesh, branch);
        (numbers.iter().filter_map(of_branch).collect(), self.part(&|node| about[node]))
    }

    /// The errors of the nodes that belong to a part, and of the truth that is nearest to them.
    fn part(&self, belongs: &dyn Fn(usize) -> bool) -> Option<PartErrors> {
        let own: Vec<f64> = (0..self.signed_error_mm.len())
            .filter(|&n| belongs(n))
            .map(|n| self.signed_error_mm[n])
            .collect();
        let sizes: Vec<f64> = own.iter().map(|e| e.abs()).collect();
        let mesh_to_truth = Distances::of(&sizes, &vec![1.0; sizes.len()])?;
        let nearest = |closest: &Closest| {
            let distance = |n: &u32| self.mesh.nodes_mm[*n as usize].distance_squared(closest.point_mm);
            let corners = self.mesh.triangles[closest.triangle as usize].into_iter();
            corners.min_by(|a, b| distance(a).total_cmp(&distance(b))).is_some_and(|n| belongs(n as usize))
        };
        let weights: Vec<f64> = self
            .back
            .iter()
            .zip(self.covered_mm2)
            .map(|(closest, &area)| if area > 0.0 && nearest(closest) { area } else { 0.0 })
            .collect();
        let distances: Vec<f64> = self.back.iter().map(|closest| closest.distance_mm).collect();
        let near: f64 = distances.iter().zip(&weights).filter(|(d, _)| **d <= NEAR_MM).map(|(_, w)| w).sum();
        let whole: f64 = weights.iter().sum();
        Some(PartErrors {
            mesh_to_truth,
            signed_mean_mm: own.iter().sum::<f64>() / own.len() as f64,
            truth_to_mesh: Distances::of(&distances, &weights),
            within_1_mm: (whole > 0.0).then(|| near / whole),
        })
    }
}

/// Of each node: whether it is nearer to the border between two branches than that border is wide, from its middle.
fn about_partings(mesh: &Surface, branch: &[f64]) -> Vec<bool> {
    let sides = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let border: Vec<[u32; 2]> =
        sides.filter(|[a, b]| a < b && branch[*a as usize] != branch[*b as usize]).collect();
    // Edges of one triangle belong to one border.
    let mut groups = Groups::new(mesh.nodes_mm.len());
    border.iter().for_each(|&[a, b]| groups.join(a, b));
    let mut borders: std::collections::BTreeMap<u32, Vec<DVec3>> = std::collections::BTreeMap::new();
    for &[a, b] in &border {
        let middle = mesh.nodes_mm[a as usize].midpoint(mesh.nodes_mm[b as usize]);
        borders.entry(groups.root(a)).or_default().push(middle);
    }
    let borders: Vec<(Vec<DVec3>, DVec3, f64)> = borders
        .into_values()
        .map(|points| {
            let middle = points.iter().sum::<DVec3>() / points.len() as f64;
            let radius = points.iter().map(|p| p.distance(middle)).sum::<f64>() / points.len() as f64;
            (points, middle, radius)
        })
        .collect();
    let is_about = |p: &DVec3| {
        borders.iter().any(|(points, middle, radius_mm)| {
            p.distance(*middle) < 4.0 * radius_mm && points.iter().any(|q| p.distance(*q) < *radius_mm)
        })
    };
    mesh.nodes_mm.iter().map(is_about).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Truth, evaluate};
    use crate::surface::Surface;
    use glam::DVec3;

    /// A flat strip of the given height, 20 mm by 6 mm, in cells of a millimetre.
    fn strip(z: impl Fn(f64) -> f64) -> Surface {
        let place = |i: i32, j: i32| DVec3::new(f64::from(i), f64::from(j), z(f64::from(i)));
        let node = |i: i32, j: i32| (i * 7 + j) as u32;
        let cell = |i: i32, j: i32| {
            let [a, b, c, d] = [node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1)];
            [[a, b, c], [a, c, d]]
        };
        Surface {
            nodes_mm: (0..21).flat_map(|i| (0..7).map(move |j| (i, j))).map(|(i, j)| place(i, j)).collect(),
            triangles: (0..20).flat_map(|i| (0..6).flat_map(move |j| cell(i, j))).collect(),
            arrays: Vec::new(),
        }
    }

    #[test]
    fn branches_have_their_own_errors() {
        let mut mesh = strip(|x| if x < 9.5 { 0.1 } else { 2.0 });
        let truth = Truth::new(strip(|_| 0.0)).unwrap();
        let whole = evaluate(&mesh, &truth).unwrap();
        assert!(whole.branches.is_empty() && whole.partings.is_none());
        let branch = mesh.nodes_mm.iter().map(|p| f64::from(u8::from(p.x > 9.5))).collect();
        mesh.set_array("branch", branch);
        let of = evaluate(&mesh, &truth).unwrap();
        let [first, second] = &of.branches[..] else { panic!("{:?}", of.branches) };
        assert_eq!((first.branch, first.errors.mesh_to_truth.nodes), (0, 70));
        assert_eq!((second.branch, second.errors.mesh_to_truth.nodes), (1, 77));
        assert!((first.errors.mesh_to_truth.mean_mm - 0.1).abs() < 1e-9);
        assert!((second.errors.mesh_to_truth.p95_mm - 2.0).abs() < 1e-9);
        assert!(first.errors.within_1_mm.unwrap() > 0.9 && second.errors.within_1_mm.unwrap() < 0.2);
        let partings = of.partings.unwrap();
        assert!((14..=35).contains(&partings.mesh_to_truth.nodes), "{partings:?}");
    }
}
