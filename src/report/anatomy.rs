//! What a page shows of a vessel's lumen along its axis, and of two lumens beside each other.

use super::page::{Page, Table};
use super::plot::{Line, Mark, Room, lines};
use super::render::Style;
use super::rows::{facts, share};
use crate::Result;
use crate::anatomy::{
    Interval, Lesion, LesionKind, LesionRules, LumenSection, Overlap, Profile, Sections, VesselTree, places,
};
use crate::evaluate::Distances;
use crate::surface::Surface;

/// Planes across each branch.
const PLANES: f64 = 240.0;
/// Least distance of two planes, mm.
const MIN_STEP_MM: f64 = 0.1;

/// Sections along the branches of a vessel, with their lesions.
pub(super) fn sections(page: &mut Page, surface: &Surface, tree: Result<VesselTree>) -> Result<()> {
    page.heading("Areas and diameters");
    let tree = match tree {
        Ok(tree) => tree,
        Err(error) => {
            page.paragraph(&format!("Not measured: no axis was found ({error})."));
            return Ok(());
        }
    };
    let cutter = Sections::of(surface, Some(&tree))?;
    for (branch, axis) in (0..).zip(&tree.axes) {
        let length_mm = axis.length_mm();
        let found =
            cutter.across(axis, branch, &places(0.0, length_mm, (length_mm / PLANES).max(MIN_STEP_MM))?);
        let profile = Profile::of(&found, &LesionRules::default())?;
        let name = if tree.axes.len() > 1 { format!("Branch {branch}: ") } else { String::new() };
        if profile.at_mm.is_empty() {
            page.paragraph(&titled(&name, "no plane across the axis has a closed outline of the lumen."));
            continue;
        }
        of_branch(page, &name, &found, &profile)?;
    }
    page.paragraph(
        "How to read it: diameters are those of circles of the sections' areas, in planes across the axis. The reference is the \
         diameter that the vessel would have without lesions, fitted to the rest of it. A stenosis lacks at least a quarter \
         of the reference, an aneurysm has at least one and a half times of it; both end at their shoulders, where the \
         diameter is within 5 % of the reference. Numbers in brackets are intervals of 95 %, from the standard errors of the \
         nodes. They do not know of a wrong calibration or speed of sound. A section counts as measured where echoes support \
         the wall about its outline.",
    );
    Ok(())
}

fn of_branch(page: &mut Page, name: &str, found: &[LumenSection], profile: &Profile) -> Result<()> {
    let line = |name: &str, values: &[f64], mark: Mark| Line {
        name: name.into(),
        points: profile.at_mm.iter().zip(values).map(|(&at, &value)| [at, value]).collect(),
        mark,
    };
    let within = |kind: LesionKind| -> Vec<f64> {
        let is_within =
            |at: f64| profile.lesions.iter().any(|l| l.kind == kind && (l.from_mm..=l.to_mm).contains(&at));
        let values = profile.at_mm.iter().zip(&profile.diameter_mm);
        values.map(|(&at, &diameter)| if is_within(at) { diameter } else { f64::NAN }).collect()
    };
    let mut shown = vec![
        line("diameter", &profile.diameter_mm, Mark::Line),
        line("reference", &profile.reference_diameter_mm, Mark::Line),
    ];
    for (kind, name) in [(LesionKind::Stenosis, "stenosis"), (LesionKind::Aneurysm, "aneurysm")] {
        let values = within(kind);
        if values.iter().any(|v| v.is_finite()) {
            shown.push(line(name, &values, Mark::Dots));
        }
    }
    let diameters = lines(Room::Whole, "along the axis (mm)", "circular-equivalent diameter (mm)", &shown)?;
    page.plot(&diameters, &titled(name, "diameter along the axis, with what it would be without lesions."));
    let areas = profile.diameter_mm.iter().map(|d| std::f64::consts::PI * d * d / 4.0).collect::<Vec<_>>();
    let areas = lines(Room::Half, "along the axis (mm)", "area (mm²)", &[line("area", &areas, Mark::Line)])?;
    let measured: Vec<[f64; 2]> =
        found.iter().filter_map(|section| Some([section.at_mm?, 100.0 * section.measured_share?])).collect();
    if measured.is_empty() {
        page.plot(&areas, &titled(name, "cross-sectional area along the axis."));
    } else {
        let measured = Line { name: "measured".into(), points: measured, mark: Mark::Line };
        let measured = lines(Room::Half, "along the axis (mm)", "outline measured (%)", &[measured])?;
        page.plots([
            (&areas, &titled(name, "cross-sectional area along the axis.")),
            (&measured, &titled(name, "share of each outline that echoes support.")),
        ]);
    }
    let mut rows = Vec::new();
    if let Some((area, at_mm)) = profile.minimal_area_mm2.zip(profile.minimal_area_at_mm) {
        rows.push(("minimal lumen area", format!("{} mm², at {at_mm:.1} mm", interval(area, 2))));
    }
    rows.push(("volume of the lumen", format!("{:.0} mm³", profile.volume_mm3)));
    let (planes, closed) = (found.len() as u64, profile.at_mm.len() as u64);
    rows.push((
        "planes with a closed outline of the lumen",
        format!("{} of {planes}", share(closed, planes)),
    ));
    page.table(&facts(rows));
    if profile.lesions.is_empty() {
        page.paragraph(&titled(name, "no stenosis and no aneurysm was found by the rules below."));
        return Ok(());
    }
    page.table(&lesions_table(name, &profile.lesions));
    Ok(())
}

