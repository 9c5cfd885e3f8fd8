//! The thesis's tables and figures beside ours.

use super::page::{Page, Table};
use super::plot::{Line, Mark, Room, Violin, lines, violins};
use super::render::Style;
use crate::Result;
use crate::evaluate;
use crate::study::experiments::{Convergence, DEFINITIONS, Experiments, Outcome, Series, Spread, thesis};

/// Tables 1 to 7, and how far the merged meshes are from the truth both ways.
pub fn tables(experiments: &Experiments) -> Vec<Table> {
    let Experiments { noiseless, noisy, .. } = experiments;
    let mut tables = primitive_tables(experiments);
    tables.push(table_4(experiments));
    tables.push(table_5(experiments));

    tables.push(violin_table(
        experiments,
        "Table 6",
        "noisy",
        noisy,
        experiments.thesis.tables_6_and_7.noisy,
    ));
    tables.push(violin_table(
        experiments,
        "Table 7",
        "noiseless",
        noiseless,
        experiments.thesis.tables_6_and_7.noiseless,
    ));
    tables.push(overall(experiments));
    tables.push(both_ways(experiments));
    tables
}

/// The report of the experiments as one HTML file. `command` is what to type to get it again.
///
/// # Errors
/// Where a figure has nothing to show.
pub fn experiments_page(outcome: &Outcome, command: &str) -> Result<String> {
    let experiments = &outcome.experiments;
    let Experiments { noiseless, noisy, vessel, .. } = experiments;
    let all = tables(experiments);
    let mut page = Page::new(&format!("The thesis's experiments: {}", vessel.name));
    let noise = &experiments.simulation.noise;
    page.paragraph(&format!(
        "A simulated catheter went along {:.0} mm of a vessel whose wall is known exactly ({} triangles). Its {} frames were \
         reconstructed twice, without noise and with noise: position {} mm and rotation {}° of the tracker, {} mm of the \
         contour (standard deviations, seed {}).",
        vessel.branch_length_mm,
        vessel.triangles,
        noisy.frames,
        noise.position_sd_mm,
        noise.rotation_sd_deg,
        noise.contour_sd_mm,
        noise.seed
    ));
    page.paragraph(thesis::WHAT_DIFFERS);
    if vessel.reduced_bends > 0 {
        page.paragraph(&format!(
            "{} bends of the tip were reduced to keep it in the lumen.",
            vessel.reduced_bends
        ));
    }
    for note in &vessel.notes {
        page.paragraph(&format!("The vessel's surface: {note}."));
    }

    page.heading("One tube and a known wall (Tables 1 to 3)");
    for table in &all[..3] {
        page.table(table);
    }
    let convergence = |of: fn(&crate::study::experiments::Iteration) -> f64, name: &str| Line {
        name: name.into(),
        points: experiments.frustum.iterations.iter().enumerate().map(|(i, s)| [i as f64, of(s)]).collect(),
        mark: Mark::Both,
    };
    let svg = lines(
        Room::Whole,
        "iteration",
        "error (mm)",
        &[convergence(|i| i.mean_mm, "all nodes"), convergence(|i| i.end_rings_mean_mm, "end rings")],
    )?;
    page.plot(&svg, "Frustum: mean error after each iteration, of all nodes and of the two end rings.");

    page.heading("Single cylinders (Table 4, Figure 29)");
    page.table(&all[3]);
    let medians = |name: &str, values: Vec<f64>| Line {
        name: name.into(),
        points: values.into_iter().enumerate().map(|(i, v)| [i as f64, v]).collect(),
        mark: Mark::Both,
    };
    let svg = lines(
        Room::Whole,
        "iteration",
        "median error (mm)",
        &[
            medians("noiseless", noiseless.cylinder_spread.iter().map(|s| s.median_mm).collect()),
            medians("noisy", noisy.cylinder_spread.iter().map(|s| s.median_mm).collect()),
            medians(
                "never bent",
                experiments.noisy_steady.cylinder_spread.iter().map(|s| s.median_mm).collect(),
            ),
            medians("thesis, noisy", experiments.thesis.table_4_median_mm.noisy.to_vec()),
            medians("thesis, noiseless", experiments.thesis.table_4_median_mm.noiseless.to_vec()),
        ],
    )?;
    page.plot(&svg, "Table 4 as a plot: median over the cylinders of their errors, after each iteration.");
    let svg = lines(
        Room::Whole,
        "cylinder",
        "error (mm)",
        &[series_line("noiseless", last_errors(noiseless)), series_line("noisy", last_errors(noisy))],
    )?;
    page.plot(&svg, "As Figure 29: error of each cylinder after the fit.");
    let (a, b) = (per_cylinder(noiseless)?, per_cylinder(noisy)?);
    page.plots([
        (&a, "Error of each cylinder before and after the fit, noiseless."),
        (&b, "Error of each cylinder before and after the fit, noisy."),
    ]);

    page.heading("Merged mesh (Table 5, Figures 30 to 32)");
    page.table(&all[4]);
    let (a, b) = (growth(noisy)?, growth(noiseless)?);
    page.plots([
        (&a, "As Figure 30: error of the mesh as it grows by one cylinder after another, noisy."),
        (&b, "As Figure 31: the same, noiseless."),
    ]);
    let svg = lines(
        Room::Whole,
        "cylinders merged",
        "mean error (mm)",
        &[
            series_line("noiseless", &noiseless.deformed.growth_mean_mm),
            series_line("noisy", &noisy.deformed.growth_mean_mm),
        ],
    )?;
    page.plot(&svg, "As Figure 32: error of the growing deformed mesh.");

    page.heading("Distributions (Tables 6 and 7, Figures 33 and 34)");
    page.table(&all[5]);
    let violin = |name: String, values: &[f64]| Violin { name, values: values.to_vec() };
    let ends = |series: &Series, noise: &str| {
        let last = series.cylinder_error_mm.len() - 1;
        [0, last].map(|i| violin(format!("{noise}\niteration {i}"), &series.cylinder_error_mm[i]))
    };
    let svg =
        violins("error of a cylinder (mm)", &[ends(noiseless, "noiseless"), ends(noisy, "noisy")].concat())?;
    page.plot(&svg, &format!("Errors of the single cylinders. {VIOLIN}"));
    page.table(&all[6]);
    let ends = |series: &Series, noise: &str| {
        [("original", &series.original), ("deformed", &series.deformed)]
            .map(|(which, merged)| violin(format!("{noise}\n{which}"), &merged.node_error_mm))
    };
    let svg =
        violins("error of a node (mm)", &[ends(noiseless, "noiseless"), ends(noisy, "noisy")].concat())?;
    page.plot(&svg, &format!("Errors of the merged mesh's nodes. {VIOLIN}"));
    page.table(&all[8]);

    page.heading("Where the error is (Figures 35 and 36)");
    let style = Style { array: Some("error_mm".into()), ..Style::default() };
    for (name, mesh) in [("noiseless", &outcome.noiseless_mesh), ("noisy", &outcome.noisy_mesh)] {
        let caption = format!(
            "Distance of the merged mesh's nodes to the truth, {name}; the colours end at 10 times the mean or at the \
             largest error."
        );
        page.mesh(mesh, &style, &caption)?;
        page.viewer(&format!("The vessel, {name}"), mesh, None);
    }

    page.table(&all[7]);
    page.heading("What the thesis says about its figures");
    let beside: Vec<(&str, String)> = experiments
        .thesis
        .statements
        .iter()
        .zip(ours(experiments))
        .map(|(statement, ours)| (statement.figure, format!("{} Ours: {ours}", statement.says)))
        .collect();
    page.definitions(beside.iter().map(|(figure, text)| (*figure, text.as_str())));

    page.heading("What the numbers mean");
    let rows = DEFINITIONS.into_iter().chain(evaluate::DEFINITIONS);
    page.definitions(rows);
    page.heading("Settings");
    page.listing(&experiments.settings.to_toml()?);
    page.heading("How to reproduce");
    page.listing(command);
    page.paragraph(
        "The same seed gives the same numbers on any number of threads. experiments.json beside this page holds all of \
         them, timings.json how long it took.",
    );
    Ok(page.finish())
}

