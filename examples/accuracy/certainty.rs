//! Whether standard errors hold: the distances of nodes from the truth in units of theirs, over all kinds of errors.

use super::{kinds, replace_table};
use lumenmesh::Result;
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::output::write_atomically;
use lumenmesh::reconstruction::{LumenReport, Reconstructor};
use lumenmesh::report::plot::{Line, Mark, Room, lines};
use lumenmesh::settings::Settings;
use lumenmesh::simulate::{FaultKind, Insertion};
use lumenmesh::surface::Surface;
use lumenmesh::sweep::{AlikeErrors, Beat, RecordingErrors};
use rayon::prelude::*;
use std::path::Path;

const BEGIN: &str =
    "<!-- standard errors: written by `cargo run --release --example accuracy -- --standard-errors` -->\n";
const END: &str = "<!-- standard errors: end -->\n";
const PICTURE: &str = "docs/images/standard_errors.svg";

/// The recordings: a name, the vessel, whether the catheter only advances, and the first seed.
pub(super) const RECORDINGS: [(&str, &str, bool, u64); 4] = [
    ("arch", "arch", true, 7),
    ("iliac", "aorto_iliac_bifurcation_vmtk", true, 11),
    ("coarctation", "aorta_arch_coarctation_bpm120", true, 5),
    ("stenosis, tip turned", "stenosis", false, 3),
];
/// Recordings of each vessel and kind, by their distance from the first seed. Errors of neighbouring nodes are alike, so that
/// the nodes of a single one say little.
pub(super) const SEEDS: [u64; 4] = [0, 100, 200, 300];
/// Speed of a catheter that only advances, mm/s.
const SPEED_MM_S: f64 = 2.4;

/// Kinds whose errors have something in common. Of the last ones a single pass cannot show the size.
const GROUPS: [(&str, &[&str]); 4] = [
    (
        "each ray or frame",
        &[
            "none",
            "dropouts",
            "spikes",
            "shadow",
            "shadow-turning",
            "tracker-white",
            "shake",
            "stale",
            "latency",
            "smooth-frames",
            "repeated-frames",
            "few-rays",
            "many-rays",
            "reversed-points",
            "unordered-points",
            "glitch",
            "glitches",
            "freezes",
            "pulsation",
            "calibration-rotation",
        ],
    ),
    (
        "artefacts",
        &[
            "shadow-chord",
            "shadow-chord-turning",
            "ring-down",
            "ring-down-turning",
            "burst-small",
            "burst-large",
            "burst-shape",
            "burst-media",
        ],
    ),
    ("that last", &["smooth", "tracker-1s", "tracker-5s"]),
    ("not to be seen", &["drift", "breathing", "heart-beat", "calibration-offset", "sound-speed"]),
];

/// Distances of supported nodes from the truth, and their standard errors, mm.
pub(super) struct Certainty(Vec<(f64, f64)>);

impl Certainty {
    /// Of the supported nodes of a sweep, with the distance of each node from the truth.
    pub(super) fn of(surface: &Surface, error_mm: &[f64]) -> Self {
        let array = |name| surface.array(name).unwrap_or_default();
        let (supported, standard) = (array("supported"), array("standard_error_mm"));
        let nodes = (0..error_mm.len()).filter(|&node| supported.get(node).is_some_and(|&s| s > 0.0));
        Self(nodes.map(|node| (error_mm[node].abs(), standard[node])).collect())
    }

    /// The nodes of several sweeps.
    pub(super) fn pooled(all: Vec<Self>) -> Self {
        Self(all.into_iter().flat_map(|one| one.0).collect())
    }

    fn share(&self, is: impl Fn(&(f64, f64)) -> bool) -> f64 {
        self.0.iter().filter(|node| is(node)).count() as f64 / self.0.len().max(1) as f64
    }

    /// Share of the nodes within so many standard errors.
    fn within(&self, times: f64) -> f64 {
        self.share(|&(error, standard)| error <= times * standard)
    }

