use super::axis::tree_of;
use super::{Shown, print_json, read_screened, refuse_inputs};
use crate::anatomy::{
    Interval, Lesion, LesionKind, LesionRules, LumenSection, Measures, Profile, Sections, VesselAxis, places,
    read_values,
};
use crate::output::write_atomically;
use crate::recording::{LeftOut, Pullback, PullbackOptions};
use crate::settings::Settings;
use crate::surface::Surface;
use crate::{Error, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Measure a vessel's cross-sections: along its axis, or in the planes of a recording's frames
///
/// Along the axis, planes across it cut the lumen every so many mm, and stenoses and aneurysms are looked for. An outline
/// that is not that of the lumen alone (a hole in the wall, a side branch) is not measured; the line says why. Of a vessel
/// that branches, every branch is measured along its own axis, and the partings are named. With a
/// recording, each frame's plane (the probe's xy-plane) cuts the mesh; of the closed outlines there, the one about the
/// probe is measured, or the nearest one.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh sections vessel.vtp                                  # along the axis
  lumenmesh sections vessel.vtp --step 0.5 --from 20 --to 60 --csv sections.csv
  lumenmesh sections aorta.stl --at 10,25.5,80 --json
  lumenmesh sections tree.vtp --branch 2 --step 0.5              # one branch of several
  lumenmesh sections vessel.vtp --axis axis.vtp                  # along an axis of VMTK, or of lumenmesh axis
  lumenmesh sections vessel.vtp pullback.mat                     # in the planes of the frames
  lumenmesh sections vessel.vtp pullback.mat --against by_hand.csv --column lumen_area --numbers contours.csv

Columns ending in _se are standard errors. Diameters: least and greatest chord through the centroid, circular-equivalent,
Feret's (largest distance of two points), inscribed (largest sphere within the wall whose centre lies in the plane).
Eccentricity is (greatest - least) / greatest. measured is the share of the outline where the wall has points of the
recording. Stenoses: diameter and area below a tapering reference that is fitted to the vessel outside of them.")]
pub(super) struct Arguments {
    /// The vessel: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu
    #[arg(value_name = "VESSEL")]
    mesh: PathBuf,
    /// A recording whose planes cut it: a .mat file, a folder of CSV files or a sequence file
    #[arg(value_name = "REC")]
    recording: Option<PathBuf>,
    /// The axis, as polylines in mm; found from the mesh where none is given
    #[arg(long, value_name = "VTP", conflicts_with = "recording")]
    axis: Option<PathBuf>,
    /// Only this branch, counted from 0 [default: all, each along its own axis; 0 with --at, --from, --to and the columns of
    /// HolOrama, which belong to one axis]
    #[arg(long, value_name = "N", conflicts_with = "recording")]
    branch: Option<usize>,
    /// A section every so many mm [default: 1, or a fiftieth of a vessel shorter than 50 mm]
    #[arg(long, value_name = "MM", conflicts_with_all = ["recording", "at"])]
    step: Option<f64>,
    /// Sections only at these places, mm along the axis
    #[arg(
        long,
        value_name = "MM,…",
        value_delimiter = ',',
        conflicts_with = "recording",
        allow_hyphen_values = true
    )]
    at: Vec<f64>,
    /// Region of interest: from here on, mm along the axis (a frame with REC)
    #[arg(long, value_name = "MM|FRAME")]
    from: Option<f64>,
    /// … and up to here
    #[arg(long, value_name = "MM|FRAME")]
    to: Option<f64>,
    /// Least diameter stenosis of a lesion, %
    #[arg(long, value_name = "PERCENT", default_value_t = 25.0, conflicts_with = "recording")]
    stenosis: f64,
    /// Settings that the mesh was made with, as TOML: the probe's calibration is taken from there
    #[arg(long, value_name = "FILE", requires = "recording")]
    config: Option<PathBuf>,
    /// Compare areas with a table that has a column `frame`
    #[arg(long, value_name = "CSV", requires = "recording")]
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
    /// Names of the columns of --csv: ours, or those of HolOrama and AIVUS-CAA
    #[arg(long, value_enum, default_value_t, requires = "csv")]
    columns: Columns,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