/// A sentence about a branch, or about the only one.
fn titled(branch: &str, text: &str) -> String {
    match branch {
        "" => text[..1].to_uppercase() + &text[1..],
        branch => format!("{branch}{text}"),
    }
}

fn interval(of: Interval, decimals: usize) -> String {
    let Interval { value, low, high, .. } = of;
    match low.is_finite() && high.is_finite() {
        true => format!("{value:.decimals$} ({low:.decimals$} to {high:.decimals$})"),
        false => format!("{value:.decimals$}"),
    }
}

fn lesions_table(name: &str, lesions: &[Lesion]) -> Table {
    let row = |lesion: &Lesion| {
        let kind = match lesion.kind {
            LesionKind::Stenosis => "stenosis",
            LesionKind::Aneurysm => "aneurysm",
        };
        vec![
            kind.into(),
            format!("{:.1}", lesion.at_mm),
            format!("{:.1} to {:.1}", lesion.from_mm, lesion.to_mm),
            interval(lesion.area_mm2, 1),
            interval(lesion.diameter_mm, 2),
            interval(lesion.reference_diameter_mm, 2),
            interval(lesion.diameter_stenosis_percent, 1),
            interval(lesion.area_stenosis_percent, 1),
        ]
    };
    let remarks =
        lesions.iter().filter_map(|l| Some(format!("At {:.1} mm: {}.", l.at_mm, l.remark.as_ref()?)));
    Table {
        title: titled(name, "lesions"),
        head: [
            "",
            "at (mm)",
            "from, to (mm)",
            "area (mm²)",
            "diameter (mm)",
            "reference (mm)",
            "diameter stenosis (%)",
            "area stenosis (%)",
        ]
        .map(String::from)
        .to_vec(),
        rows: lesions.iter().map(row).collect(),
        note: remarks.collect::<Vec<_>>().join(" "),
    }
}

/// Two vessels that are shown beside each other.
#[non_exhaustive]
pub struct Comparison<'a> {
    /// Names of both, such as their files.
    pub names: [&'a str; 2],
    /// The first one, with the array `error_mm`: distances of its nodes to the second.
    pub surface: &'a Surface,
    /// Distances from the first's nodes to the second's wall, and back.
    pub distances: [Distances; 2],
    /// Mean of the first's nodes, mm; positive where it lies outside of the second.
    pub signed_mean_mm: f64,
    /// Areas along the common axis.
    pub overlap: &'a Overlap,
    /// The command that reproduces it.
    pub command: &'a str,
}

