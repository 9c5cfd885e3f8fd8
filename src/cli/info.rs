use super::conventions::ConventionArguments;
use crate::Result;
use crate::recording::{Conventions, Summary};
use std::path::PathBuf;

/// Show a summary of a recording
///
/// Frames that no reconstruction can use are listed and not refused: the first ten of each kind.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  lumenmesh info pullback.mat\n  lumenmesh info recording_folder --json\n  lumenmesh info pullback.mat --units m --time-unit ms"
)]
pub(super) struct Arguments {
    /// A .mat file (v4 to v7.3) or a folder with poses.csv and contours.csv
    recording: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    conventions: ConventionArguments,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let conventions = self.conventions.over(Conventions::default());
        let summary = Summary::of(&conventions.apply(&self.conventions.read(&self.recording)?));
        let text = if self.json {
            format!("{:#}\n", serde_json::json!(summary))
        } else {
            format!("{}\n{summary}", self.recording.display())
        };
        print!("{text}");
        Ok(())
    }
}
