use crate::Result;

/// Reconstruct a built-in vessel, no input needed
#[derive(clap::Args)]
pub(super) struct Arguments {}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        Ok(())
    }
}
