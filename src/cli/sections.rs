use super::{Shown, print_json, read_screened, refuse_inputs};
use crate::evaluate::{LumenSection, read_values, sections};
use crate::output::write_atomically;
use crate::recording::{LeftOut, Pullback, PullbackOptions};
use crate::settings::Settings;
use crate::surface::Surface;
use crate::{Error, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Measure a mesh's cross-sections in the planes of a recording's frames
///
/// Each frame's plane (the probe's xy-plane) cuts the mesh; of the closed outlines there, the one about the probe is
/// measured, or the nearest one.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh sections vessel.vtp pullback.mat
  lumenmesh sections vessel.vtp pullback.mat --csv sections.csv
  lumenmesh sections vessel.vtp pullback.mat --against by_hand.csv --column lumen_area --numbers contours.csv")]
pub(super) struct Arguments {
    /// The mesh: .vtp, .ply, .stl, .obj, .vtk or .vtu
    mesh: PathBuf,
    /// The recording whose planes cut it: a .mat file, a folder of CSV files or a sequence file
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Settings that the mesh was made with, as TOML: the probe's calibration is taken from there
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Compare areas with a table that has a column `frame`
    #[arg(long, value_name = "CSV")]
    against: Option<PathBuf>,
    /// The column of --against with areas, mm²
    #[arg(long, value_name = "NAME", default_value = "lumen_area", requires = "against")]
    column: String,
    /// The contours that REC was imported from: --against counts frames as they do [default: from 0, as in REC]
    #[arg(long, value_name = "CONTOURS", requires = "against")]
    numbers: Option<PathBuf>,
    /// Also write the sections as CSV
    #[arg(long, value_name = "CSV")]
    csv: Option<PathBuf>,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

/// A section beside the value that it is compared with.
#[derive(Serialize)]
struct Line {
    #[serde(flatten)]
    section: LumenSection,
    /// The frame's number in the table.
    #[serde(skip_serializing_if = "Option::is_none")]
    number: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    against_mm2: Option<f64>,
    /// Area less that of the table, in per cent of the latter.
    #[serde(skip_serializing_if = "Option::is_none")]
    difference_percent: Option<f64>,
}

#[derive(Serialize)]
struct Output<'a> {
    mesh: Shown<'a>,
    recording: Shown<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    median_absolute_difference_percent: Option<f64>,
    /// Frames with both an area and a value of the table, over which the median is.
    #[serde(skip_serializing_if = "Option::is_none")]
    compared: Option<usize>,
    /// Frames with a value of the table.
    #[serde(skip_serializing_if = "Option::is_none")]
    with_value: Option<usize>,
    sections: &'a [Line],
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        refuse_inputs(
            [self.csv.as_deref()],
            [
                Some(&*self.mesh),
                Some(&*self.recording),
                self.config.as_deref(),
                self.against.as_deref(),
                self.numbers.as_deref(),
            ],
        )?;
        let settings = match &self.config {
            Some(path) => Settings::read_toml(path)?,
            None => Settings::default(),
        };
        let (recording, screening) = read_screened(&self.recording, &settings)?;
        let mesh = Surface::read(&self.mesh)?;
        let mut sections = sections(&mesh, &recording, settings.calibration.sensor_from_probe())?;
        // A frame that was left out has no plane of its own.
        for LeftOut { place, frame, field, found, .. } in screening.left_out {
            sections[place] = LumenSection::without(frame, format!("left out: {field}: {found}"));
        }
        let lines = self.compare(sections)?;
        let differences = absolute_differences(&lines);
        let compared = differences.len();
        let with_value = lines.iter().filter(|line| line.against_mm2.is_some()).count();
        let median = median(differences);
        let against = |count: usize| self.against.is_some().then_some(count);
        if let Some(path) = &self.csv {
            write_csv(&lines, path)?;
        }
        if self.json {
            return print_json(&Output {
                mesh: Shown(&self.mesh),
                recording: Shown(&self.recording),
                median_absolute_difference_percent: median,
                compared: against(compared),
                with_value: against(with_value),
                sections: &lines,
            });
        }
        let mut text = String::from("  frame  area mm²  perimeter mm  least mm  greatest mm  equivalent mm");
        text += if self.against.is_some() { "   number  against  difference\n" } else { "\n" };
        for line in &lines {
            let s = &line.section;
            text += &format!(
                "{:7}  {:8.3}  {:12.3}  {:8.3}  {:11.3}  {:13.3}",
                s.frame,
                s.area_mm2,
                s.perimeter_mm,
                s.least_diameter_mm,
                s.greatest_diameter_mm,
                s.equivalent_diameter_mm
            );
            if let (Some(number), Some(against)) = (line.number, line.against_mm2) {
                let percent =
                    line.difference_percent.map_or("-".into(), |percent| format!("{percent:+.1} %"));
                text += &format!("  {number:7}  {against:7.2}  {percent:>10}");
            }
            text += &s.remark.as_ref().map_or("\n".into(), |remark| format!("  {remark}\n"));
        }
        if self.against.is_some() {
            text += "median absolute difference of area: ";
            text += &median.map_or("none".into(), |median| format!("{median:.2} %"));
            text += &format!(
                " over {compared} frames with an area, of {with_value} with a value in the table and {} in all\n",
                lines.len()
            );
        }
        print!("{text}");
        Ok(())
    }

    /// Puts the table's values beside the sections.
    fn compare(&self, sections: Vec<LumenSection>) -> Result<Vec<Line>> {
        let Some(table) = &self.against else {
            let alone = |section| Line { section, number: None, against_mm2: None, difference_percent: None };
            return Ok(sections.into_iter().map(alone).collect());
        };
        let values = read_values(table, &self.column)?;
        let numbers: Vec<u64> = match &self.numbers {
            Some(path) => {
                let numbers = Pullback::read(path, &PullbackOptions::default())?.frame_numbers;
                if numbers.len() != sections.len() {
                    let expected = format!("{}, as in {}", sections.len(), self.recording.display());
                    return Err(Error::input(path, "frames", numbers.len(), expected));
                }
                numbers
            }
            None => (0..sections.len() as u64).collect(),
        };
        let known = numbers.iter().filter(|number| values.contains_key(number)).count();
        if known == 0 {
            let expected = "the number of at least one frame of the recording (see --numbers)";
            return Err(Error::input(table, "frame", "none of the recording's", expected));
        }
        if 2 * known < numbers.len() {
            eprintln!(
                "lumenmesh: warning: {}: values for {known} of the recording's {} frames: does it number them \
                 differently (see --numbers)?",
                table.display(),
                numbers.len()
            );
        }
        let line = |(section, number): (LumenSection, u64)| {
            let against_mm2 = values.get(&number).copied();
            let difference = |against: f64| 100.0 * (section.area_mm2 / against - 1.0);
            let difference_percent = against_mm2.map(difference).filter(|percent| percent.is_finite());
            Line { section, number: Some(number), against_mm2, difference_percent }
        };
        Ok(sections.into_iter().zip(numbers).map(line).collect())
    }
}