const VIOLIN: &str = "The width shows how common an error is, the bar reaches from the first to the third quartile, the dot is \
    the median; the axis ends at the largest 99th percentile.";

fn mm(value: f64) -> String {
    if value != 0.0 && value.abs() < 5e-5 { format!("{value:.1e}") } else { format!("{value:.4}") }
}

fn head<const N: usize>(names: [&str; N]) -> Vec<String> {
    names.map(String::from).to_vec()
}

fn primitive_tables(experiments: &Experiments) -> Vec<Table> {
    let table = |title: &str, of: &Convergence, iterations: usize, thesis: &[f64], note: &str| Table {
        title: title.into(),
        head: head([
            "iteration",
            "mean (mm)",
            "radial mean (mm)",
            "end rings (mm)",
            "largest (mm)",
            "thesis: mean (mm)",
            "why they differ",
        ]),
        rows: of.iterations[..=iterations.min(of.iterations.len() - 1)]
            .iter()
            .enumerate()
            .map(|(i, step)| {
                let why = match (i, of.taper_deg() > 0.0) {
                    (0, false) => "The thesis measures to a wall of facets, we to the formula.",
                    (0, true) => "The radial means are equal: our frustum is chosen so.",
                    (_, false) => "Rounding differs.",
                    (_, true) => "The thesis does not give its frustum's dimensions.",
                };
                vec![
                    i.to_string(),
                    mm(step.mean_mm),
                    mm(step.radial_mean_mm),
                    mm(step.end_rings_mean_mm),
                    mm(step.max_mm),
                    thesis.get(i).map_or_else(|| "-".into(), |value| mm(*value)),
                    why.into(),
                ]
            })
            .collect(),
        note: note.into(),
    };
    let frustum = &experiments.frustum;
    let note = format!(
        "A tube of {} mm radius and {} mm height; the wall tapers from {:.4} to {:.4} mm, so that its mean radial distance from \
         the tube is the thesis's before the fit; the rest is our choice. The radial gate is opened to {} radii.",
        frustum.primitive_radius_mm,
        frustum.settings.height_mm,
        frustum.start_radius_mm,
        frustum.end_radius_mm,
        frustum.settings.gate[1]
    );
    let cylinder = &experiments.larger_cylinder;
    let thesis = &experiments.thesis;
    vec![
        table(
            "Table 1: a larger cylinder",
            cylinder,
            3,
            &thesis.table_1_mm,
            &format!(
                "A tube of {} mm radius in a cylinder of {} mm; the radial gate is opened to {} radii.",
                cylinder.primitive_radius_mm, cylinder.end_radius_mm, cylinder.settings.gate[1]
            ),
        ),
        table("Table 2: a frustum, 3 iterations", frustum, 3, &thesis.tables_2_and_3_mm, &note),
        table(
            "Table 3: the same frustum, 10 iterations",
            frustum,
            10,
            &thesis.tables_2_and_3_mm,
            "As Table 2.",
        ),
    ]
}

