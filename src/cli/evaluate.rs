use crate::Result;

/// Measure the distance between a mesh and a truth surface
#[derive(clap::Args)]
pub(super) struct Arguments {}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        Ok(())
    }
}