/// Names of columns.
#[derive(Clone, Copy, Default, PartialEq, clap::ValueEnum)]
enum Columns {
    /// Every measure with its standard error.
    #[default]
    Lumenmesh,
    /// `frame`, `position`, `lumen_area`, `lumen_circumf`, `longest_distance`, `shortest_distance`, `elliptic_ratio`, ….
    Holorama,
}

/// A section beside the value that it is compared with.
#[derive(Serialize)]
struct Line {
    /// The branch, where several are listed.
    #[serde(skip_serializing_if = "Option::is_none")]
    branch: Option<u32>,
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
    #[serde(skip_serializing_if = "Option::is_none")]
    recording: Option<Shown<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    axis_length_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    median_absolute_difference_percent: Option<f64>,
    /// Frames with both an area and a value of the table, over which the median is.
    #[serde(skip_serializing_if = "Option::is_none")]
    compared: Option<usize>,
    /// Frames with a value of the table.
    #[serde(skip_serializing_if = "Option::is_none")]
    with_value: Option<usize>,
    /// The smallest area and the frame, or the place along the axis, where it is.
    minimal_lumen_area: Option<Minimum>,
    #[serde(skip_serializing_if = "Option::is_none")]
    profile: Option<&'a Profile>,
    /// The branches, where several are listed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    branches: Vec<BranchOutput<'a>>,
    sections: &'a [Line],
}

/// What `--json` prints of one branch of several.
#[derive(Serialize)]
struct BranchOutput<'a> {
    branch: u32,
    axis_length_mm: f64,
    minimal_lumen_area: Option<Minimum>,
    partings: &'a [Parting],
    profile: Option<&'a Profile>,
}

/// What is known of one branch as a whole.
struct OfBranch {
    branch: u32,
    length_mm: f64,
    partings: Vec<Parting>,
    /// None of single places.
    profile: Option<Profile>,
}

/// A stretch of an axis where another branch parts.
#[derive(Serialize)]
struct Parting {
    branch: u32,
    from_mm: f64,
    to_mm: f64,
}