fn table_4(experiments: &Experiments) -> Table {
    let median = |series: &Series, i: usize| {
        series.cylinder_spread.get(i).map_or_else(|| "-".into(), |spread| mm(spread.median_mm))
    };
    let iterations = experiments.noisy.cylinder_spread.len();
    let known = &experiments.thesis.table_4_median_mm;
    let of_thesis = |values: &[f64; 4], i: usize| values.get(i).map_or_else(|| "-".into(), |v| mm(*v));
    let rows = (0..iterations).map(|i| {
        let why = match i {
            0 => "Another vessel, and cylinders of another estimator, which begin nearer or farther.",
            _ => "Another vessel and other noise: what a cylinder cannot follow is left.",
        };
        vec![
            i.to_string(),
            median(&experiments.noisy, i),
            of_thesis(&known.noisy, i),
            median(&experiments.noiseless, i),
            of_thesis(&known.noiseless, i),
            median(&experiments.noisy_steady, i),
            why.into(),
        ]
    });
    Table {
        title: "Table 4: median fitting error (mm)".into(),
        head: head([
            "iteration",
            "noisy",
            "thesis: noisy",
            "noiseless",
            "thesis: noiseless",
            "noisy, tip never bent",
            "why they differ",
        ]),
        rows: rows.collect(),
        note: format!(
            "Median over {} cylinders ({} where the tip is never bent). The error before the fit depends on how far the vessel is from a cylinder and how well the cylinders \
             were placed: a bent tip sees the wall at a slant, and a cylinder estimated from that starts farther away. With \
             noise, iterations after the first few follow the noise.",
            experiments.noisy.cylinder_frames.len(),
            experiments.noisy_steady.cylinder_frames.len()
        ),
    }
}

