use crate::Result;

/// Turn a recording into a lumen mesh
#[derive(clap::Args)]
pub(super) struct Arguments {}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        Ok(())
    }
}
