use super::vessel::VesselArguments;
use super::{print_json, progress};
use crate::output::write_atomically;
use crate::report::{experiments_page, tables};
use crate::study::experiments::{DEFINITIONS, Plan, run};
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Repeat the thesis's experiments on a vessel of known geometry
///
/// One simulated insertion, with noise and without, is reconstructed by the published method and measured against
/// the wall: Tables 1 to 7 and Figures 29 to 36, every number that the thesis prints beside ours.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh experiments
  lumenmesh experiments --out results/
  lumenmesh experiments --vessel aorta.stl --centreline aorta_centreline.csv --out results/
  lumenmesh experiments --quick --json | jq .noisy.cylinder_spread

With --out the folder gets report.html (everything, self-contained), experiments.json (every number; the same seed
gives the same file on any number of threads), timings.json and the merged meshes with their errors.")]
pub(super) struct Arguments {
    #[command(flatten)]
    vessel: VesselArguments,
    /// Folder to write to; created if missing
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Only the first 60 mm, with fewer rays: a check, not for comparison
    #[arg(long)]
    quick: bool,
    /// Go through this branch of the vessel, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    branch: usize,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the numbers as JSON instead of tables
    #[arg(long)]
    json: bool,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let (name, vessel) = self.vessel.vessel(None)?;
        // The folder of the file is not part of the results.
        let name = Path::new(&name).file_name().map_or_else(|| name.clone(), |n| n.to_string_lossy().into());
        let mut plan = Plan::new(name, self.seed);
        plan.simulation.insertion.branch = self.branch;
        let plan = if self.quick { plan.quick() } else { plan };
        if let Some(folder) = &self.out {
            std::fs::create_dir_all(folder)
                .map_err(|source| Error::Write { path: folder.clone(), source })?;
        }

        let bar = progress::bar("simulating", 0);
        let outcome = run(vessel, &plan, &|stage, done, all| {
            bar.set_message(stage);
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        let outcome = outcome?;

        let mut written = Vec::new();
        if let Some(folder) = &self.out {
            let mut write = |name: &str, bytes: Vec<u8>| {
                let path = folder.join(name);
                write_atomically(&path, |w| w.write_all(&bytes))?;
                written.push(path);
                Ok::<_, Error>(())
            };
            write("experiments.json", json(folder, &outcome.experiments)?)?;
            write("timings.json", json(folder, &outcome.seconds)?)?;
            write("report.html", experiments_page(&outcome, &self.typed())?.into_bytes())?;
            for (name, mesh) in
                [("noiseless.vtp", &outcome.noiseless_mesh), ("noisy.vtp", &outcome.noisy_mesh)]
            {
                mesh.write(&folder.join(name))?;
                written.push(folder.join(name));
            }
        }
        if self.json {
            return print_json(&outcome.experiments);
        }
        let experiments = &outcome.experiments;
        let facts = &experiments.vessel;
        let mut text = format!(
            "vessel     {}: {} triangles, {:.0} mm\n",
            facts.name, facts.triangles, facts.branch_length_mm
        );
        for note in &facts.notes {
            text += &format!("           {note}\n");
        }
        text += &format!(
            "recording  {} frames, {} cylinders; seed {}\ntime       {:.1} s\n",
            experiments.noisy.frames,
            experiments.noisy.cylinder_frames.len(),
            self.seed,
            outcome.seconds.total
        );
        for table in tables(experiments) {
            text += &format!("\n{table}");
        }
        text += &format!("\n{}\n\n", crate::study::experiments::thesis::WHAT_DIFFERS);
        for (term, meaning) in DEFINITIONS {
            text += &format!("{term}\n    {meaning}\n");
        }
        for path in written {
            text += &format!("wrote {}\n", path.display());
        }
        print!("{}", text);
        Ok(())
    }

    /// The command without its output.
    fn typed(&self) -> String {
        let mut typed = format!("lumenmesh experiments{} --seed {}", self.vessel.typed(), self.seed);
        if self.branch > 0 {
            typed += &format!(" --branch {}", self.branch);
        }
        if self.quick {
            typed += " --quick";
        }
        typed + " --out results/"
    }
}

fn json(folder: &Path, value: &impl serde::Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec_pretty(value).map_err(|e| Error::Write { path: folder.into(), source: e.into() })
}
