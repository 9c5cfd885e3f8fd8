//! One reconstruction on one page.

use super::page::{Page, Table};
use super::plot::{Line, Mark, Room, Violin, lines, violins};
use super::render::Style;
use crate::Result;
use crate::cylinders::merge::Ring;
use crate::cylinders::{CylinderReconstruction, Report};
use crate::engine::EngineDescription;
use crate::evaluate::{self, Evaluation, Truth};
use crate::reconstruction::{Lumen, LumenReport};
use crate::recording::{Recording, Spread, Summary};
use glam::DVec3;

/// What a page shows.
pub struct Subject<'a> {
    /// Its title, such as the recording's name.
    pub title: &'a str,
    /// What was recorded.
    pub recording: &'a Recording,
    /// The lumen. Of cylinders with history, the page shows the errors of every iteration.
    pub lumen: &'a Lumen,
    /// The truth and how far the vessel's surface is from it, where it is known.
    pub measured: Option<(&'a Truth, &'a Evaluation)>,
    /// What to type to get it again.
    pub command: &'a str,
}

/// One reconstruction as a self-contained HTML page: summary, error distribution, the vessel in colours from three
/// sides, coverage, noise, settings and how to reproduce it; of cylinders convergence too.
///
/// # Errors
/// Where a figure has nothing to show or settings have no TOML form.
pub fn html(subject: &Subject) -> Result<String> {
    let Subject { lumen, measured, .. } = subject;
    let mut page = Page::new(subject.title);
    summary(&mut page, subject);
    if let Some(reconstruction) = lumen.cylinders() {
        convergence(&mut page, reconstruction, *measured)?;
    }

    let mut mesh = lumen.surface();
    let array = match measured {
        Some((_, evaluation)) => {
            page.heading("Error");
            page.table(&error_table(evaluation));
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

    if let Some(reconstruction) = lumen.cylinders() {
        coverage(&mut page, &reconstruction.vessel.rings)?;
        noise(&mut page, reconstruction)?;
    }
    if let Some(sweep) = lumen.sweep() {
        super::sweep::coverage(&mut page, sweep)?;
        super::sweep::noise(&mut page, sweep)?;
    }
    page.heading("Settings");
    page.listing(&subject.lumen.settings().to_toml()?);
    page.heading("How to reproduce");
    page.listing(subject.command);
    if measured.is_some() {
        page.heading("What the numbers mean");
        page.definitions(evaluate::DEFINITIONS);
    }
    Ok(page.finish())
}

const VIOLIN: &str = "The width shows how common a value is, the bar reaches from the first to the third quartile, the dot \
    is the median; the axis ends at the largest 99th percentile.";

pub(super) fn facts(rows: Vec<(&str, String)>) -> Table {
    let rows = rows.into_iter().map(|(name, value)| vec![name.into(), value]).collect();
    Table { rows, ..Table::default() }
}

/// A count and what share of the whole that is.
pub(super) fn share(part: u64, whole: u64) -> String {
    format!("{part} ({:.2} %)", 100.0 * part as f64 / whole.max(1) as f64)
}

fn summary(page: &mut Page, subject: &Subject) {
    let recorded = Summary::of(subject.recording);
    let middle = |spread: Option<Spread>, decimals: usize| {
        spread.map_or_else(|| "unknown".into(), |s| format!("{:.decimals$}", s.median))
    };
    page.heading("Summary");
    let mut rows = Vec::new();
    if let Some((_, evaluation)) = subject.measured {
        rows.push(("fitting error (mean, mm)", format!("{:.3}", evaluation.mesh_to_truth.mean_mm)));
    }
    let optional =
        |value: Option<f64>, unit: &str| value.map_or_else(|| "unknown".into(), |v| format!("{v:.1} {unit}"));
    rows.extend([
        ("frames", format!("{}, of {} rays", subject.recording.frames.len(), middle(recorded.rays, 0))),
        ("duration", optional(recorded.duration_s, "s")),
        ("frame rate", optional(recorded.frame_rate_hz, "Hz")),
        ("path of the sensor", format!("{:.0} mm", recorded.path_length_mm)),
        ("contour radius (median)", format!("{} mm", middle(recorded.contour_radius_mm, 1))),
    ]);
    rows.extend(match subject.lumen.report() {
        LumenReport::Cylinders(report) => cylinder_rows(report),
        LumenReport::Sweep(report) => super::sweep::summary_rows(report),
    });
    page.table(&facts(rows));
    for defect in recorded.defects.iter().filter(|d| d.frames > 0) {
        page.paragraph(&format!(
            "{} frames with an odd {}; expected {}.",
            defect.frames, defect.field, defect.expected
        ));
    }
}

pub(super) fn engine_row(engine: &EngineDescription, threads: usize) -> String {
    match &engine.adapter {
        Some(adapter) => format!("{} on {adapter}", engine.name),
        None => format!("{} on {threads} threads", engine.name),
    }
}

fn cylinder_rows(report: &Report) -> Vec<(&'static str, String)> {
    let cylinders = match report.estimated_cylinders {
        0 => format!("{}, as the recording places them", report.cylinders),
        _ => format!("{}, placed by the contours", report.cylinders),
    };
    let seconds = &report.seconds;
    let milliseconds = (seconds.track + seconds.fit + seconds.merge) * 1e3;
    vec![
        ("method", "cylinders".into()),
        ("cylinders fitted", cylinders),
        ("vessel", format!("{} rings, {} nodes, {} triangles", report.rings, report.nodes, report.triangles)),
        ("engine", engine_row(&report.engine, report.threads)),
        ("time", format!("{milliseconds:.0} ms: placing frames, fitting, merging")),
    ]
}

fn convergence(
    page: &mut Page,
    reconstruction: &CylinderReconstruction,
    measured: Option<(&Truth, &Evaluation)>,
) -> Result<()> {
    let travel = &reconstruction.report.mean_travel_mm;
    if travel.is_empty() {
        return Ok(());
    }
    page.heading("Convergence");
    let both = |name: &str, points: Vec<[f64; 2]>| Line { name: name.into(), points, mark: Mark::Both };
    let travelled = travel.iter().enumerate().map(|(i, t)| [i as f64 + 1.0, *t]).collect();
    let travelled = lines(Room::Half, "iteration", "mean |travel| (mm)", &[both("travel", travelled)])?;
    let travel_caption = "How far the nodes of the single cylinders moved in each iteration.";
    match measured.map(|(truth, _)| errors_by_iteration(reconstruction, truth)) {
        Some(errors) if !errors.is_empty() => {
            let svg = lines(Room::Half, "iteration", "mean error (mm)", &[both("error", errors)])?;
            let caption = "Mean distance of their nodes to the truth; iteration 0 is before the fit.";
            page.plots([(&travelled, travel_caption), (&svg, caption)]);
        }
        _ => drop(page.plot(&travelled, travel_caption)),
    }
    Ok(())
}

/// Mean distance of the single cylinders' nodes to the truth after each iteration, as far as they remember it.
fn errors_by_iteration(reconstruction: &CylinderReconstruction, truth: &Truth) -> Vec<[f64; 2]> {
    let cylinders = &reconstruction.cylinders;
    let iterations = cylinders.iter().map(|c| c.tube.history_mm.len()).min().unwrap_or(0);
    (0..iterations)
        .map(|i| {
            let nodes: Vec<DVec3> =
                cylinders.iter().flat_map(|c| c.nodes_mm(&c.tube.history_mm[i])).collect();
            let sum: f64 = truth.locator().closest_all(&nodes).iter().map(|c| c.distance_mm).sum();
            [i as f64, sum / nodes.len() as f64]
        })
        .collect()
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

/// How far along the vessel each ring's middle is, mm.
fn along_mm(rings: &[Ring]) -> Vec<f64> {
    let middles: Vec<DVec3> =
        rings.iter().map(|r| r.nodes_mm.iter().sum::<DVec3>() / r.nodes_mm.len().max(1) as f64).collect();
    let mut s = 0.0;
    (0..middles.len())
        .map(|i| {
            s += i.checked_sub(1).map_or(0.0, |before| middles[before].distance(middles[i]));
            s
        })
        .collect()
}

fn along_the_vessel(rings: &[Ring], name: &str, of: impl Fn(&Ring) -> f64) -> Line {
    let points = along_mm(rings).into_iter().zip(rings).map(|(s, ring)| [s, of(ring)]).collect();
    Line { name: name.into(), points, mark: Mark::Line }
}

fn coverage(page: &mut Page, rings: &[Ring]) -> Result<()> {
    page.heading("Coverage");
    let nodes: usize = rings.iter().map(|r| r.support.len()).sum();
    let bare = rings.iter().flat_map(|r| &r.support).filter(|&&n| n == 0).count();
    page.paragraph(&format!(
        "{bare} of {nodes} nodes ({:.1} %) have no point on any of their triangles: their place is a guess from their \
         neighbours.",
        100.0 * bare as f64 / nodes.max(1) as f64
    ));
    let mean =
        |ring: &Ring| ring.support.iter().map(|&n| f64::from(n)).sum::<f64>() / ring.support.len() as f64;
    let least = |ring: &Ring| ring.support.iter().copied().min().map_or(f64::NAN, f64::from);
    let svg = lines(
        Room::Whole,
        "along the vessel (mm)",
        "points of a node",
        &[along_the_vessel(rings, "mean of a ring", mean), along_the_vessel(rings, "least of a ring", least)],
    )?;
    page.plot(&svg, "Points on the triangles about a node, ring by ring.");
    Ok(())
}

fn noise(page: &mut Page, reconstruction: &CylinderReconstruction) -> Result<()> {
    let report = &reconstruction.report;
    let points = &report.points;
    page.heading("Noise");
    let in_sections = points.used + points.rejected;
    page.table(&facts(vec![
        ("rays without an echo", share(points.missing, points.recorded + points.missing)),
        ("points rejected as outliers", share(points.rejected, in_sections)),
        ("points outside the radial gate", share(points.gated, in_sections + points.gated)),
    ]));
    page.paragraph("Points count once in every cylinder that they lie in.");
    let rings = &reconstruction.vessel.rings;
    let mean = |ring: &Ring| {
        let seen = || ring.residual_mm.iter().filter(|r| r.is_finite());
        seen().sum::<f64>() / seen().count() as f64
    };
    if rings.iter().any(|ring| mean(ring).is_finite()) {
        let line = along_the_vessel(rings, "residual", mean);
        let svg = lines(Room::Whole, "along the vessel (mm)", "mean residual (mm)", &[line])?;
        page.plot(
            &svg,
            "Mean distance of the points from the mesh about them, ring by ring: contour and tracker noise, \
             and what the mesh does not follow.",
        );
    }
    Ok(())
}
