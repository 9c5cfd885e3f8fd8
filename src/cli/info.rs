use crate::Result;

/// Show what is in a recording
#[derive(clap::Args)]
pub(super) struct Arguments {}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        Ok(())
    }
}