#[derive(Serialize)]
struct Minimum {
    area_mm2: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    branch: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    frame: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    number: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    at_mm: Option<f64>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        refuse_inputs(
            [self.csv.as_deref()],
            [
                Some(&*self.mesh),
                self.recording.as_deref(),
                self.axis.as_deref(),
                self.config.as_deref(),
                self.against.as_deref(),
                self.numbers.as_deref(),
            ],
        )?;
        let mesh = Surface::read(&self.mesh)?.joined();
        let (lines, branches) = match &self.recording {
            Some(recording) => (self.in_frames(&mesh, recording)?, Vec::new()),
            None => self.along_axes(&mesh)?,
        };
        let (only, several) = match &branches[..] {
            [only] => (Some(only), &[][..]),
            several => (None, several),
        };
        let profile = only.and_then(|only| only.profile.as_ref());
        let differences = absolute_differences(&lines);
        let compared = differences.len();
        let with_value = lines.iter().filter(|line| line.against_mm2.is_some()).count();
        let median = median(differences);
        let against = |count: usize| self.against.is_some().then_some(count);
        if let Some(path) = &self.csv {
            match self.columns {
                Columns::Lumenmesh => write_csv(&lines, path)?,
                Columns::Holorama => write_holorama(&lines, path)?,
            }
        }
        if self.json {
            return print_json(&Output {
                mesh: Shown(&self.mesh),
                recording: self.recording.as_deref().map(Shown),
                axis_length_mm: only.map(|only| only.length_mm),
                median_absolute_difference_percent: median,
                compared: against(compared),
                with_value: against(with_value),
                minimal_lumen_area: minimum(&lines),
                profile,
                branches: several.iter().map(|of| of.output(&lines)).collect(),
                sections: &lines,
            });
        }
        let mut text = table(&lines, self.recording.is_some(), self.against.is_some());
        if self.against.is_some() {
            text += "median absolute difference of area: ";
            text += &median.map_or("none".into(), |median| format!("{median:.2} %"));
            text += &format!(
                " over {compared} frames with an area, of {with_value} with a value in the table and {} in all\n",
                lines.len()
            );
        }
        for of in several {
            text += &format!("branch {}, {:.1} mm\n", of.branch, of.length_mm);
            for Parting { branch, from_mm, to_mm } in &of.partings {
                text += &format!("parting             branch {branch}, from {from_mm:.1} to {to_mm:.1} mm\n");
            }
            text += &of.profile.as_ref().map_or(String::new(), summary);
        }
        if let Some(profile) = profile {
            text += &summary(profile);
        } else if !several.is_empty() {
            // Each branch has its own.
        } else if let (Some(least), None) = (minimum(&lines), &self.against) {
            let frame = least.frame.unwrap_or_default();
            text += &format!("minimal lumen area: {:.3} mm² in frame {frame}\n", least.area_mm2);
        }
        print!("{text}");
        Ok(())
    }

    /// The sections along the axis that is asked for, or those of all branches one after the other.
    fn along_axes(&self, mesh: &Surface) -> Result<(Vec<Line>, Vec<OfBranch>)> {
        let rules = LesionRules::default().with_stenosis_percent(self.stenosis);
        rules.validate()?;
        let tree = tree_of(mesh, &self.mesh, self.axis.as_deref())?;
        let sections = Sections::of(mesh, Some(&tree)).map_err(|e| e.in_file(&self.mesh))?;
        let is_of_one_axis =
            !self.at.is_empty() || self.from.or(self.to).is_some() || self.columns == Columns::Holorama;
        let numbers = match self.branch {
            Some(number) => number..number + 1,
            None if is_of_one_axis => 0..1,
            None => 0..tree.axes.len(),
        };
        let several = numbers.len() > 1;
        let (mut lines, mut branches) = (Vec::new(), Vec::new());
        for number in numbers {
            let Some(axis) = tree.axes.get(number) else {
                let expected = format!("a branch below {}", tree.axes.len());
                return Err(Error::setting("branch", number.to_string(), expected));
            };
            let branch = number as u32;
            let (found, profile) = self.along(axis, branch, &sections, &rules)?;
            let partings = partings(&found);
            branches.push(OfBranch { branch, length_mm: axis.length_mm(), partings, profile });
            lines.extend(
                found.into_iter().map(|section| Line { branch: several.then_some(branch), ..alone(section) }),
            );
        }
        if lines.iter().all(|line| line.section.measures.area_mm2.is_nan()) {
            eprintln!(
                "lumenmesh: warning: {}: no section has an area: are mesh and axis in the same frame of reference, and \
                 is the wall whole (see reconstruct --keep-unsupported)?",
                self.mesh.display()
            );
        }
        Ok((lines, branches))
    }

    /// The sections along one axis; with their profile unless they are single places.
    fn along(
        &self,
        axis: &VesselAxis,
        branch: u32,
        sections: &Sections,
        rules: &LesionRules,
    ) -> Result<(Vec<LumenSection>, Option<Profile>)> {
        let length = axis.length_mm();
        let (from, to) = (self.from.unwrap_or(0.0), self.to.unwrap_or(length));
        let expected = || format!("a region within the axis, 0 to {length:.1} mm, that has a length");
        if !(from < to && from < length && to > 0.0) {
            return Err(Error::setting("from, to", format!("{from} to {to} mm"), expected()));
        }
        let (from, to) = (from.max(0.0), to.min(length));
        let at = match &self.at[..] {
            [] => places(from, to, self.step.unwrap_or((length / 50.0).min(1.0)))?,
            at => {
                if let Some(out) = at.iter().find(|at| !(0.0..=length).contains(*at)) {
                    return Err(Error::setting("at", format!("{out} mm"), expected()));
                }
                at.iter().copied().filter(|at| (from..=to).contains(at)).collect()
            }
        };
        let found = sections.across(axis, branch, &at);
        let profile = self.at.is_empty().then(|| Profile::of(&found, rules)).transpose()?;
        Ok((found, profile))
    }

    fn in_frames(&self, mesh: &Surface, path: &Path) -> Result<Vec<Line>> {
        let settings = match &self.config {
            Some(path) => Settings::read_toml(path)?,
            None => Settings::default(),
        };
        let (recording, screening) = read_screened(path, &settings)?;
        let sections = Sections::of(mesh, None).map_err(|e| e.in_file(&self.mesh))?;
        let mut sections = sections.of_frames(&recording, settings.calibration.sensor_from_probe());
        // A frame that was left out has no plane of its own.
        for LeftOut { place, frame, field, found, .. } in screening.left_out {
            sections[place] = LumenSection::without(format!("left out: {field}: {found}")).of_frame(frame);
        }
        let mut lines = self.compare(sections, path)?;
        let (from, to) = (self.from.unwrap_or(0.0), self.to.unwrap_or(f64::INFINITY));
        lines.retain(|line| line.section.frame.is_some_and(|f| (from..=to).contains(&(f as f64))));
        if lines.is_empty() {
            let expected = "a region that holds a frame of the recording";
            return Err(Error::setting("from, to", format!("{from} to {to}"), expected));
        }
        Ok(lines)
    }

    /// Puts the table's values beside the sections.
    fn compare(&self, sections: Vec<LumenSection>, recording: &Path) -> Result<Vec<Line>> {
        let Some(table) = &self.against else {
            return Ok(sections.into_iter().map(alone).collect());
        };
        let values = read_values(table, &self.column)?;
        let numbers: Vec<u64> = match &self.numbers {
            Some(path) => {
                let numbers = Pullback::read(path, &PullbackOptions::default())?.frame_numbers;
                if numbers.len() != sections.len() {
                    let expected = format!("{}, as in {}", sections.len(), recording.display());
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
            let difference = |against: f64| 100.0 * (section.measures.area_mm2 / against - 1.0);
            let difference_percent = against_mm2.map(difference).filter(|percent| percent.is_finite());
            Line { branch: None, section, number: Some(number), against_mm2, difference_percent }
        };
        Ok(sections.into_iter().zip(numbers).map(line).collect())
    }
}

impl OfBranch {
    fn output(&self, lines: &[Line]) -> BranchOutput<'_> {
        let own = lines.iter().filter(|line| line.branch == Some(self.branch));
        BranchOutput {
            branch: self.branch,
            axis_length_mm: self.length_mm,
            minimal_lumen_area: minimum(own),
            partings: &self.partings,
            profile: self.profile.as_ref(),
        }
    }
}