fn table_5(experiments: &Experiments) -> Table {
    let thesis = &experiments.thesis;
    let (apart, merged) = (thesis.table_5_not_merged_mm, thesis.table_5_merged_mm);
    let rows = [
        ("noisy", &experiments.noisy, apart.noisy, merged.noisy),
        ("noiseless", &experiments.noiseless, apart.noiseless, merged.noiseless),
    ]
    .map(|(noise, Series { original, deformed, .. }, apart, merged)| {
        [
            vec![
                format!("{noise}, not merged"),
                mm(original.not_merged_mean_mm),
                mm(deformed.not_merged_mean_mm),
                mm(apart),
                "-".into(),
                "Another vessel; a few badly placed cylinders weigh much in a mean.".into(),
            ],
            vec![
                format!("{noise}, merged"),
                mm(original.node_spread.mean_mm),
                mm(deformed.node_spread.mean_mm),
                mm(merged),
                deformed.rings.to_string(),
                "Another vessel, and the thesis does not say which rings its stitching keeps.".into(),
            ],
        ]
    });
    Table {
        title: "Table 5: merged against not merged, mean error (mm)".into(),
        head: head(["", "original", "deformed", "thesis", "rings", "why they differ"]),
        rows: rows.into_iter().flatten().collect(),
        note:
            "Rings are those of the deformed mesh: stitching drops every ring that a later cylinder overlaps."
                .into(),
    }
}

/// A violin's numbers as the thesis gives them, of the merged mesh and of the single cylinders.
fn violin_table(
    experiments: &Experiments,
    title: &str,
    noise: &str,
    series: &Series,
    thesis: thesis::ViolinNumbers,
) -> Table {
    let row = |name: String, spread: &Spread, why: &str| {
        let numbers = [
            spread.mean_mm,
            spread.iqr_mm,
            spread.lower_limit_mm,
            spread.upper_limit_mm,
            spread.lower_quartile_mm,
            spread.median_mm,
            spread.upper_quartile_mm,
            spread.p95_mm,
            spread.max_mm,
        ];
        let numbers = numbers.map(mm).into_iter();
        [name, spread.count.to_string()].into_iter().chain(numbers).chain([why.to_owned()]).collect()
    };
    let mut of_thesis: Vec<String> = vec!["thesis".into(), "-".into()];
    of_thesis.extend([thesis.mean_mm, thesis.iqr_mm, thesis.lower_limit_mm, thesis.upper_limit_mm].map(mm));
    of_thesis.extend(
        ["-", "-", "-", "-", "-", "The thesis does not say whose errors these are."].map(String::from),
    );
    let mut rows = vec![
        of_thesis,
        row("merged, deformed".into(), &series.deformed.node_spread, "Another vessel; errors of its nodes."),
        row("merged, original".into(), &series.original.node_spread, "The same before the fit."),
    ];
    rows.extend(series.cylinder_spread.iter().enumerate().map(|(i, spread)| {
        row(format!("cylinders, iteration {i}"), spread, "Another vessel; means of single cylinders.")
    }));
    Table {
        title: format!("{title}: the violin of the errors, {noise} (mm)"),
        head: head([
            "",
            "count",
            "mean",
            "IQR",
            "lower limit",
            "upper limit",
            "25 %",
            "median",
            "75 %",
            "95 %",
            "largest",
            "why they differ",
        ]),
        rows,
        note: format!(
            "Limits are Q1 - 1.5 IQR and Q3 + 1.5 IQR. Quartiles by nearest rank; {} cylinders.",
            experiments.noisy.cylinder_frames.len()
        ),
    }
}

