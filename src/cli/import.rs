use crate::Result;

/// Turn other data into a recording
#[derive(clap::Args)]
pub(super) struct Arguments {}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        Ok(())
    }
}
