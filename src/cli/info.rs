use super::conventions::ConventionArguments;
use crate::recording::{Conventions, Sequence, SequenceContents, Summary};
use crate::{Error, Result};
use std::path::PathBuf;

/// Show a summary of a recording
///
/// Frames that no reconstruction can use are listed and not refused: the first ten of each kind. Of a sequence file, it
/// also shows what transforms, times and images there are, and what the file lacks for a recording, if it lacks something.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh info pullback.mat
  lumenmesh info recording_folder --json
  lumenmesh info pullback.mat --units m --time-unit ms
  lumenmesh info tracker.igs.mha --transform ProbeToReference --contours contours.csv")]
pub(super) struct Arguments {
    /// A .mat file (v4 to v7.3), a folder with poses.csv and contours.csv, or a sequence file (.igs.mha, .igs.nrrd, …)
    recording: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    conventions: ConventionArguments,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let contents = Sequence::has_ending(&self.recording)
            .then(|| Sequence::read(&self.recording).map(|sequence| sequence.contents()))
            .transpose()?;
        let read = self.conventions.read(&self.recording);
        if let (Some(contents), Err(lacks)) = (&contents, &read) {
            return self.print_contents(contents, lacks);
        }
        let conventions = self.conventions.over(Conventions::default());
        let summary = Summary::of(&conventions.apply(&read?));
        if self.json {
            let mut value = serde_json::json!(summary);
            if let Some(contents) = contents {
                value["sequence"] = serde_json::json!(contents);
            }
            println!("{value:#}");
            return Ok(());
        }
        println!("{}", self.recording.display());
        contents.iter().for_each(|contents| print!("{contents}"));
        print!("{summary}");
        Ok(())
    }

    /// A sequence file that is no recording as it is.
    fn print_contents(&self, contents: &SequenceContents, lacks: &Error) -> Result<()> {
        match self.json {
            true => {
                let value = serde_json::json!({ "sequence": contents, "lacks": lacks.to_string() });
                println!("{value:#}");
            }
            false => print!("{}\n{contents}lacks           {lacks}\n", self.recording.display()),
        }
        Ok(())
    }
}
