use super::reconstruct::{lumen, print_mouths, print_report, print_screening};
use super::settings::SettingsArguments;
use super::{Shown, print_json, refuse_inputs};
use crate::evaluate::{Coverage, Truth, evaluate_covered};
use crate::output::{ending, write_atomically};
use crate::recording::Screened;
use crate::report::{PageContent, html};
use crate::surface::Surface;
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Reconstruct a recording and show how well it went, as one HTML page
///
/// The page is one file that needs no network: summary, error distribution, the vessel in colours from three
/// sides and to turn, coverage, noise, settings.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh report pullback.mat -o report.html
  lumenmesh report recording/ --truth wall.vtp -o report.html --method cylinders --nodes 24")]
pub(super) struct Arguments {
    /// Recording: a MATLAB .mat file (v4 to v7.3), a folder of CSV files or a sequence file (.igs.mha, .igs.nrrd, …)
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// The vessel's wall, where it is known: the page then shows errors
    #[arg(long, value_name = "SURFACE")]
    truth: Option<PathBuf>,
    /// Page to write: .html
    #[arg(short, long, value_name = "HTML")]
    output: PathBuf,
    /// Print the numbers as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: SettingsArguments,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let settings = self.settings.settings()?;
        check_page_ending(&self.output)?;
        refuse_inputs(
            [Some(&*self.output)],
            [Some(&*self.recording), self.truth.as_deref()].into_iter().chain(self.settings.inputs()),
        )?;
        let recording = self.settings.read(&self.recording)?;
        let truth = self.truth.as_deref().map(|path| Truth::new(Surface::read(path)?)).transpose()?;
        let lumen = lumen(&recording, &settings, truth.is_some()).map_err(|e| e.in_file(&self.recording))?;
        let evaluation = truth
            .as_ref()
            .map(|truth| {
                let screened = Screened::of(&recording, &settings.conventions, settings.unfit_frames)?;
                let sensor_from_probe = settings.calibration.sensor_from_probe();
                let coverage = Coverage::of(
                    &screened.recording,
                    sensor_from_probe,
                    truth.surface(),
                    Coverage::WITHIN_MM,
                )?;
                evaluate_covered(&lumen.surface(), truth, &coverage)
            })
            .transpose()?;
        let (title, command) = (format!("Reconstruction of {}", name_of(&self.recording)), typed());
        let mut content = PageContent::new(&title, &recording, &lumen, &command);
        if let Some((truth, evaluation)) = truth.as_ref().zip(evaluation.as_ref()) {
            content = content.with_truth(truth, evaluation);
        }
        let page = html(&content)?;
        write_atomically(&self.output, |w| w.write_all(page.as_bytes()))?;
        if self.json {
            return print_json(&serde_json::json!({
                "recording": Shown(&self.recording),
                "page": Shown(&self.output),
                "screening": lumen.screening(),
                "report": lumen.report(),
                "evaluation": evaluation,
            }));
        }
        print_report(lumen.report());
        print_mouths(lumen.mouths());
        print_screening(lumen.screening());
        if let Some(evaluation) = &evaluation {
            println!("error      {:.4} mm (mean, nodes to truth)", evaluation.mesh_to_truth.mean_mm);
        }
        println!("page       {}", self.output.display());
        Ok(())
    }
}

/// Refuses a file name that is not that of a page.
pub(super) fn check_page_ending(path: &Path) -> Result<()> {
    match ending(path).as_str() {
        "html" => Ok(()),
        ending => Err(Error::UnknownEnding { path: path.into(), ending: ending.into(), expected: ".html" }),
    }
}

/// A file's name, for a page.
pub(super) fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// The command as it was typed.
pub(super) fn typed() -> String {
    let arguments = std::env::args_os().skip(1).map(|a| a.to_string_lossy().into_owned());
    let quoted = arguments.map(|a| if a.contains(' ') { format!("'{a}'") } else { a });
    std::iter::once("lumenmesh".into()).chain(quoted).collect::<Vec<String>>().join(" ")
}
