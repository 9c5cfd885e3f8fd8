use crate::evaluate::{DEFINITIONS, Distances, Evaluation, Truth, evaluate};
use crate::surface::Surface;
use crate::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Measure the distance between a mesh and a truth surface
///
/// The fitting error is the mean distance from the mesh's nodes to the truth's triangles. Both files are in
/// millimetres and in the same frame of reference: nothing is registered.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The mesh to measure: .vtp, .ply, .stl or .obj
    mesh: PathBuf,
    /// The surface to measure against; its normals point out of the lumen
    #[arg(long, value_name = "SURFACE")]
    truth: PathBuf,
    /// Write the mesh with its distances as node arrays error_mm and signed_error_mm: .vtp or .ply
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  lumenmesh evaluate mesh.vtp --truth aorta.stl
  lumenmesh evaluate mesh.ply --truth aorta.stl --out error.vtp   # open error.vtp in ParaView, colour by error_mm
  lumenmesh evaluate mesh.vtp --truth aorta.stl --json | jq .mesh_to_truth.mean_mm

Exit status: 0 measured (warnings included), 1 a file cannot be used, 2 wrong usage.";

#[derive(Serialize)]
struct Report<'a> {
    mesh: &'a Path,
    truth: &'a Path,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    definitions: BTreeMap<&'a str, &'a str>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        if let Some(out) = &self.out {
            can_carry_arrays(out)?;
        }
        let mut mesh = Surface::read(&self.mesh)?;
        let truth = Truth::new(Surface::read(&self.truth)?).map_err(|e| in_file(e, &self.truth))?;
        let evaluation = evaluate(&mesh, &truth).map_err(|e| in_file(e, &self.mesh))?;
        if let Some(out) = &self.out {
            evaluation.colour(&mut mesh);
            mesh.write(out)?;
        }
        if self.json {
            let definitions = DEFINITIONS.into_iter().collect();
            let report =
                Report { mesh: &self.mesh, truth: &self.truth, evaluation: &evaluation, definitions };
            let text = serde_json::to_string_pretty(&report)
                .map_err(|e| Error::Write { path: "standard output".into(), source: e.into() })?;
            println!("{text}");
        } else {
            self.print(&evaluation);
        }
        for warning in &evaluation.warnings {
            eprintln!("lumenmesh: warning: {warning}");
        }
        Ok(())
    }

    fn print(&self, evaluation: &Evaluation) {
        let forth = &evaluation.mesh_to_truth;
        println!("mesh   {}", self.mesh.display());
        println!("truth  {}", self.truth.display());
        println!();
        println!("fitting error  {:.4} mm", forth.mean_mm);
        println!("               the mean distance from the mesh's nodes to the truth's triangles");
        println!();
        println!("{:<22}{:>12}{:>12}", "", "mesh→truth", "truth→mesh");
        let back = evaluation.truth_to_mesh.as_ref();
        let row = |name: &str, value: fn(&Distances) -> String| {
            let back = back.map_or_else(|| "-".into(), value);
            println!("{name:<22}{:>12}{back:>12}", value(forth));
        };
        row("mean, mm", |d| format!("{:.4}", d.mean_mm));
        row("rms, mm", |d| format!("{:.4}", d.rms_mm));
        row("median, mm", |d| format!("{:.4}", d.median_mm));
        row("95th percentile, mm", |d| format!("{:.4}", d.p95_mm));
        row("largest, mm", |d| format!("{:.4}", d.max_mm));
        row("nodes", |d| d.nodes.to_string());
        println!("{:<22}{:>12.4}", "signed mean, mm", evaluation.signed_mean_mm);
        println!("{:<22}{:>12.4}", "mean by area, mm", evaluation.area_weighted_mean_mm);
        println!("{:<22}{:>12}{:>11.1}%", "truth area covered", "", 100.0 * evaluation.covered_area_share);
        println!();
        for (name, definition) in DEFINITIONS {
            println!("{name}\n    {definition}");
        }
        if let Some(out) = &self.out {
            println!();
            println!("wrote {} with error_mm and signed_error_mm", out.display());
        }
    }
}

fn can_carry_arrays(out: &Path) -> Result<()> {
    match crate::output::ending(out).as_str() {
        "vtp" | "ply" => Ok(()),
        ending => Err(Error::UnknownEnding {
            path: out.into(),
            ending: ending.into(),
            expected: ".vtp, .ply (which carry node arrays)",
        }),
    }
}

fn in_file(error: Error, path: &Path) -> Error {
    match error {
        Error::Surface { what, found, expected } => Error::input(path, what, found, expected),
        other => other,
    }
}