impl<'a> Comparison<'a> {
    /// What a page shows of two vessels.
    pub fn new(
        names: [&'a str; 2],
        surface: &'a Surface,
        distances: [Distances; 2],
        signed_mean_mm: f64,
        overlap: &'a Overlap,
        command: &'a str,
    ) -> Self {
        Self { names, surface, distances, signed_mean_mm, overlap, command }
    }
}

/// Two vessels on one page: distances, areas along the axis, and where they differ, in colours.
///
/// # Errors
/// Where a figure has nothing to show.
pub fn comparison_page(content: &Comparison) -> Result<String> {
    let Comparison { names: [a, b], surface, distances: [forth, back], overlap, .. } = content;
    let mut page = Page::new(&format!("{a} and {b}"));
    page.heading("Summary");
    page.table(&facts(vec![
        ("A", (*a).into()),
        ("B", (*b).into()),
        ("Hausdorff's distance", format!("{:.3} mm", forth.max_mm.max(back.max_mm))),
        ("Dice's coefficient of the lumens", format!("{:.4}", overlap.dice)),
        ("volume, from A to B", format!("{:+.2} %", overlap.volume_difference_percent)),
        ("areas, median of |difference|", format!("{:.2} %", overlap.median_absolute_difference_percent)),
        ("A outside of B by (signed mean)", format!("{:.3} mm", content.signed_mean_mm)),
        ("planes in which both are closed", format!("{} of {}", overlap.compared, overlap.areas.len())),
    ]));
    let row = |name: &str, d: &Distances| {
        let numbers = [d.mean_mm, d.rms_mm, d.median_mm, d.p95_mm, d.max_mm];
        std::iter::once(name.into()).chain(numbers.map(|x| format!("{x:.3}"))).collect()
    };
    page.table(&Table {
        title: "Distances of nodes to the other wall (mm)".into(),
        head: ["", "mean", "root mean square", "median", "95th percentile", "largest"]
            .map(String::from)
            .to_vec(),
        rows: vec![row("A to B", forth), row("B to A", back)],
        note: String::new(),
    });
    page.heading("Areas");
    let line = |name: &str, of: &dyn Fn(&crate::anatomy::AreaPair) -> f64| Line {
        name: name.into(),
        points: overlap.areas.iter().map(|pair| [pair.at_mm, of(pair)]).collect(),
        mark: Mark::Line,
    };
    let areas = lines(
        Room::Whole,
        "along the axis of A (mm)",
        "area (mm²)",
        &[line("A", &|p| p.a_mm2), line("B", &|p| p.b_mm2), line("in both", &|p| p.both_mm2)],
    )?;
    page.plot(&areas, "Cross-sectional areas in the same planes across the axis of A.");
    let difference = lines(
        Room::Whole,
        "along the axis of A (mm)",
        "difference of area (%)",
        &[line("B less A", &|p| p.difference_percent)],
    )?;
    page.plot(&difference, "Area of B less that of A, in per cent of A.");
    let missing: Vec<Vec<String>> = overlap
        .areas
        .iter()
        .filter_map(|pair| Some(vec![format!("{:.2}", pair.at_mm), pair.remark.clone()?]))
        .collect();
    if !missing.is_empty() {
        let more = missing.len().saturating_sub(MAX_ROWS);
        page.table(&Table {
            title: "Planes without an area".into(),
            head: ["at (mm)", ""].map(String::from).to_vec(),
            rows: missing.into_iter().take(MAX_ROWS).collect(),
            note: if more > 0 { format!("And {more} more.") } else { String::new() },
        });
    }
    page.heading("Where they differ");
    let style = Style { array: Some("error_mm".into()), ..Style::default() };
    page.mesh(surface, &style, "A from three sides, in the colours of the distance to B.")?;
    page.heading("How to reproduce");
    page.listing(content.command);
    page.paragraph("Nothing was registered: both vessels are taken as they lie.");
    Ok(page.finish())
}

/// Planes without an area that a page lists.
const MAX_ROWS: usize = 40;
