//! The fitting error: distances between a mesh and the truth.
//!
//! The thesis prints several "overall errors" without defining them. Here every number has its definition in
//! [`DEFINITIONS`], which the command prints in its help and its JSON.

mod branches;
mod coverage;
mod region;
mod systematic;
mod volume;

pub use crate::surface::{Closest, Locator};
pub use branches::{BranchErrors, PartErrors};
pub use coverage::Coverage;
pub use region::Region;
pub use systematic::SystematicErrors;
pub use volume::{Volumes, closed_volume_mm3};

use crate::surface::Surface;
use crate::{Error, Result};
use serde::Serialize;

/// What each number of an [`Evaluation`] means, by its name there.
pub const DEFINITIONS: [(&str, &str); 9] = [
    (
        "mesh_to_truth",
        "over the mesh's nodes, each counting once: distance to the nearest point of the truth's triangles; its mean is the fitting error",
    ),
    (
        "signed_mean_mm",
        "mean of the distances counted positive on the side that the truth's normals point to (outside), negative inside",
    ),
    (
        "median_mm, p95_mm",
        "nearest rank: the smallest distance that half, or 95 %, of the weight does not exceed",
    ),
    (
        "area_weighted_mean_mm",
        "mean over the mesh's nodes, each weighted by a third of the area of its triangles",
    ),
    (
        "truth_to_mesh",
        "over the truth's covered nodes, each weighted by a third of the area of its triangles: distance to the nearest point \
         of the mesh's triangles; covered_rule says which nodes are covered",
    ),
    ("hausdorff_mm", "the largest distance of both directions, the truth's covered nodes only"),
    (
        "regions",
        "the mesh's nodes by their nearest point on the truth's centreline, in stretches of it: as mesh_to_truth",
    ),
    (
        "branches, partings",
        "of a mesh with the node array branch: its nodes branch by branch, and those nearer to the border between two branches than \
         the border is wide from its middle; the covered truth that is nearest to them, and the share of its area within 1 mm",
    ),
    (
        "volumes",
        "inside mesh and truth, each opening closed by a fan about the mean of its rim's nodes; comparable only where both end \
         in the same places and have the same branches",
    ),
];

/// A surface to measure against.
pub struct Truth {
    surface: Surface,
    locator: Locator,
}

impl Truth {
    /// Prepares a surface; its normals should point out of the lumen.
    ///
    /// # Errors
    /// [`Error::Surface`] where an index is out of range, a node is not finite or no triangle has an area.
    pub fn new(surface: Surface) -> Result<Self> {
        let locator = Locator::new(&surface)?;
        Ok(Self { surface, locator })
    }

    /// The surface.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Finds the surface's closest points.
    pub fn locator(&self) -> &Locator {
        &self.locator
    }
}

/// Statistics of distances, mm, each with its weight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Distances {
    /// Number of nodes.
    pub nodes: usize,
    /// Mean.
    pub mean_mm: f64,
    /// Root of the mean square.
    pub rms_mm: f64,
    /// Median, by nearest rank.
    pub median_mm: f64,
    /// 95th percentile, by nearest rank.
    pub p95_mm: f64,
    /// Largest.
    pub max_mm: f64,
}

impl Distances {
    /// Statistics of unsigned distances and their weights; none where the weights sum to zero.
    ///
    /// A percentile is the smallest distance such that it and those below hold at least that share of the weight. Sums
    /// run in index order.
    pub fn of(distances_mm: &[f64], weights: &[f64]) -> Option<Self> {
        let mut pairs: Vec<(f64, f64)> =
            distances_mm.iter().copied().zip(weights.iter().copied()).filter(|&(_, w)| w > 0.0).collect();
        let total: f64 = pairs.iter().map(|(_, w)| w).sum();
        if pairs.is_empty() {
            return None;
        }
        let mean_of = |value: fn(f64) -> f64| pairs.iter().map(|&(d, w)| w * value(d)).sum::<f64>() / total;
        let (mean_mm, rms_mm) = (mean_of(|d| d), mean_of(|d| d * d).sqrt());
        // By weight too, so that equal distances always come in the same order.
        pairs.sort_unstable_by(|p, q| p.0.total_cmp(&q.0).then(p.1.total_cmp(&q.1)));
        let max_mm = pairs[pairs.len() - 1].0;
        let percentile = |share: f64| {
            let mut below = 0.0;
            let reached = pairs.iter().find(|(_, w)| {
                below += w;
                below >= share * total
            });
            reached.map_or(max_mm, |&(d, _)| d)
        };
        Some(Self {
            nodes: pairs.len(),
            mean_mm,
            rms_mm,
            median_mm: percentile(0.5),
            p95_mm: percentile(0.95),
            max_mm,
        })
    }
}