/// The stretches in which neighbouring sections lie where the same branch parts.
fn partings(sections: &[LumenSection]) -> Vec<Parting> {
    let runs = sections.chunk_by(|a, b| a.parting == b.parting);
    let parting = |run: &[LumenSection]| {
        let (first, last) = (run.first()?, run.last()?);
        Some(Parting { branch: first.parting?, from_mm: first.at_mm?, to_mm: last.at_mm? })
    };
    runs.filter_map(parting).collect()
}

fn alone(section: LumenSection) -> Line {
    Line { branch: None, section, number: None, against_mm2: None, difference_percent: None }
}

fn minimum<'a>(lines: impl IntoIterator<Item = &'a Line>) -> Option<Minimum> {
    let measured = lines.into_iter().filter(|line| line.section.measures.area_mm2.is_finite());
    let area = |line: &Line| line.section.measures.area_mm2;
    let line = measured.min_by(|a, b| area(a).total_cmp(&area(b)))?;
    let LumenSection { frame, at_mm, .. } = line.section;
    Some(Minimum { area_mm2: area(line), branch: line.branch, frame, number: line.number, at_mm })
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

fn table(lines: &[Line], of_frames: bool, against: bool) -> String {
    let several = lines.iter().any(|line| line.branch.is_some());
    let mut text = String::from(if several { "branch" } else { "" });
    text += if of_frames { "  frame" } else { "  at mm" };
    text += "  area mm²      ±se  perimeter mm  least mm  greatest mm  equivalent mm  feret mm  inscribed mm  ecc.  measured";
    text += if against { "   number  against  difference\n" } else { "\n" };
    for line in lines {
        let s = &line.section;
        let m = &s.measures;
        let at = match (s.frame, s.at_mm) {
            (Some(frame), _) => format!("{frame:7}"),
            (None, at) => format!("{:7.2}", at.unwrap_or(f64::NAN)),
        };
        let or_dash = |value: Option<f64>, digits: usize| {
            value.filter(|v| v.is_finite()).map_or("-".into(), |v| format!("{v:.digits$}"))
        };
        text += &line.branch.map_or(String::new(), |branch| format!("{branch:6}"));
        text += &format!(
            "{at}  {:8.3} {:>8}  {:12.3}  {:8.3}  {:11.3}  {:13.3}  {:8.3}  {:12.3}  {:4.2}  {:>8}",
            m.area_mm2,
            or_dash(s.standard_errors.map(|e| e.area_mm2), 3),
            m.perimeter_mm,
            m.least_diameter_mm,
            m.greatest_diameter_mm,
            m.equivalent_diameter_mm,
            m.feret_diameter_mm,
            m.inscribed_diameter_mm,
            m.eccentricity,
            s.measured_share.map_or("-".into(), |share| format!("{:.0} %", 100.0 * share)),
        );
        if let (Some(number), Some(against)) = (line.number, line.against_mm2) {
            let percent = line.difference_percent.map_or("-".into(), |percent| format!("{percent:+.1} %"));
            text += &format!("  {number:7}  {against:7.2}  {percent:>10}");
        }
        text += &s.remark.as_ref().map_or("\n".into(), |remark| format!("  {remark}\n"));
    }
    text
}

/// A profile for people.
fn summary(profile: &Profile) -> String {
    let mut text = String::new();
    if let (Some(least), Some(at)) = (profile.minimal_area_mm2, profile.minimal_area_at_mm) {
        text += &format!("minimal lumen area  {} mm² at {at:.1} mm\n", interval(&least, 2));
    }
    text += &format!("volume              {:.1} mm³", profile.volume_mm3);
    let step = profile.at_mm.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
    if profile.longest_gap_mm > 1.5 * step {
        text += &format!(", across gaps of up to {:.1} mm without areas", profile.longest_gap_mm);
    }
    text.push('\n');
    if profile.lesions.is_empty() {
        text += &format!("lesions             none of {} % or more\n", profile.rules.stenosis_percent);
    }
    for lesion in &profile.lesions {
        let Lesion { at_mm, from_mm, to_mm, .. } = lesion;
        let (name, sign, area) = match lesion.kind {
            LesionKind::Stenosis => ("stenosis", 1.0, "minimal lumen area"),
            LesionKind::Aneurysm => ("aneurysm", -1.0, "largest lumen area"),
        };
        text += &format!(
            "{name:<19} at {at_mm:.1} mm, from {from_mm:.1} to {to_mm:.1} mm (length {} mm)\n",
            interval(&lesion.length_mm, 1)
        );
        let more = if sign > 0.0 { "less" } else { "more" };
        let percent = |i: &Interval| match sign > 0.0 {
            true => interval(i, 0),
            false => interval(&Interval::between(-i.value, [-i.high, -i.low]), 0),
        };
        text += &format!(
            "  {area}: {} mm², diameter {} mm, reference diameter {} mm\n  diameter {} % {more} than the reference, area {} % \
             {more}; volume {:.1} mm³\n",
            interval(&lesion.area_mm2, 2),
            interval(&lesion.diameter_mm, 2),
            interval(&lesion.reference_diameter_mm, 2),
            percent(&lesion.diameter_stenosis_percent),
            percent(&lesion.area_stenosis_percent),
            lesion.volume_mm3,
        );
        text += &lesion.remark.as_ref().map_or(String::new(), |remark| format!("  {remark}\n"));
    }
    text
}

/// A number with its interval, where that is known.
fn interval(interval: &Interval, digits: usize) -> String {
    let Interval { value, low, high, .. } = interval;
    match low.is_finite() {
        true => format!("{value:.digits$} ({low:.digits$} to {high:.digits$})"),
        false => format!("{value:.digits$}"),
    }
}

fn write_csv(lines: &[Line], path: &Path) -> Result<()> {
    let is_along = lines.iter().any(|line| line.section.at_mm.is_some());
    let several = lines.iter().any(|line| line.branch.is_some());
    write_atomically(path, |out| {
        let mut table = csv::Writer::from_writer(out);
        let mut head = Vec::new();
        if several {
            head.extend(["branch", "parting"].map(String::from));
        }
        head.push(if is_along { "at_mm" } else { "frame" }.to_owned());
        head.extend(Measures::NAMES.map(String::from));
        head.extend(Measures::NAMES.map(|name| format!("{name}_se")));
        head.extend(
            ["measured_share", "number", "against_mm2", "difference_percent", "remark"].map(String::from),
        );
        table.write_record(&head)?;
        let cell = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
        for line in lines {
            let s = &line.section;
            let mut row = Vec::new();
            if several {
                row.extend([line.branch, s.parting].map(|number| cell(number.map(f64::from))));
            }
            row.push(s.frame.map_or_else(|| cell(s.at_mm), |frame| frame.to_string()));
            row.extend(s.measures.values().map(|v| v.to_string()));
            match &s.standard_errors {
                Some(errors) => row.extend(errors.values().map(|v| v.to_string())),
                None => row.extend(Measures::NAMES.map(|_| String::new())),
            }
            row.push(cell(s.measured_share));
            row.push(line.number.map_or(String::new(), |n| n.to_string()));
            row.extend([line.against_mm2, line.difference_percent].map(cell));
            row.push(s.remark.clone().unwrap_or_default());
            table.write_record(&row)?;
        }
        table.flush()
    })
}

/// The columns of HolOrama's (earlier AIVUS-CAA's) table of measurements. What is not measured here stays empty.
fn write_holorama(lines: &[Line], path: &Path) -> Result<()> {
    write_atomically(path, |out| {
        let mut table = csv::Writer::from_writer(out);
        table.write_record([
            "frame",
            "position",
            "phase",
            "lumen_area",
            "lumen_circumf",
            "longest_distance",
            "shortest_distance",
            "elliptic_ratio",
            "vector_length",
            "vector_angle",
            "measurement_1",
            "measurement_2",
            "pullback_speed",
            "pullback_start_frame",
            "frame_rate",
        ])?;
        for (k, line) in lines.iter().enumerate() {
            let s = &line.section;
            let m = &s.measures;
            let number = |v: f64| if v.is_finite() { v.to_string() } else { String::new() };
            let frame = line.number.unwrap_or(s.frame.unwrap_or(k) as u64);
            let mut row = vec![frame.to_string(), s.at_mm.map_or(String::new(), number), String::new()];
            row.extend(
                [
                    m.area_mm2,
                    m.perimeter_mm,
                    m.feret_diameter_mm,
                    m.least_diameter_mm,
                    m.feret_diameter_mm / m.least_diameter_mm,
                ]
                .map(number),
            );
            row.resize(15, String::new());
            table.write_record(&row)?;
        }
        table.flush()
    })
}
