use crate::output;
use crate::simulate::{Centreline, Phantom, Shape, SimulatedVessel};
use crate::surface::Surface;
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// The vessel to simulate in.
#[derive(clap::Args)]
pub(super) struct VesselArguments {
    /// A phantom (aorta, cylinder, frustum, arch, small_arch, stenosis, aneurysm, ellipse,
    /// bifurcation, side_branch, tree, deep_tree) or a surface file in mm
    /// (.vtp, .ply, .stl, .obj, .vtk, .vtu) [default: aorta]
    #[arg(long, value_name = "NAME|SURFACE")]
    vessel: Option<String>,
    /// Centrelines of a surface file: CSV with branch, x_mm, y_mm, z_mm, r_inscribed_mm
    #[arg(long, value_name = "CSV")]
    centreline: Option<PathBuf>,
}

impl VesselArguments {
    /// The files that are read.
    pub(super) fn inputs(&self) -> [Option<&Path>; 2] {
        [self.vessel.as_deref().map(Path::new), self.centreline.as_deref()]
    }

    /// The vessel and its name. The flag takes precedence over a configured phantom.
    pub fn vessel(&self, configured: Option<Phantom>) -> Result<(String, SimulatedVessel)> {
        let flag = self.vessel.as_deref();
        match flag.map(Path::new) {
            Some(path) if !output::ending(path).is_empty() => {
                let Some(centreline) = &self.centreline else {
                    return Err(Error::Setting {
                        name: "--centreline".into(),
                        found: "none".into(),
                        expected: format!("the centrelines of {}", path.display()),
                    });
                };
                let surface = Surface::read(path)?;
                let vessel = SimulatedVessel::new(surface, Centreline::read_branches(centreline)?)?;
                Ok((path.display().to_string(), vessel))
            }
            _ => {
                if self.centreline.is_some() {
                    return Err(Error::Setting {
                        name: "--centreline".into(),
                        found: "a phantom, which has its own".into(),
                        expected: "--vessel SURFACE".into(),
                    });
                }
                let phantom = match (flag, configured) {
                    (None, Some(phantom)) => phantom,
                    (None, None) => Shape::Aorta.into(),
                    (Some(name), configured) => {
                        let phantom = Phantom::from(name.parse::<Shape>()?);
                        Phantom { edge_mm: configured.map_or(phantom.edge_mm, |c| c.edge_mm), ..phantom }
                    }
                };
                Ok((format!("{} phantom", phantom.shape.name()), phantom.vessel()?))
            }
        }
    }

    /// The flags as they were typed.
    pub fn typed(&self) -> String {
        let vessel = self.vessel.iter().map(|vessel| format!(" --vessel {vessel}"));
        let centreline = self.centreline.iter().map(|path| format!(" --centreline {}", path.display()));
        vessel.chain(centreline).collect()
    }
}