/// The overall errors that the thesis gives with Figures 35 and 36.
fn overall(experiments: &Experiments) -> Table {
    let known = experiments.thesis.figures_35_and_36_overall_mm;
    let row = |figure: &str, series: &Series, thesis: f64| {
        let evaluation = &series.deformed.evaluation;
        vec![
            figure.into(),
            mm(evaluation.mesh_to_truth.mean_mm),
            mm(evaluation.mesh_to_truth.median_mm),
            mm(thesis),
            "Another vessel, and \"overall fitting error\" is defined nowhere.".into(),
        ]
    };
    Table {
        title: "Figures 35 and 36: overall fitting error of the merged mesh (mm)".into(),
        head: head(["", "mean", "median", "thesis", "why they differ"]),
        rows: vec![
            row("Figure 35, noisy", &experiments.noisy, known.noisy),
            row("Figure 36, noiseless", &experiments.noiseless, known.noiseless),
        ],
        note: "Distances of the mesh's nodes to the truth.".into(),
    }
}

fn both_ways(experiments: &Experiments) -> Table {
    let rows =
        [("noiseless", &experiments.noiseless), ("noisy", &experiments.noisy)].map(|(noise, series)| {
            let evaluation = &series.deformed.evaluation;
            let forth = &evaluation.mesh_to_truth;
            let back = evaluation.truth_to_mesh.as_ref();
            let back = |of: fn(&evaluate::Distances) -> f64| back.map_or_else(|| "-".into(), |d| mm(of(d)));
            vec![
                noise.into(),
                mm(forth.mean_mm),
                mm(forth.rms_mm),
                mm(evaluation.signed_mean_mm),
                back(|d| d.mean_mm),
                back(|d| d.p95_mm),
                format!("{:.1} %", 100.0 * evaluation.covered_area_share),
            ]
        });
    Table {
        title: "The merged mesh against the truth, both ways (mm)".into(),
        head: head(["", "mesh→truth mean", "rms", "signed mean", "truth→mesh mean", "95 %", "truth covered"]),
        rows: rows.to_vec(),
        note: format!(
            "A node of the truth is covered where {}. The thesis measures one way only.",
            experiments.noisy.deformed.evaluation.covered_rule
        ),
    }
}

fn numbered(values: &[f64]) -> Vec<[f64; 2]> {
    values.iter().enumerate().map(|(i, v)| [i as f64 + 1.0, *v]).collect()
}

fn per_cylinder(series: &Series) -> Result<String> {
    let last = series.cylinder_error_mm.len() - 1;
    let line = |name: &str, i: usize| Line {
        name: name.into(),
        points: numbered(&series.cylinder_error_mm[i]),
        mark: Mark::Line,
    };
    lines(Room::Half, "cylinder", "error (mm)", &[line("original", 0), line("deformed", last)])
}

fn growth(series: &Series) -> Result<String> {
    let Series { original, deformed, .. } = series;
    lines(
        Room::Half,
        "cylinders merged",
        "mean error (mm)",
        &[
            series_line("original", &original.growth_mean_mm),
            series_line("deformed", &deformed.growth_mean_mm),
        ],
    )
}

fn series_line(name: &str, values: &[f64]) -> Line {
    Line { name: name.into(), points: numbered(values), mark: Mark::Line }
}

/// Errors of the cylinders after the last iteration.
fn last_errors(series: &Series) -> &[f64] {
    series.cylinder_error_mm.last().map_or(&[], Vec::as_slice)
}