    /// The spread of the distances in standard errors: the root mean square, of which more than 10 count as 10.
    pub(super) fn spread(&self) -> f64 {
        let squares = self.0.iter().map(|(error, standard)| (error / standard).min(10.0).powi(2));
        (squares.sum::<f64>() / self.0.len().max(1) as f64).sqrt()
    }

    /// Share of the nodes more than 1 mm off the wall; shares within 1, 2 and 3 standard errors; rank correlation
    /// (Spearman's) of the distances and the standard errors.
    pub(super) fn cells(&self) -> [String; 3] {
        let [one, two, three] = [1.0, 2.0, 3.0].map(|times| 100.0 * self.within(times));
        [
            format!("{:.1} %", 100.0 * self.share(|&(error, _)| error > 1.0)),
            format!("{one:.0}; {two:.0}; {three:.0} %"),
            format!("{:.2}", rank_correlation(&self.0)),
        ]
    }
}

/// How the catheter goes, where it only advances or not.
pub(super) fn insertion(is_steady: bool) -> Insertion {
    match is_steady {
        true => Insertion::steady().with_speed_mm_s(SPEED_MM_S),
        false => Insertion::default(),
    }
}

/// A recording's sweep against the truth.
struct Judged {
    mean_mm: f64,
    certainty: Certainty,
    /// The errors that the report found.
    found: String,
}

fn judged(kind: Option<FaultKind>, vessel: &str, is_steady: bool, seed: u64) -> Result<Judged> {
    let simulation = kinds::simulated(kind, vessel, insertion(is_steady), seed)?;
    let truth = Truth::new(simulation.vessel.surface().clone())?;
    let lumen = Reconstructor::new(Settings::default()).run(&simulation.recording)?;
    let surface = lumen.surface();
    let evaluation = evaluate(&surface, &truth)?;
    let errors = match lumen.report() {
        LumenReport::Sweep(report) => report.errors.as_ref(),
        LumenReport::Branches(report) => report.branches[0].sweep.errors.as_ref(),
        LumenReport::Cylinders(_) | _ => None,
    };
    Ok(Judged {
        mean_mm: evaluation.mesh_to_truth.mean_mm,
        certainty: Certainty::of(&surface, &evaluation.error_mm),
        found: errors.map(found).unwrap_or_default(),
    })
}

