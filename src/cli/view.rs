use super::{read_screened, refuse_inputs};
use crate::output::{ending, write_atomically};
use crate::report::viewer_page;
use crate::settings::Settings;
use crate::surface::Surface;
use crate::{Error, Result};
use std::path::PathBuf;

/// Write a page that shows a vessel in a browser: to turn, clip, fly through and measure it
///
/// The page is one file that needs neither a server nor a network. Wall that no echo supports is hatched, never in the
/// colours of measured wall. Press ? in the page for its keys.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh view vessel.vtp -o vessel.html
  lumenmesh view vessel.vtp pullback.mat -o vessel.html     # with the catheter's path and contours
  lumenmesh view aorta.stl -o aorta.html")]
pub(super) struct Arguments {
    /// The vessel: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu
    #[arg(value_name = "VESSEL")]
    mesh: PathBuf,
    /// Its recording: a .mat file, a folder of CSV files or a sequence file
    #[arg(value_name = "REC")]
    recording: Option<PathBuf>,
    /// The page to write: .html
    #[arg(short, long, value_name = "HTML")]
    output: PathBuf,
    /// Settings that the mesh was made with, as TOML: the probe's calibration is taken from there
    #[arg(long, value_name = "FILE", requires = "recording")]
    config: Option<PathBuf>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        if ending(&self.output) != "html" {
            let ending = ending(&self.output);
            return Err(Error::UnknownEnding { path: self.output, ending, expected: ".html" });
        }
        let inputs = [Some(&*self.mesh), self.recording.as_deref(), self.config.as_deref()];
        refuse_inputs([Some(&*self.output)], inputs)?;
        let surface = Surface::read(&self.mesh)?;
        let settings = match &self.config {
            Some(path) => Settings::read_toml(path)?,
            None => Settings::default(),
        };
        let recording = self.recording.as_deref().map(|path| read_screened(path, &settings)).transpose()?;
        let shown = recording.as_ref().map(|(rec, _)| (rec, settings.calibration.sensor_from_probe()));
        let title = self.mesh.file_name().unwrap_or(self.mesh.as_os_str()).to_string_lossy();
        let page = viewer_page(&title, &surface, shown);
        write_atomically(&self.output, |w| w.write_all(page.as_bytes()))?;
        println!("page       {}", self.output.display());
        Ok(())
    }
}