/// The cylinders of which the thesis says something, counted from 1.
const TURNING: std::ops::RangeInclusive<usize> = 102..=116;
const EQUAL: usize = 120;

/// Our numbers for each of the thesis's statements about its figures, in their order.
fn ours(experiments: &Experiments) -> [String; 5] {
    let Experiments { noiseless, noisy, .. } = experiments;
    let (clean, noised) = (last_errors(noiseless), last_errors(noisy));
    let of_120 = match (noised.get(EQUAL - 1), clean.get(EQUAL - 1)) {
        (Some(noisy), Some(clean)) => {
            format!("number {EQUAL} has {} with noise and {} without", mm(*noisy), mm(*clean))
        }
        _ => format!("there are {} cylinders", noised.len()),
    };
    let lower = |low: &[f64], high: &[f64], range: std::ops::Range<usize>| {
        let pairs: Vec<(&f64, &f64)> = low.iter().zip(high).skip(range.start).take(range.len()).collect();
        format!("{} of {}", pairs.iter().filter(|(a, b)| a < b).count(), pairs.len())
    };
    let all = 0..usize::MAX;
    let grown = |series: &Series| {
        let Series { original, deformed, .. } = series;
        let ends = |values: &[f64]| {
            format!(
                "{} to {}",
                mm(values.first().copied().unwrap_or(0.0)),
                mm(values.last().copied().unwrap_or(0.0))
            )
        };
        format!(
            "lower at {} sizes; original from {}, deformed from {} mm",
            lower(&deformed.growth_mean_mm, &original.growth_mean_mm, all.clone()),
            ends(&original.growth_mean_mm),
            ends(&deformed.growth_mean_mm)
        )
    };
    let [growing_clean, growing_noised] = [noiseless, noisy].map(|s| &s.deformed.growth_mean_mm[..]);
    let above = |series: &Series| {
        let Spread { upper_limit_mm, .. } = series.deformed.node_spread;
        let errors = &series.deformed.node_error_mm;
        let above = errors.iter().filter(|e| **e > upper_limit_mm).count();
        100.0 * above as f64 / errors.len().max(1) as f64
    };
    let at_the_end = |series: &Series| {
        let errors: Vec<f64> =
            series.deformed.node_error_mm.iter().copied().filter(|e| e.is_finite()).collect();
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
        let whole = mean(&errors);
        let cut = errors.iter().filter(|e| **e > 10.0 * whole).count();
        format!(
            "{} in the last tenth of the rings, {} in all, {cut} of {} nodes above 10 times the mean",
            mm(mean(&errors[errors.len() - errors.len() / 10..])),
            mm(whole),
            errors.len()
        )
    };
    [
        format!(
            "the correlation of the two over {} cylinders is {:.2}; {of_120}.",
            noised.len().min(clean.len()),
            correlation(clean, noised)
        ),
        format!("noisy {}; noiseless {}.", grown(noisy), grown(noiseless)),
        format!(
            "the one without noise is lower at {} sizes, of those from {} to {} at {}.",
            lower(growing_clean, growing_noised, all.clone()),
            TURNING.start(),
            TURNING.end(),
            lower(growing_clean, growing_noised, TURNING.start() - 1..*TURNING.end())
        ),
        format!(
            "limits by the same rule; {:.1} % of the nodes lie above the upper one with noise, {:.1} % without.",
            above(noisy),
            above(noiseless)
        ),
        format!(
            "noisy {}; noiseless {}. The pictures show where the arch is.",
            at_the_end(noisy),
            at_the_end(noiseless)
        ),
    ]
}

/// Pearson's correlation of two series, over the places where both are finite.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs: Vec<(f64, f64)> =
        a.iter().copied().zip(b.iter().copied()).filter(|(a, b)| a.is_finite() && b.is_finite()).collect();
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
    let (mean_a, mean_b) = (mean(|p| p.0), mean(|p| p.1));
    let sum =
        |of: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|p| of(p.0 - mean_a, p.1 - mean_b)).sum::<f64>();
    sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt()
}