/// Measures all kinds and writes table and picture, or prints those with `wanted` in their names.
pub(super) fn run(wanted: Option<&str>) -> Result<()> {
    let mut table = String::from(
        "| error | vessel | mean, mm | > 1 mm | within 1, 2, 3 s.e. | spread | rank | errors that were found |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    let mut of_groups: [Vec<(f64, f64)>; GROUPS.len()] = Default::default();
    for (name, kind) in kinds::named(wanted) {
        let mut of_kind = Vec::new();
        for (short, vessel, is_steady, seed) in RECORDINGS {
            let all: Vec<Judged> = SEEDS
                .into_par_iter()
                .map(|more| judged(kind, vessel, is_steady, seed + more))
                .collect::<Result<_>>()?;
            let means_mm: Vec<f64> = all.iter().map(|one| one.mean_mm).collect();
            let means = summary(means_mm.iter().sum::<f64>() / all.len() as f64, &means_mm, 3);
            let found = all[0].found.clone();
            let certainty = Certainty::pooled(all.into_iter().map(|one| one.certainty).collect());
            table += &row([name, short, &means, &found], &certainty);
            of_kind.extend(certainty.0);
        }
        table += &row([name, "all", "", ""], &Certainty(of_kind.clone()));
        if let Some(group) = GROUPS.iter().position(|(_, kinds)| kinds.contains(&name)) {
            of_groups[group].extend(of_kind);
        }
    }
    if wanted.is_none() {
        replace_table("", &table, BEGIN, END)?;
        let picture = picture(of_groups.map(Certainty))?;
        write_atomically(Path::new(PICTURE), |out| out.write_all(picture.as_bytes()))?;
    }
    Ok(())
}

/// A value, with the least and the greatest of the single recordings.
pub(super) fn summary(value: f64, of_recordings: &[f64], decimals: usize) -> String {
    let (least, greatest) =
        of_recordings.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
    format!("{value:.decimals$} ({least:.decimals$} to {greatest:.decimals$})")
}

/// A row of the table, which it prints as well.
fn row([name, short, means, found]: [&str; 4], certainty: &Certainty) -> String {
    let [far, shares, rank] = certainty.cells();
    let spread = certainty.spread();
    let row = format!("| {name} | {short} | {means} | {far} | {shares} | {spread:.2} | {rank} | {found} |\n");
    print!("{row}");
    row
}

/// The reliability diagram: the share of nodes within so many standard errors, beside that of a normal distribution.
fn picture(of_groups: [Certainty; GROUPS.len()]) -> Result<String> {
    let steps = || (0..=60).map(|k| f64::from(k) / 20.0);
    let normal = Line {
        name: "normal".into(),
        points: steps().map(|z| [z, 100.0 * within_normal(z)]).collect(),
        mark: Mark::Line,
    };
    let of_group = |((name, _), certainty): (&(&str, &[&str]), &Certainty)| Line {
        name: (*name).into(),
        points: steps().map(|z| [z, 100.0 * certainty.within(z)]).collect(),
        mark: Mark::Line,
    };
    let all: Vec<Line> = std::iter::once(normal).chain(GROUPS.iter().zip(&of_groups).map(of_group)).collect();
    lines(Room::Whole, "standard errors", "nodes within so many (%)", &all)
}

/// The share of a normal distribution within so many standard deviations.
fn within_normal(z: f64) -> f64 {
    // Simpson's rule over the density.
    let density = |x: f64| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    let step = z / 100.0;
    let weight = |k: u32| if k == 0 || k == 100 { 1.0 } else { f64::from(2 + 2 * (k % 2)) };
    2.0 * (0..=100).map(|k| weight(k) * density(f64::from(k) * step)).sum::<f64>() * step / 3.0
}

/// The errors that a report found, in a line.
fn found(errors: &RecordingErrors) -> String {
    let alike = |what: &str, errors: &[AlikeErrors]| -> String {
        let one = |e: &AlikeErrors| {
            let width = e.width_deg.map_or(String::new(), |w| format!(" over {w:.0}°"));
            format!("; {what} {:.2}{width} {:.2} s", e.sd_mm, e.correlation_s)
        };
        errors.iter().map(one).collect()
    };
    let beat = |b: &Beat| {
        let what = if b.is_shift { "shifts" } else { "size" };
        format!("; {what} {:.2} at {:.2} Hz", b.sd_mm, b.frequency_hz)
    };
    format!(
        "rays {:.2}{}{}{}; τ {:.3}; {}",
        errors.rays_mm,
        alike("shifts", &errors.shifts),
        alike("contours", &errors.contours),
        errors.beats.iter().map(beat).collect::<String>(),
        errors.roughness,
        errors.descriptions
    )
}

/// The correlation of the ranks of pairs.
fn rank_correlation(pairs: &[(f64, f64)]) -> f64 {
    let ranks = |value: &dyn Fn(usize) -> f64| {
        let mut order: Vec<usize> = (0..pairs.len()).collect();
        order.sort_by(|&a, &b| value(a).total_cmp(&value(b)).then(a.cmp(&b)));
        let mut ranks = vec![0.0; pairs.len()];
        order.iter().enumerate().for_each(|(rank, &i)| ranks[i] = rank as f64);
        ranks
    };
    let (a, b) = (ranks(&|i| pairs[i].0), ranks(&|i| pairs[i].1));
    let n = pairs.len() as f64;
    let apart: f64 = a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum();
    1.0 - 6.0 * apart / (n * (n * n - 1.0))
}