/// How far a mesh is from the truth. [`DEFINITIONS`] says what each number means.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Evaluation {
    /// The mesh's nodes to the truth; its mean is the fitting error.
    pub mesh_to_truth: Distances,
    /// Mean signed distance of the mesh's nodes, mm; positive outside the truth.
    pub signed_mean_mm: f64,
    /// Mean distance of the mesh's nodes, weighted by the area about them, mm.
    pub area_weighted_mean_mm: f64,
    /// The covered part of the truth to the mesh; none where the mesh covers nothing.
    pub truth_to_mesh: Option<Distances>,
    /// Share of the truth's area that is covered, 0 to 1.
    pub covered_area_share: f64,
    /// Which nodes of the truth are covered, in words.
    pub covered_rule: String,
    /// The largest distance of both directions, mm.
    pub hausdorff_mm: f64,
    /// The errors of each branch, where the mesh's array `branch` names several.
    pub branches: Vec<BranchErrors>,
    /// The errors about the partings of the branches.
    pub partings: Option<PartErrors>,
    /// Reasons to doubt these numbers, in words.
    pub warnings: Vec<String>,
    /// Distance of each mesh node, mm.
    #[serde(skip)]
    pub error_mm: Vec<f64>,
    /// Signed distance of each mesh node, mm; positive outside the truth.
    #[serde(skip)]
    pub signed_error_mm: Vec<f64>,
}

impl Evaluation {
    /// Sets the mesh's arrays `error_mm` and `signed_error_mm`.
    pub fn colour(&self, mesh: &mut Surface) {
        mesh.set_array("error_mm", self.error_mm.clone());
        mesh.set_array("signed_error_mm", self.signed_error_mm.clone());
    }
}

/// Measures a mesh against the truth. A node of the truth counts as covered where the mesh's nearest point is not on an
/// open rim; a side branch of the truth then counts as covered by the trunk beside it. [`evaluate_covered`] avoids this.
///
/// Nodes that no triangle uses count too: they are part of the reconstruction.
///
/// # Errors
/// [`Error::Surface`] where the mesh has an index out of range, a node that is not finite or no triangle with an area.
pub fn evaluate(mesh: &Surface, truth: &Truth) -> Result<Evaluation> {
    measure(mesh, truth, None)
}

/// Measures a mesh against the part of the truth that a recording covered.
///
/// # Errors
/// As [`evaluate`], and where `coverage` is that of another truth.
pub fn evaluate_covered(mesh: &Surface, truth: &Truth, coverage: &Coverage) -> Result<Evaluation> {
    let (found, expected) = (coverage.nodes.len(), truth.surface.nodes_mm.len());
    if found != expected {
        return Err(Error::Surface {
            what: "coverage".into(),
            found: format!("{found} nodes"),
            expected: format!("{expected}, those of the truth"),
        });
    }
    measure(mesh, truth, Some(coverage))
}