/// Of the frames that have both an area and a value of the table, %.
fn absolute_differences(lines: &[Line]) -> Vec<f64> {
    lines.iter().filter_map(|line| line.difference_percent).map(f64::abs).collect()
}

/// The mean of the middle two of an even number of values.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    (n > 0).then(|| (values[(n - 1) / 2] + values[n / 2]) / 2.0)
}

fn write_csv(lines: &[Line], path: &Path) -> Result<()> {
    write_atomically(path, |out| {
        let mut table = csv::Writer::from_writer(out);
        table.write_record([
            "frame",
            "area_mm2",
            "perimeter_mm",
            "least_diameter_mm",
            "greatest_diameter_mm",
            "equivalent_diameter_mm",
            "number",
            "against_mm2",
            "difference_percent",
            "remark",
        ])?;
        for line in lines {
            let s = &line.section;
            let cell = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
            table.write_record([
                s.frame.to_string(),
                s.area_mm2.to_string(),
                s.perimeter_mm.to_string(),
                s.least_diameter_mm.to_string(),
                s.greatest_diameter_mm.to_string(),
                s.equivalent_diameter_mm.to_string(),
                line.number.map_or(String::new(), |n| n.to_string()),
                cell(line.against_mm2),
                cell(line.difference_percent),
                s.remark.clone().unwrap_or_default(),
            ])?;
        }
        table.flush()
    })
}
