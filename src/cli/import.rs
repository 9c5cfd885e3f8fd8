use super::conventions::ConventionArguments;
use super::mask_options::MaskOptionArguments;
use super::{print_json, refuse_inputs};
use crate::Result;
use crate::cylinders::estimate::{CylinderEstimator, Upright};
use crate::geometry::Pose;
use crate::recording::{Conventions, Curves, Masks, Pullback, PullbackOptions, PullbackPath, Summary};
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
    Mask(MaskArguments),
    Curves(CurveArguments),
    Recording(RecordingArguments),
}

/// Import images of the lumen, one for each frame: outlines become the contours
///
/// The file is a sequence of PLUS, IGSIO or 3D Slicer with tracked masks or probabilities, such as the segmentation that a
/// network sends. The contour is the outline of the region about the probe, at the threshold, between pixels; where the image's
/// edge cuts the region, there are no echoes. ImageToProbe comes from the file, from a PLUS configuration, or from the size of
/// a pixel. Frames without a pose are left out.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh import mask segmented.igs.mha -o pullback.mat --plus-config PlusDeviceSet.xml
  lumenmesh import mask segmented.igs.mha -o pullback.igs.mha --pixel-size 0.05 --centre 255.5,255.5
  lumenmesh import mask probability.igs.nrrd -o pullback.mat --pixel-size 0.05 --threshold 128 \\
      --transform ProbeToReference")]
struct MaskArguments {
    /// The images: .igs.mha, .igs.mhd, .seq.mha, .igs.nrrd or .seq.nrrd
    images: PathBuf,
    /// Where to write the recording: a .mat or sequence file, or a folder of CSV files
    #[arg(short, long)]
    output: PathBuf,
    #[command(flatten)]
    mask: MaskOptionArguments,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: ConventionArguments,
}

/// Import closed curves that were drawn in 3D Slicer, one for each frame
///
/// Files are Slicer's markups (.mrk.json), in the order along the vessel; each closed curve becomes a frame. Poses are
/// those of the planes that fit the curves, so that no tracker is needed.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh import curves lumen_*.mrk.json -o drawn.mat")]
struct CurveArguments {
    /// Markups with closed curves
    #[arg(required = true)]
    curves: Vec<PathBuf>,
    /// Where to write the recording: a .mat or sequence file, or a folder of CSV files
    #[arg(short, long)]
    output: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

/// Write a recording in another format, or in this project's conventions
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh import recording pullback.mat -o pullback.igs.mha        # for PLUS and 3D Slicer
  lumenmesh import recording tracker.igs.mha -o pullback.mat --transform ProbeToReference --contours contours.csv
  lumenmesh import recording pullback.mat -o pullback.ndjson         # a frame as JSON per line, for lumenmesh live
  lumenmesh import recording recording/ -o pullback.mat --quaternion wxyz --units m")]
struct RecordingArguments {
    /// A .mat, sequence or .ndjson file, or a folder of CSV files
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Where to write it: a .mat, sequence or .ndjson file, or a folder of CSV files
    #[arg(short, long)]
    output: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    conventions: ConventionArguments,
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
    /// Where to write the recording: a .mat or sequence file, or a folder of CSV files
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
            Source::Mask(arguments) => arguments.run(),
            Source::Curves(arguments) => arguments.run(),
            Source::Recording(arguments) => arguments.run(),
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

impl MaskArguments {
    fn run(self) -> Result<()> {
        let inputs = [Some(&*self.images)].into_iter().chain(self.reading.inputs());
        refuse_inputs([Some(&*self.output)], inputs)?;
        let masks = Masks::read(&self.images, &self.reading.reading(), &self.mask.options())?;
        let recording = self.reading.over(Conventions::default()).apply(&masks.recording);
        recording.write(&self.output)?;
        let Masks { threshold, without_pose, empty, probe_outside, cut, without_image, tilted, .. } = masks;
        let summary = Summary::of(&recording);
        if self.json {
            return print_json(&serde_json::json!({
                "output": self.output.display().to_string(),
                "threshold": threshold,
                "without_pose": without_pose,
                "without_image": without_image,
                "empty": empty,
                "probe_outside": probe_outside,
                "cut_by_the_edge": cut,
                "poses_of_the_image": tilted,
                "summary": summary,
            }));
        }
        println!("{}", self.output.display());
        print!("{summary}");
        println!("threshold       {threshold}");
        for (count, what) in [
            (without_pose, "without a pose, left out"),
            (without_image, "without an image"),
            (empty, "without a pixel at the threshold: no contour"),
            (probe_outside, "with the probe in no region: no contour (--largest takes the largest one)"),
            (cut, "cut by the image's edge, where they have no echoes"),
        ] {
            if count > 0 {
                println!("frames          {count} {what}");
            }
        }
        if tilted {
            println!("poses           those of the image's plane, which is not the probe's");
        }
        Ok(())
    }
}

impl CurveArguments {
    fn run(self) -> Result<()> {
        refuse_inputs([Some(&*self.output)], self.curves.iter().map(|path| Some(&**path)))?;
        let curves = Curves::read(&self.curves)?;
        curves.recording.write(&self.output)?;
        let summary = Summary::of(&curves.recording);
        if self.json {
            return print_json(&serde_json::json!({
                "output": self.output.display().to_string(),
                "curves": curves.names,
                "off_plane_mm": curves.off_plane_mm,
                "summary": summary,
            }));
        }
        println!("{}", self.output.display());
        print!("{summary}");
        println!("frame: curve, largest distance of a point from its plane");
        for (k, (name, off)) in curves.names.iter().zip(&curves.off_plane_mm).enumerate() {
            println!("  {k}: {name}, {off:.3} mm");
        }
        Ok(())
    }
}

impl RecordingArguments {
    fn run(self) -> Result<()> {
        let inputs = [Some(&*self.recording)].into_iter().chain(self.conventions.inputs());
        refuse_inputs([Some(&*self.output)], inputs)?;
        let recording = self.conventions.read(&self.recording)?;
        let recording = self.conventions.over(Conventions::default()).apply(&recording);
        recording.write(&self.output)?;
        let summary = Summary::of(&recording);
        if self.json {
            let output = self.output.display().to_string();
            return print_json(&serde_json::json!({ "output": output, "summary": summary }));
        }
        println!("{}", self.output.display());
        print!("{summary}");
        Ok(())
    }
}