fn measure(mesh: &Surface, truth: &Truth, coverage: Option<&Coverage>) -> Result<Evaluation> {
    let mesh_locator = Locator::new(mesh)?;
    let forth = truth.locator.closest_all(&mesh.nodes_mm);
    let error_mm: Vec<f64> = forth.iter().map(|c| c.distance_mm).collect();
    let signed_error_mm: Vec<f64> = forth.iter().map(|c| c.signed_distance_mm).collect();
    let mesh_areas = mesh.node_areas_mm2();
    let no_distances = || Error::Surface {
        what: "nodes with an area".into(),
        found: "none".into(),
        expected: "at least one".into(),
    };
    let ones = vec![1.0; error_mm.len()];
    let mesh_to_truth = Distances::of(&error_mm, &ones).ok_or_else(no_distances)?;
    let by_area = Distances::of(&error_mm, &mesh_areas).ok_or_else(no_distances)?;

    let back = mesh_locator.closest_all(&truth.surface.nodes_mm);
    let truth_areas = truth.surface.node_areas_mm2();
    let is_covered = |node: usize| coverage.map_or(!back[node].on_rim, |coverage| coverage.nodes[node]);
    let covered: Vec<f64> =
        truth_areas.iter().enumerate().map(|(n, &area)| if is_covered(n) { area } else { 0.0 }).collect();
    let back_mm: Vec<f64> = back.iter().map(|c| c.distance_mm).collect();
    let truth_to_mesh = Distances::of(&back_mm, &covered);
    let parts =
        branches::Measured { mesh, signed_error_mm: &signed_error_mm, back: &back, covered_mm2: &covered };
    let (branches, partings) = parts.branches();
    Ok(Evaluation {
        hausdorff_mm: truth_to_mesh.map_or(0.0, |back| back.max_mm).max(mesh_to_truth.max_mm),
        mesh_to_truth,
        signed_mean_mm: signed_error_mm.iter().sum::<f64>() / signed_error_mm.len() as f64,
        area_weighted_mean_mm: by_area.mean_mm,
        truth_to_mesh,
        covered_area_share: covered.iter().sum::<f64>() / truth_areas.iter().sum::<f64>(),
        covered_rule: coverage.map_or_else(
            || "the nearest point of the mesh is not on an open rim of it".into(),
            |coverage| format!("a contour point of the recording lies within {} mm", coverage.within_mm),
        ),
        branches,
        partings,
        warnings: doubts(mesh, &truth.surface),
        error_mm,
        signed_error_mm,
    })
}

/// Reasons to doubt a comparison of the two, in words.
fn doubts(mesh: &Surface, truth: &Surface) -> Vec<String> {
    let mut doubts = Vec::new();
    if let (Some([low, high]), Some([truth_low, truth_high])) =
        (mesh.bounding_box_mm(), truth.bounding_box_mm())
    {
        let (size, truth_size) = (low.distance(high), truth_low.distance(truth_high));
        // Confused millimetres and metres give a factor of 1000; a mesh seldom spans less than a hundredth of its vessel.
        if size > 100.0 * truth_size || truth_size > 100.0 * size {
            doubts.push(format!(
                "the mesh spans {size:.4} mm and the truth {truth_size:.4} mm: are both in millimetres?"
            ));
        }
        if low.max(truth_low).cmpgt(high.min(truth_high)).any() {
            doubts.push(format!(
                "the bounding boxes do not touch: mesh {low:.1} to {high:.1}, truth {truth_low:.1} to {truth_high:.1} mm: are both \
                 in the same frame of reference?"
            ));
        }
    }
    for (name, surface) in [("truth", truth), ("mesh", mesh)] {
        let topology = surface.topology();
        let mut doubt = |count: usize, what: &str, effect: &str| {
            if count > 0 {
                doubts.push(format!("the {name} has {count} {what}: {effect}"));
            }
        };
        if name == "truth" {
            let sign = "the signs of distances near them mean nothing";
            doubt(topology.non_manifold_edges, "edges of three triangles or more", sign);
            doubt(topology.inconsistent_edges, "edges whose two triangles face opposite ways", sign);
        }
        doubt(topology.degenerate_triangles, "triangles without area", "they are left out");
        doubt(
            surface.nodes_mm.len() - topology.nodes,
            "nodes without a triangle",
            match name {
                "mesh" => "they count in the mean over nodes",
                _ => "they are left out",
            },
        );
    }
    doubts
}
