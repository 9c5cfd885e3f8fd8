use super::reconstruct::{lumen, print_report};
use super::settings::SettingsArguments;
use super::{Shown, print_json, progress};
use crate::evaluate::{Coverage, Evaluation, Truth, evaluate_covered};
use crate::output::write_atomically;
use crate::reconstruction::LumenReport;
use crate::report::render::{Style, render};
use crate::report::{PageContent, html};
use crate::settings::Settings;
use crate::simulate::{self, Insertion, Phantom, Shape, Simulation};
use crate::{Error, Result};
use serde::Serialize;
use std::path::PathBuf;

/// Reconstruct a built-in vessel: no input needed
///
/// Simulates a catheter on its way through an adult aorta (320 mm; tracker noise 0.3 mm and 0.5°, contour noise
/// 1 mm), reconstructs the lumen from that recording alone, and measures the result against the wall that was
/// simulated.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh demo
  lumenmesh demo --out /tmp/demo --seed 7 --method cylinders --nodes 24
  lumenmesh demo --json | jq .evaluation.mesh_to_truth.mean_mm")]
pub(super) struct Arguments {
    /// Folder to write to
    #[arg(long, value_name = "DIR", default_value = "lumenmesh-demo")]
    out: PathBuf,
    /// Seed of the noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: SettingsArguments,
}

#[derive(Serialize)]
struct Summary<'a> {
    seed: u64,
    files: Vec<Shown<'a>>,
    simulation: &'a simulate::SimulationSettings,
    settings: &'a Settings,
    reconstruction: LumenReport<'a>,
    evaluation: &'a Evaluation,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let settings = self.settings.settings()?;
        std::fs::create_dir_all(&self.out)
            .map_err(|source| Error::Write { path: self.out.clone(), source })?;
        let mut simulation_settings = simulate::SimulationSettings {
            insertion: Insertion::steady(),
            ..simulate::SimulationSettings::default()
        };
        simulation_settings.noise.seed = self.seed;

        let vessel = Phantom::from(Shape::Aorta).vessel()?;
        let bar = progress::bar("simulating", 0);
        let simulation = Simulation::run_and_tell(vessel, &simulation_settings, &|done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        })?;
        bar.finish_and_clear();
        let recording = &simulation.recording;

        let lumen = lumen(recording, &settings, true)?;
        let truth = Truth::new(simulation.vessel.surface().clone())?;
        let mut mesh = lumen.surface();
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let coverage = Coverage::of(recording, sensor_from_probe, truth.surface(), Coverage::WITHIN_MM)?;
        let evaluation = evaluate_covered(&mesh, &truth, &coverage)?;
        evaluation.colour(&mut mesh);

        let file = |name: &str| self.out.join(name);
        let style = Style { array: Some("error_mm".into()), ..Style::default() };
        recording.write(&file("recording.mat"))?;
        truth.surface().write(&file("truth.vtp"))?;
        mesh.write(&file("vessel.vtp"))?;
        render(&mesh, &style)?.write(&file("vessel.png"))?;
        let command = format!("lumenmesh demo --seed {}", self.seed);
        let content =
            PageContent::new("lumenmesh demo: a simulated adult aorta", recording, &lumen, &command)
                .with_truth(&truth, &evaluation);
        let page = html(&content)?;
        write_atomically(&file("report.html"), |out| out.write_all(page.as_bytes()))?;
        let files = ["recording.mat", "truth.vtp", "vessel.vtp", "vessel.png", "report.html", "summary.json"]
            .map(file)
            .to_vec();
        let summary = Summary {
            seed: self.seed,
            files: files.iter().map(|path| Shown(path)).collect(),
            simulation: &simulation_settings,
            settings: &settings,
            reconstruction: lumen.report(),
            evaluation: &evaluation,
        };
        write_atomically(&self.out.join("summary.json"), |out| {
            serde_json::to_writer_pretty(&mut *out, &summary)?;
            writeln!(out)
        })?;
        if self.json {
            return print_json(&summary);
        }

        println!(
            "simulated  {} frames in an adult aorta, seed {}: noise of {} mm and {}° on the poses, {} mm on the contours",
            recording.frames.len(),
            self.seed,
            simulation_settings.noise.position_sd_mm,
            simulation_settings.noise.rotation_sd_deg,
            simulation_settings.noise.contour_sd_mm
        );
        print_report(lumen.report());
        println!(
            "error      {:.3} mm mean distance from the mesh's nodes to the true wall (median {:.3}, 95 % below {:.3}, worst {:.3})",
            evaluation.mesh_to_truth.mean_mm,
            evaluation.mesh_to_truth.median_mm,
            evaluation.mesh_to_truth.p95_mm,
            evaluation.mesh_to_truth.max_mm
        );
        println!("wrote");
        for (path, what) in files.iter().zip([
            "what the probe saw (MATLAB, Octave)",
            "the true wall (ParaView)",
            "the reconstructed lumen with its error at every node (ParaView)",
            "a picture of it",
            "everything on one page (any browser)",
            "all numbers",
        ]) {
            println!("  {:<32} {what}", path.display());
        }
        Ok(())
    }
}
