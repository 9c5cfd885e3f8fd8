use super::space::{SpaceArgument, axes, can_carry_arrays};
use super::{Shown, print_json, read_screened, refuse_inputs};
use crate::evaluate::{
    Coverage, DEFINITIONS, Distances, Evaluation, PartErrors, Region, Truth, Volumes, evaluate,
    evaluate_covered,
};
use crate::settings::Settings;
use crate::simulate::Centreline;
use crate::surface::{Space, Surface};
use crate::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Measure the distance between a mesh and a truth surface
///
/// The fitting error is the mean distance from the mesh's nodes to the truth's triangles. Both files are in
/// millimetres and in the same frame of reference: nothing is registered.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES, after_long_help = examples_and_definitions())]
pub(super) struct Arguments {
    /// The mesh to measure: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu
    mesh: PathBuf,
    /// The surface to measure against; its normals point out of the lumen
    #[arg(long, value_name = "SURFACE")]
    truth: PathBuf,
    /// The recording behind the mesh: the truth near its contour points is what truth→mesh counts
    #[arg(long, value_name = "REC")]
    recording: Option<PathBuf>,
    /// How near a contour point must be, mm
    #[arg(long, value_name = "MM", default_value_t = Coverage::WITHIN_MM, requires = "recording")]
    covered_within: f64,
    /// Settings of the reconstruction: their calibration places the recording
    #[arg(long, value_name = "TOML", requires = "recording")]
    config: Option<PathBuf>,
    /// Centrelines of the truth: errors by stretches of one of them
    #[arg(long, value_name = "CSV")]
    centreline: Option<PathBuf>,
    /// Which of the centrelines, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0, requires = "centreline")]
    branch: usize,
    /// Length of a stretch, mm
    #[arg(long, value_name = "MM", default_value_t = 50.0, requires = "centreline")]
    region: f64,
    /// Write the mesh with its distances as node arrays error_mm and signed_error_mm: .vtp, .ply or .mat
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    space: SpaceArgument,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  lumenmesh evaluate mesh.vtp --truth aorta.stl
  lumenmesh evaluate mesh.ply --truth aorta.stl --out error.vtp   # open error.vtp in ParaView, colour by error_mm
  lumenmesh evaluate mesh.vtp --truth aorta.stl --recording pullback.mat --covered-within 2
  lumenmesh evaluate mesh.vtp --truth aorta.stl --centreline aorta_centreline.csv --region 50
  lumenmesh evaluate mesh.vtp --truth aorta.stl --json | jq .mesh_to_truth.mean_mm

Exit status: 0 measured (warnings included), 1 a file cannot be used, 2 wrong usage.";

fn examples_and_definitions() -> String {
    let define = |(name, definition)| format!("\n  {name}\n      {definition}");
    let definitions: String = DEFINITIONS.into_iter().map(define).collect();
    format!("{EXAMPLES}\n\nDefinitions, by the names in --json:{definitions}")
}

#[derive(Serialize)]
struct Report<'a> {
    mesh: Shown<'a>,
    truth: Shown<'a>,
    /// Which axes each file states; null where it does not, and `ras` is assumed.
    space: Spaces,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    volumes: Option<Volumes>,
    /// Why they are missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    no_volumes: Option<String>,
    regions: &'a [Region],
    definitions: BTreeMap<&'a str, &'a str>,
}

