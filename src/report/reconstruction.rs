//! The page of one reconstruction.

use super::page::{Page, Table};
use super::plot::{Violin, violins};
use super::render::Style;
use super::rows::{VIOLIN, facts};
use super::{anatomy, branches, cylinders, sweep};
use crate::Result;
use crate::anatomy::VesselTree;
use crate::branching::Mouth;
use crate::evaluate::{self, Evaluation, SystematicErrors, Truth};
use crate::reconstruction::{Lumen, LumenReport};
use crate::recording::{LeftOut, MinMedianMax, Recording, Summary};
use crate::settings::{Calibrate, Settings};
use crate::surface::Surface;
use crate::sweep::{Mirror, Motion, SelfCalibration};
use glam::DVec3;

/// The content of a page.
#[non_exhaustive]
pub struct PageContent<'a> {
    /// Its title, such as the recording's name.
    pub title: &'a str,
    /// The recording.
    pub recording: &'a Recording,
    /// The lumen. Of cylinders with history, the page shows the errors of every iteration.
    pub lumen: &'a Lumen,
    /// The truth and how far the vessel's surface is from it, where it is known.
    pub measured: Option<(&'a Truth, &'a Evaluation)>,
    /// The command that reproduces it.
    pub command: &'a str,
}

impl<'a> PageContent<'a> {
    /// A page without a truth.
    pub fn new(title: &'a str, recording: &'a Recording, lumen: &'a Lumen, command: &'a str) -> Self {
        Self { title, recording, lumen, measured: None, command }
    }

    /// Adds the truth, and the evaluation of the lumen's surface against it.
    #[must_use]
    pub fn with_truth(mut self, truth: &'a Truth, evaluation: &'a Evaluation) -> Self {
        self.measured = Some((truth, evaluation));
        self
    }
}

/// One reconstruction as a self-contained HTML page: summary, error distribution, the vessel in colours from three
/// sides and to turn, areas and diameters with lesions, coverage, noise, settings and how to reproduce it; of cylinders
/// convergence too.
///
/// # Errors
/// Where a figure has nothing to show or settings have no TOML form.
pub fn html(content: &PageContent) -> Result<String> {
    let PageContent { lumen, measured, .. } = content;
    let mut page = Page::new(content.title);
    summary(&mut page, content);
    if let Some(reconstruction) = lumen.cylinders() {
        cylinders::convergence(&mut page, reconstruction, *measured)?;
    }

    let mut mesh = lumen.surface();
    let array = match measured {
        Some((_, evaluation)) => {
            page.heading("Error");
            page.table(&error_table(evaluation));
            if !evaluation.branches.is_empty() {
                page.table(&branch_table(evaluation));
            }
            let violin = |name: &str, values: &[f64]| Violin { name: name.into(), values: values.to_vec() };
            let svg = violins(
                "distance (mm)",
                &[
                    violin("to the truth", &evaluation.error_mm),
                    violin("signed: outside is positive", &evaluation.signed_error_mm),
                ],
            )?;
            page.plot(&svg, &format!("Distances of the mesh's nodes to the truth. {VIOLIN}"));
            evaluation.colour(&mut mesh);
            Some("error_mm")
        }
        None => {
            page.heading("Residual");
            page.paragraph(
                "The truth is not known. The residual of a node says how far the points about it lie from the wall.",
            );
            let values = mesh.array("residual_mm").unwrap_or_default().to_vec();
            if values.iter().any(|v| v.is_finite()) {
                let svg = violins("residual (mm)", &[Violin { name: "nodes with points".into(), values }])?;
                page.plot(&svg, &format!("Residuals of the mesh's nodes. {VIOLIN}"));
                Some("residual_mm")
            } else {
                page.paragraph("No node has one: nothing was fitted.");
                None
            }
        }
    };
    page.heading("Vessel");
    let style = Style { array: array.map(String::from), ..Style::default() };
    let caption = match array {
        Some(_) => {
            "The vessel from three sides; the colours end at 10 times the mean or at the largest value."
        }
        None => "The vessel from three sides.",
    };
    page.mesh(&mesh, &style, caption)?;
    let shown = content.lumen.settings().conventions.apply(content.recording);
    let sensor_from_probe = content.lumen.settings().calibration.sensor_from_probe();
    page.viewer("The vessel", &mesh, Some((&*shown, sensor_from_probe)));

    anatomy::sections(&mut page, &mesh, VesselTree::of_lumen(lumen, &mesh))?;
    if let Some(reconstruction) = lumen.cylinders() {
        cylinders::coverage(&mut page, &reconstruction.vessel.rings)?;
        cylinders::noise(&mut page, reconstruction)?;
    }
    if let Some(sweep) = lumen.sweep() {
        sweep::coverage(&mut page, sweep)?;
        sweep::noise(&mut page, sweep)?;
    }
    systematic(&mut page, content, &mesh)?;
    page.heading("Settings");
    page.listing(&content.lumen.settings().to_toml()?);
    page.heading("How to reproduce");
    page.listing(content.command);
    if measured.is_some() {
        page.heading("What the numbers mean");
        page.definitions(evaluate::DEFINITIONS);
    }
    Ok(page.finish())
}

