use super::space::SpaceArgument;
use super::{Shown, print_json, refuse_inputs};
use crate::Result;
use crate::anatomy::{VesselAxis, VesselTree, check_axis_ending};
use crate::surface::Surface;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Find the axes of a vessel's branches, for VMTK, ParaView and 3D Slicer
///
/// The surface may be open or closed at its ends; it need not come from here. Arrays of the polylines: Abscissas (length
/// along the axis), MaximumInscribedSphereRadius (distance to the wall), CenterlineSectionArea, EquivalentRadius,
/// Curvature, Torsion, FrenetTangent, ParallelTransportNormals, BranchId, SectionClosed, BifurcationOf (the branch that leaves
/// the axis there).
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh axis vessel.vtp -o axis.vtp
  lumenmesh axis aorta.stl -o axis.vtp --json | jq .branches
  lumenmesh sections vessel.vtp --axis axis.vtp --step 0.5")]
pub(super) struct Arguments {
    /// The vessel: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu
    vessel: PathBuf,
    /// Polylines to write: .vtp
    #[arg(short, long, value_name = "VTP")]
    output: PathBuf,
    #[command(flatten)]
    space: SpaceArgument,
    /// Print the branches as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Branch {
    branch: usize,
    length_mm: f64,
    start_mm: [f64; 3],
    end_mm: [f64; 3],
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        check_axis_ending(&self.output)?;
        refuse_inputs([Some(&*self.output)], [Some(&*self.vessel)])?;
        let surface = Surface::read(&self.vessel)?.joined();
        let tree = VesselTree::of(&surface).map_err(|e| e.in_file(&self.vessel))?;
        tree.write(&surface, &self.output, self.space.name())?;
        let branch = |(branch, axis): (usize, &VesselAxis)| Branch {
            branch,
            length_mm: axis.length_mm(),
            start_mm: axis.pose(0.0).translation_mm.to_array(),
            end_mm: axis.pose(axis.length_mm()).translation_mm.to_array(),
        };
        let branches: Vec<Branch> = tree.axes.iter().enumerate().map(branch).collect();
        if self.json {
            return print_json(&serde_json::json!({
                "vessel": Shown(&self.vessel),
                "axis": Shown(&self.output),
                "branches": branches,
            }));
        }
        for Branch { branch, length_mm, start_mm, end_mm } in branches {
            let place = |p: [f64; 3]| p.map(|x| format!("{x:.1}")).join(", ");
            println!("branch {branch}   {length_mm:.1} mm from ({}) to ({})", place(start_mm), place(end_mm));
        }
        println!("axis       {}", self.output.display());
        Ok(())
    }
}

/// The axes of a vessel: those of a file, or found from the surface. The surface tells which branch a node is of in any
/// case, where it can.
pub(super) fn tree_of(surface: &Surface, vessel: &Path, axis: Option<&Path>) -> Result<VesselTree> {
    let found = VesselTree::of(surface).map_err(|e| e.in_file(vessel));
    let Some(path) = axis else { return found };
    let axes = VesselAxis::read(path)?;
    // The branches of another file's axes need not be those that are found: only one vessel without branches is sure.
    let mut tree = VesselTree::with_axes(axes, surface.nodes_mm.len());
    if let Ok(found) = found
        && found.axes.len() == tree.axes.len()
    {
        tree.node_branch = found.node_branch;
    }
    Ok(tree)
}