#[derive(Clone, Copy, Serialize)]
struct Spaces {
    mesh: Option<Space>,
    truth: Option<Space>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        if let Some(out) = &self.out {
            can_carry_arrays(out)?;
        }
        refuse_inputs(
            [self.out.as_deref()],
            [
                Some(&*self.mesh),
                Some(&*self.truth),
                self.recording.as_deref(),
                self.config.as_deref(),
                self.centreline.as_deref(),
            ],
        )?;
        let (mut mesh, mesh_space) = Surface::read_with_space(&self.mesh)?;
        let (truth, truth_space) = Surface::read_with_space(&self.truth)?;
        let space = Spaces { mesh: mesh_space, truth: truth_space };
        let truth = Truth::new(truth).map_err(|e| e.in_file(&self.truth))?;
        let evaluation = match self.coverage(&truth)? {
            Some(coverage) => evaluate_covered(&mesh, &truth, &coverage),
            None => evaluate(&mesh, &truth),
        };
        let evaluation = evaluation.map_err(|e| e.in_file(&self.mesh))?;
        let volumes = Volumes::of(&mesh, truth.surface());
        let regions = self.regions(&mesh, &evaluation)?;
        if let Some(out) = &self.out {
            evaluation.colour(&mut mesh);
            self.space.write(&mesh, out)?;
        }
        if self.json {
            let definitions = DEFINITIONS.into_iter().collect();
            let report = Report {
                mesh: Shown(&self.mesh),
                truth: Shown(&self.truth),
                space,
                evaluation: &evaluation,
                volumes: volumes.as_ref().ok().copied(),
                no_volumes: volumes.as_ref().err().map(Error::to_string),
                regions: &regions,
                definitions,
            };
            print_json(&report)?;
        } else {
            self.print(space, &evaluation, &volumes, &regions);
        }
        for warning in &evaluation.warnings {
            eprintln!("lumenmesh: warning: {warning}");
        }
        Ok(())
    }

    fn coverage(&self, truth: &Truth) -> Result<Option<Coverage>> {
        let Some(path) = &self.recording else {
            return Ok(None);
        };
        let settings = self.config.as_deref().map_or_else(|| Ok(Settings::default()), Settings::read_toml)?;
        let sensor_from_probe = settings.calibration.sensor_from_probe();
        let (recording, _) = read_screened(path, &settings)?;
        let coverage = Coverage::of(&recording, sensor_from_probe, truth.surface(), self.covered_within);
        coverage.map(Some).map_err(|e| e.in_file(&self.truth))
    }

    fn regions(&self, mesh: &Surface, evaluation: &Evaluation) -> Result<Vec<Region>> {
        let Some(path) = &self.centreline else {
            return Ok(Vec::new());
        };
        let branches = Centreline::read_branches(path)?;
        let Some(branch) = branches.get(self.branch) else {
            let expected = format!("below {}, the number of branches", branches.len());
            return Err(Error::input(path, "branch", self.branch, expected));
        };
        Region::along(&branch.every_mm(), self.region, &mesh.nodes_mm, &evaluation.signed_error_mm)
    }

    fn print(&self, space: Spaces, evaluation: &Evaluation, volumes: &Result<Volumes>, regions: &[Region]) {
        let forth = &evaluation.mesh_to_truth;
        println!("mesh   {}", self.mesh.display());
        println!("truth  {}", self.truth.display());
        println!("axes   of the mesh {}, of the truth {}", axes(space.mesh), axes(space.truth));
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
        println!("{:<22}{:>12.4}", "Hausdorff, mm", evaluation.hausdorff_mm);
        match volumes {
            Ok(v) => println!(
                "{:<22}{:>12.0}{:>12.0}  difference {:.0}",
                "volume, mm³", v.mesh_mm3, v.truth_mm3, v.difference_mm3
            ),
            Err(why) => println!("{:<22}not comparable: {why}", "volume, mm³"),
        }
        println!();
        // The rule by the rim counts a side branch without frames as covered, because the trunk's mesh is near it.
        let doubt = match self.recording {
            Some(_) => "",
            None => "; for branched vessels, --recording gives a better rule",
        };
        println!("truth→mesh counts nodes of the truth where {}{doubt}.", evaluation.covered_rule);
        if !evaluation.branches.is_empty() {
            println!();
            println!(
                "{:<22}{:>8}{:>10}{:>10}{:>10}{:>10}{:>16}",
                "branch by branch", "nodes", "mean", "95 %", "largest", "signed", "truth ≤ 1 mm"
            );
        }
        let part = |name: String, errors: &PartErrors| {
            let PartErrors { mesh_to_truth: d, signed_mean_mm, within_1_mm, .. } = errors;
            let near = within_1_mm.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share));
            println!(
                "{name:<22}{:>8}{:>10.4}{:>10.4}{:>10.4}{signed_mean_mm:>10.4}{near:>16}",
                d.nodes, d.mean_mm, d.p95_mm, d.max_mm
            );
        };
        evaluation.branches.iter().for_each(|of| part(format!("branch {}", of.branch), &of.errors));
        evaluation.partings.iter().for_each(|errors| part("about partings".into(), errors));
        if !regions.is_empty() {
            println!();
            println!(
                "{:<22}{:>8}{:>10}{:>10}{:>10}{:>10}{:>10}",
                "along the centreline", "nodes", "mean", "median", "95 %", "largest", "signed"
            );
        }
        for region in regions {
            let name = format!("{:.0} to {:.0} mm", region.from_mm, region.to_mm);
            match &region.mesh_to_truth {
                Some(d) => println!(
                    "{name:<22}{:>8}{:>10.4}{:>10.4}{:>10.4}{:>10.4}{:>10.4}",
                    d.nodes, d.mean_mm, d.median_mm, d.p95_mm, d.max_mm, region.signed_mean_mm
                ),
                None => println!("{name:<22}{:>8}", 0),
            }
        }
        if let Some(out) = &self.out {
            println!();
            println!("wrote {} with error_mm and signed_error_mm", out.display());
        }
    }
}