fn summary(page: &mut Page, content: &PageContent) {
    let screening = content.lumen.screening();
    let recorded = Summary::of(&content.lumen.settings().conventions.apply(content.recording));
    let middle = |spread: Option<MinMedianMax>, decimals: usize| {
        spread.map_or_else(|| "unknown".into(), |s| format!("{:.decimals$}", s.median))
    };
    page.heading("Summary");
    let mut rows = Vec::new();
    if let Some((_, evaluation)) = content.measured {
        rows.push(("fitting error (mean, mm)", format!("{:.3}", evaluation.mesh_to_truth.mean_mm)));
    }
    let optional =
        |value: Option<f64>, unit: &str| value.map_or_else(|| "unknown".into(), |v| format!("{v:.1} {unit}"));
    rows.extend([
        ("frames", format!("{}, of {} rays", content.recording.frames.len(), middle(recorded.rays, 0))),
        ("duration", optional(recorded.duration_s, "s")),
        ("frame rate", optional(recorded.frame_rate_hz, "Hz")),
        ("path of the sensor", format!("{:.0} mm", recorded.path_length_mm)),
        ("contour radius (median)", format!("{} mm", middle(recorded.contour_radius_mm, 1))),
    ]);
    rows.extend(match content.lumen.report() {
        LumenReport::Cylinders(report) => cylinders::summary_rows(report),
        LumenReport::Sweep(report) => sweep::summary_rows(report),
        LumenReport::Branches(report) => branches::summary_rows(report),
        LumenReport::CylinderBranches(report) => branches::cylinder_summary_rows(report),
    });
    rows.extend(content.lumen.motion().map(|motion| ("motion", of_motion(motion))));
    rows.extend(
        content
            .lumen
            .calibration()
            .map(|found| ("calibration", of_calibration(found, content.lumen.settings()))),
    );
    page.table(&facts(rows));
    let mouths = content.lumen.mouths();
    if !mouths.is_empty() {
        page.heading("Mouths");
        page.paragraph(
            "Branches that were seen but not entered. The surface is open there. Standard errors are those of leaving out \
             frames.",
        );
        page.table(&mouth_table(mouths));
    }
    if !screening.left_out.is_empty() {
        page.heading("Frames left out");
        page.paragraph(&format!(
            "{} of {} frames were not used: nothing of the vessel here comes from them.",
            screening.left_out.len(),
            screening.frames
        ));
        page.table(&left_out_table(&screening.left_out));
    }
    let cleaned = screening.cleaning.lines();
    if !screening.suspicions.is_empty() || !cleaned.is_empty() {
        page.heading("Suspicious");
        for (_, found) in cleaned {
            page.paragraph(&format!("{found}."));
        }
        for finding in &screening.suspicions {
            page.listing(&finding.to_string());
        }
    }
}

/// Which state of a vessel that moves is shown.
fn of_motion(motion: &Motion) -> String {
    let Some(shown) = motion.shown else {
        return format!("{} frames of the window of phases are used", motion.frames);
    };
    if motion.cycles.is_empty() {
        return "none that is significant".into();
    }
    let frequencies: Vec<String> =
        motion.cycles.iter().map(|cycle| format!("{:.3} Hz", cycle.frequency_hz)).collect();
    format!("{} removed; the vessel is shown at {shown}", frequencies.join(" and "))
}

/// What of a calibration was found to be wrong, and whether that was corrected.
fn of_calibration(found: &SelfCalibration, settings: &Settings) -> String {
    let what = if settings.sweep.calibrate == Calibrate::Apply { "corrected" } else { "significant errors" };
    let wrong = found.parameters.iter().filter(|parameter| parameter.correction != 0.0);
    let wrong: Vec<String> = wrong.map(|p| format!("{} {:+.3} {}", p.name, p.correction, p.unit)).collect();
    match found.mirror {
        Some(Mirror::X | Mirror::Y) => format!("{what}: images are mirrored"),
        _ if wrong.is_empty() => "no error is significant".into(),
        _ => format!("{what}: {}", wrong.join(", ")),
    }
}

