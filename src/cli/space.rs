use crate::surface::{Space, Surface};
use crate::{Error, Result};
use std::path::Path;

/// The axes of mesh files that are written.
#[derive(clap::Args)]
pub(super) struct SpaceArgument {
    /// Axes of the mesh file: those of the tracker, or with x and y negated, as DICOM has them. The file says which
    #[arg(long, value_enum, default_value_t)]
    space: Space,
}

impl SpaceArgument {
    /// The space, for messages.
    pub(super) fn name(&self) -> Space {
        self.space
    }

    pub(super) fn write(&self, surface: &Surface, path: &Path) -> Result<()> {
        surface.write_in(path, self.space)
    }
}

/// How a mesh file names its axes, for people.
pub(super) fn axes(space: Option<Space>) -> String {
    space.map_or_else(|| format!("not stated, taken as {}", Space::default()), |space| space.to_string())
}

/// Refuses a mesh file whose format carries no arrays.
pub(super) fn can_carry_arrays(path: &Path) -> Result<()> {
    match crate::output::ending(path).as_str() {
        "vtp" | "ply" | "mat" => Ok(()),
        ending => Err(Error::UnknownEnding {
            path: path.into(),
            ending: ending.into(),
            expected: ".vtp, .ply, .mat (which carry node arrays)",
        }),
    }
}
