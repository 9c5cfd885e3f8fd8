use super::refuse_inputs;
use crate::Result;
use crate::cylinders::estimate::{CylinderEstimator, Upright};
use crate::geometry::Pose;
use crate::recording::{Pullback, PullbackOptions, PullbackPath, Summary};
use glam::DVec2;
use std::path::PathBuf;

/// Turn other data into a recording
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    source: Source,
}

#[derive(clap::Subcommand)]
enum Source {
    Pullback(PullbackArguments),
}

/// Import contours of an untracked pullback; poses are assumed along a line
///
/// The file has one line per wall point: frame number, x, y in the image and pullback position z, all in mm,
/// separated by tabs, semicolons, commas or blanks, with or without column names. Frames are sorted by z and
/// keep their numbers where these rise with it. The roll about the catheter was not measured and is assumed
/// constant.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  lumenmesh import pullback contours.csv -o pullback.mat --upright\n  \
    lumenmesh import pullback contours.csv -o pullback --centreline vessel.csv --centre 4.5,4.5\n  \
    lumenmesh import pullback points.txt -o pullback.mat --columns x_mm,y_mm,z_mm,frame")]
struct PullbackArguments {
    /// The contours
    contours: PathBuf,
    /// Where to write the recording: a .mat file, or a folder of CSV files
    #[arg(short, long)]
    output: PathBuf,
    /// Points x,y,z in mm along the vessel that the catheter follows [default: straight along z]
    #[arg(long, value_name = "FILE")]
    centreline: Option<PathBuf>,
    /// The probe in the image, mm [default: mean of the contours' centroids]
    #[arg(long, value_name = "X,Y", value_parser = point, allow_hyphen_values = true)]
    centre: Option<DVec2>,
    /// Names of the file's columns, where it has no line of them and they are not in this order
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    columns: Option<Vec<String>>,
    /// Give every frame a cylinder perpendicular to it, about its contour's centroid
    #[arg(long)]
    upright: bool,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

fn point(text: &str) -> Result<DVec2, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y] if x.is_finite() && y.is_finite() => Ok(DVec2::new(x, y)),
        _ => Err("expected two numbers with a comma between, such as 4.5,4.5".into()),
    }
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        match self.source {
            Source::Pullback(arguments) => arguments.run(),
        }
    }
}

impl PullbackArguments {
    fn run(self) -> Result<()> {
        refuse_inputs([Some(&*self.output)], [Some(&*self.contours), self.centreline.as_deref()])?;
        let centreline = self.centreline.as_deref().map(PullbackPath::read).transpose()?;
        let options = PullbackOptions::default()
            .with_centre_mm(self.centre)
            .with_centreline(centreline)
            .with_columns(self.columns);
        let mut pullback = Pullback::read(&self.contours, &options)?;
        if self.upright {
            let mut upright = Upright { sensor_from_probe: Pose::IDENTITY };
            pullback.recording.frames.iter_mut().for_each(|frame| frame.cylinder = upright.push(frame));
        }
        pullback.recording.write(&self.output)?;
        let summary = Summary::of(&pullback.recording);
        let roll = "not measured: held constant along the path";
        let text = if self.json {
            let result = serde_json::json!({
                "output": self.output.display().to_string(),
                "centre_mm": pullback.centre_mm.to_array(),
                "roll": roll,
                "frame_numbers": pullback.frame_numbers,
                "positions_mm": pullback.positions_mm,
                "summary": summary,
            });
            format!("{result:#}\n")
        } else {
            let numbers = pullback.frame_numbers.iter().zip(&pullback.positions_mm).enumerate();
            let numbers = numbers.map(|(k, (number, z))| format!("  {k}: {number}, {z:.3} mm\n"));
            let DVec2 { x, y } = pullback.centre_mm;
            format!(
                "{}\n{summary}probe origin    {x:.3}, {y:.3} mm in the image\nroll            {roll}\n\
                 frame: number in the file, pullback position\n{}",
                self.output.display(),
                numbers.collect::<String>()
            )
        };
        print!("{text}");
        Ok(())
    }
}