/// What the recording cannot show: how far a wrong calibration would move the wall.
fn systematic(page: &mut Page, content: &PageContent, mesh: &Surface) -> Result<()> {
    let settings = content.lumen.settings();
    let mut used = settings.conventions.apply(content.recording).into_owned();
    for left_out in &content.lumen.screening().left_out {
        used.frames[left_out.frame].contour_mm.clear();
    }
    let Some(errors) = SystematicErrors::of(&used, settings.calibration.sensor_from_probe(), mesh)? else {
        return Ok(());
    };
    page.heading("What the recording cannot show");
    page.paragraph(
        "An error of the probe's calibration or of the assumed speed of sound moves the wall and leaves little or no trace \
         in the residuals and the standard errors. It would move the wall by so much outward or inward (root mean square over the \
         nodes):",
    );
    let [x, y, z] = errors.offset_mm_per_mm.map(|mm| format!("{mm:.2} mm"));
    let [roll_x, roll_y, roll_z] = errors.rotation_mm_per_deg.map(|mm| format!("{mm:.3} mm"));
    page.table(&Table {
        head: ["", "x", "y", "z"].map(String::from).to_vec(),
        rows: vec![
            vec!["probe 1 mm aside along its".into(), x, y, z],
            vec!["probe turned by 1° about its".into(), roll_x, roll_y, roll_z],
            vec![
                "speed of sound wrong by 1 %".into(),
                format!("{:.3} mm", errors.sound_speed_mm_per_percent),
                String::new(),
                String::new(),
            ],
        ],
        ..Table::default()
    });
    Ok(())
}

fn mouth_table(mouths: &[Mouth]) -> Table {
    let place = |p: DVec3, decimals: usize| p.to_array().map(|x| format!("{x:.decimals$}")).join(", ");
    let row = |mouth: &Mouth| {
        vec![
            mouth.branch.to_string(),
            format!("({}) ± {:.1}", place(mouth.centre_mm, 1), mouth.centre_standard_error_mm),
            format!("{:.0} ± {:.0}", mouth.area_mm2, mouth.area_standard_error_mm2),
            format!("({}) ± {:.0}°", place(mouth.direction, 2), mouth.direction_standard_error_deg),
            format!("{:.1}", mouth.depth_mm),
            mouth.frames.to_string(),
        ]
    };
    let head = ["in branch", "centre (mm)", "area (mm²)", "leads to", "seen deep (mm)", "frames"];
    Table {
        head: head.map(String::from).to_vec(),
        rows: mouths.iter().map(row).collect(),
        ..Table::default()
    }
}

/// Runs of frames that are left out for the same reason.
fn left_out_table(left_out: &[LeftOut]) -> Table {
    let runs = LeftOut::runs(left_out);
    let row = |run: &&[LeftOut]| {
        let LeftOut { field, found, expected, .. } = &run[0];
        vec![LeftOut::frames_of(run), (*field).into(), found.clone(), expected.clone()]
    };
    let more = runs.len().saturating_sub(MAX_ROWS);
    Table {
        head: ["left out", "quantity", "found", "expected"].map(String::from).to_vec(),
        rows: runs.iter().take(MAX_ROWS).map(row).collect(),
        note: if more > 0 { format!("And {more} more runs of frames.") } else { String::new() },
        ..Table::default()
    }
}

/// Runs of frames that the page lists.
const MAX_ROWS: usize = 50;

/// The errors of each branch, and about the partings.
fn branch_table(evaluation: &Evaluation) -> Table {
    let row = |name: String, errors: &evaluate::PartErrors| {
        let d = &errors.mesh_to_truth;
        let near = errors.within_1_mm.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share));
        let [mean, p95, signed] = [d.mean_mm, d.p95_mm, errors.signed_mean_mm].map(|mm| format!("{mm:.4}"));
        vec![name, d.nodes.to_string(), mean, p95, signed, near]
    };
    let branches = evaluation.branches.iter().map(|of| row(format!("branch {}", of.branch), &of.errors));
    let partings = evaluation.partings.iter().map(|errors| row("about partings".into(), errors));
    let head = ["", "nodes", "mean (mm)", "95th percentile (mm)", "signed mean (mm)", "truth within 1 mm"];
    Table {
        head: head.map(String::from).to_vec(),
        rows: branches.chain(partings).collect(),
        ..Table::default()
    }
}

fn error_table(evaluation: &Evaluation) -> Table {
    let back = evaluation.truth_to_mesh.as_ref();
    let forth = &evaluation.mesh_to_truth;
    let row = |name: &str, of: fn(&evaluate::Distances) -> f64| {
        vec![
            name.into(),
            format!("{:.4}", of(forth)),
            back.map_or_else(|| "-".into(), |d| format!("{:.4}", of(d))),
        ]
    };
    Table {
        title: String::new(),
        head: ["", "mesh→truth", "truth→mesh"].map(String::from).to_vec(),
        rows: vec![
            row("mean (mm)", |d| d.mean_mm),
            row("root mean square (mm)", |d| d.rms_mm),
            row("median (mm)", |d| d.median_mm),
            row("95th percentile (mm)", |d| d.p95_mm),
            row("largest (mm)", |d| d.max_mm),
            vec!["signed mean (mm)".into(), format!("{:.4}", evaluation.signed_mean_mm), "-".into()],
            vec![
                "area of the truth covered".into(),
                "-".into(),
                format!("{:.1} %", 100.0 * evaluation.covered_area_share),
            ],
        ],
        note: format!("A node of the truth is covered where {}.", evaluation.covered_rule),
    }
}
