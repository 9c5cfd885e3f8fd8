use super::live;
use super::settings::{SettingsArguments, hidden_if_not_live};
use super::space::SpaceArgument;
use crate::Result;
use std::path::PathBuf;
use std::process::ExitCode;

/// Replay a recording frame by frame into a growing vessel and report the time of each frame
///
/// The same as `lumenmesh live REC --speed max -o MESH`: as a program would do that shows the vessel during the
/// intervention, every frame updates the mesh.
#[derive(clap::Args)]
#[command(mut_args = hidden_if_not_live)]
#[command(after_help = "Examples:
  lumenmesh replay pullback.mat -o vessel.vtp
  lumenmesh replay pullback.mat -o vessel.vtp --method cylinders
  lumenmesh replay pullback.mat -o vessel.vtp --half-life 30 --real-time
  lumenmesh replay pullback.mat -o vessel.vtp --json | jq .push_ms.p99")]
pub(super) struct Arguments {
    /// Recording: a MATLAB .mat file (v4 to v7.3), a folder of CSV files or a sequence file (.igs.mha, .igs.nrrd, …)
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Mesh to write after the last frame: .vtp, .ply, .stl, .obj or .mat
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    #[command(flatten)]
    space: SpaceArgument,
    /// Wait for each frame's time; 12 frames per second where they have none
    #[arg(long)]
    real_time: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: SettingsArguments,
}

impl Arguments {
    pub(super) fn run(self) -> Result<ExitCode> {
        let Self { recording, output, space, real_time, json, settings } = self;
        let speed = if real_time { live::Speed::Times(1.0) } else { live::Speed::Max };
        live::Arguments::replay(recording, output, space, speed, json, settings).run()
    }
}
