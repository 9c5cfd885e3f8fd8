use super::space::{SpaceArgument, axes};
use super::{Shown, print_json, refuse_inputs};
use crate::Result;
use crate::surface::{self, Surface};
use serde::Serialize;
use std::path::PathBuf;

/// Write a mesh in another format or in other axes
///
/// Node arrays are kept where both formats have them: VTP, PLY, MATLAB's .mat and, to read, VTK.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh convert vessel.vtp -o vessel.mat              # vertices, faces and arrays for MATLAB
  lumenmesh convert vessel.vtp -o vessel.stl --space lps")]
pub(super) struct Arguments {
    /// The mesh: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu
    mesh: PathBuf,
    /// The mesh to write: .vtp, .ply, .stl, .obj or .mat
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    #[command(flatten)]
    space: SpaceArgument,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Output<'a> {
    mesh: Shown<'a>,
    /// Which axes it states; null where it does not, and `ras` is assumed.
    mesh_space: Option<surface::Space>,
    output: Shown<'a>,
    nodes: usize,
    triangles: usize,
    arrays: Vec<&'a str>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        surface::check_ending(&self.output)?;
        refuse_inputs([Some(&*self.output)], [Some(&*self.mesh)])?;
        let (mesh, space) = Surface::read_with_space(&self.mesh)?;
        self.space.write(&mesh, &self.output)?;
        let arrays: Vec<&str> = mesh.arrays.iter().map(|array| array.name.as_str()).collect();
        if self.json {
            return print_json(&Output {
                mesh: Shown(&self.mesh),
                mesh_space: space,
                output: Shown(&self.output),
                nodes: mesh.nodes_mm.len(),
                triangles: mesh.triangles.len(),
                arrays,
            });
        }
        println!("read       {}, axes {}", self.mesh.display(), axes(space));
        println!("           {} nodes, {} triangles", mesh.nodes_mm.len(), mesh.triangles.len());
        println!("arrays     {}", if arrays.is_empty() { "none".into() } else { arrays.join(", ") });
        println!("wrote      {}", self.output.display());
        Ok(())
    }
}
