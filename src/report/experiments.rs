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

    let by_iteration = |name: &str, series: &Series| {
        let rows = series.cylinder_spread.iter().enumerate();
        rows.map(|(i, spread)| spread_row(format!("{name}, iteration {i}"), spread)).collect::<Vec<_>>()
    };
    tables.push(Table {
        title: "Table 6: errors of the single cylinders (mm)".into(),
        head: spread_head("cylinders"),
        rows: [by_iteration("noiseless", noiseless), by_iteration("noisy", noisy)].concat(),
        note: format!("Iteration 0 is before the fit. Thesis: {NOT_AT_HAND}."),
    });
    let merged = |name: &str, series: &Series| {
        [("original", &series.original), ("deformed", &series.deformed)]
            .map(|(which, merged)| spread_row(format!("{name}, {which}"), &merged.node_spread))
    };
    tables.push(Table {
        title: "Table 7: errors of the merged mesh's nodes (mm)".into(),
        head: spread_head("nodes"),
        rows: [merged("noiseless", noiseless), merged("noisy", noisy)].concat(),
        note: format!("Thesis: {NOT_AT_HAND}."),
    });
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

    page.heading("Single cylinders (Table 4, Figures 29 and 30)");
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
                "noisy, never bent",
                experiments.noisy_steady.cylinder_spread.iter().map(|s| s.median_mm).collect(),
            ),
            medians("thesis (other vessels)", experiments.thesis.table_4_median_mm.to_vec()),
        ],
    )?;
    page.plot(&svg, "Table 4 as a plot: median over the cylinders of their errors, after each iteration.");
    let (a, b) = (per_cylinder(noiseless)?, per_cylinder(noisy)?);
    page.plots([(&a, "Error of each cylinder, noiseless."), (&b, "Error of each cylinder, noisy.")]);

    page.heading("Merged mesh (Table 5, Figures 31 and 32)");
    page.table(&all[4]);
    let (a, b) = (growth(noiseless)?, growth(noisy)?);
    page.plots([
        (&a, "Error of the mesh as it grows by one cylinder after another, noiseless."),
        (&b, "Error of the mesh as it grows by one cylinder after another, noisy."),
    ]);

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
    page.table(&all[7]);

    page.heading("Where the error is (Figures 35 and 36)");
    let style = Style { array: Some("error_mm".into()), ..Style::default() };
    for (name, mesh) in [("noiseless", &outcome.noiseless_mesh), ("noisy", &outcome.noisy_mesh)] {
        let caption = format!(
            "Distance of the merged mesh's nodes to the truth, {name}; the colours end at 10 times the mean or at the \
             largest error."
        );
        page.mesh(mesh, &style, &caption)?;
    }

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

const NOT_AT_HAND: &str = "not at hand";

const VIOLIN: &str = "The width shows how common an error is, the bar reaches from the first to the third quartile, the dot is \
    the median; the axis ends at the largest 99th percentile.";

fn mm(value: f64) -> String {
    if value != 0.0 && value.abs() < 5e-5 { format!("{value:.1e}") } else { format!("{value:.4}") }
}

fn head<const N: usize>(names: [&str; N]) -> Vec<String> {
    names.map(String::from).to_vec()
}

fn primitive_tables(experiments: &Experiments) -> Vec<Table> {
    let table =
        |title: &str, of: &Convergence, iterations: usize, thesis: &[(usize, f64)], note: &str| Table {
            title: title.into(),
            head: head(["iteration", "mean (mm)", "end rings (mm)", "largest (mm)", "thesis: mean (mm)"]),
            rows: of.iterations[..=iterations.min(of.iterations.len() - 1)]
                .iter()
                .enumerate()
                .map(|(i, step)| {
                    let known = thesis.iter().find(|(iteration, _)| *iteration == i);
                    vec![
                        i.to_string(),
                        mm(step.mean_mm),
                        mm(step.end_rings_mean_mm),
                        mm(step.max_mm),
                        known.map_or_else(|| NOT_AT_HAND.into(), |(_, value)| mm(*value)),
                    ]
                })
                .collect(),
            note: note.into(),
        };
    let frustum = &experiments.frustum;
    let note = format!(
        "A tube of {} mm radius and {} mm height; the wall tapers from {} to {} mm. The thesis's mean after 3 iterations is \
         {}; its other rows are not at hand.",
        frustum.primitive_radius_mm,
        frustum.settings.height_mm,
        frustum.start_radius_mm,
        frustum.end_radius_mm,
        experiments.thesis.frustum_mean_mm_after_3
    );
    let cylinder = &experiments.larger_cylinder;
    let thesis = [(3, experiments.thesis.frustum_mean_mm_after_3)];
    vec![
        table(
            "Table 1: a larger cylinder",
            cylinder,
            3,
            &[],
            &format!(
                "A tube of {} mm radius in a cylinder of {} mm; the radial gate is opened to {} radii.",
                cylinder.primitive_radius_mm, cylinder.end_radius_mm, cylinder.settings.gate[1]
            ),
        ),
        table("Table 2: a frustum, 3 iterations", frustum, 3, &thesis, &note),
        table("Table 3: the same frustum, 10 iterations", frustum, 10, &thesis, "As Table 2."),
    ]
}

fn table_4(experiments: &Experiments) -> Table {
    let median = |series: &Series, i: usize| {
        series.cylinder_spread.get(i).map_or_else(|| "-".into(), |spread| mm(spread.median_mm))
    };
    let iterations = experiments.noisy.cylinder_spread.len();
    let rows = (0..iterations).map(|i| {
        let known = experiments.thesis.table_4_median_mm.get(i);
        vec![
            i.to_string(),
            median(&experiments.noiseless, i),
            median(&experiments.noisy, i),
            median(&experiments.noisy_steady, i),
            known.map_or_else(|| NOT_AT_HAND.into(), |v| mm(*v)),
        ]
    });
    Table {
        title: "Table 4: median fitting error (mm)".into(),
        head: head(["iteration", "noiseless", "noisy", "noisy, tip never bent", "thesis"]),
        rows: rows.collect(),
        note: format!(
            "Median over {} cylinders ({} where the tip is never bent). Which of the thesis's rows this is, noisy or noiseless, \
             is not at hand. The error before the fit depends on how far the vessel is from a cylinder and how well the cylinders \
             were placed: a bent tip sees the wall at a slant, and a cylinder estimated from that starts farther away. With \
             noise, iterations after the first few follow the noise.",
            experiments.noisy.cylinder_frames.len(),
            experiments.noisy_steady.cylinder_frames.len()
        ),
    }
}

fn table_5(experiments: &Experiments) -> Table {
    let rows =
        [("noiseless", &experiments.noiseless), ("noisy", &experiments.noisy)].map(|(noise, series)| {
            let row = |name: &str, original: f64, deformed: f64, rings: String| {
                vec![format!("{noise}, {name}"), mm(original), mm(deformed), rings, NOT_AT_HAND.into()]
            };
            let Series { original, deformed, .. } = series;
            [
                row("not merged", original.not_merged_mean_mm, deformed.not_merged_mean_mm, "-".into()),
                row(
                    "merged",
                    original.node_spread.mean_mm,
                    deformed.node_spread.mean_mm,
                    deformed.rings.to_string(),
                ),
            ]
        });
    Table {
        title: "Table 5: merged against not merged, mean error (mm)".into(),
        head: head(["", "original", "deformed", "rings", "thesis"]),
        rows: rows.into_iter().flatten().collect(),
        note:
            "Rings are those of the deformed mesh: stitching drops every ring that a later cylinder overlaps."
                .into(),
    }
}

fn spread_head(count: &str) -> Vec<String> {
    head(["", count, "mean", "sd", "least", "25 %", "median", "75 %", "95 %", "largest"])
}

fn spread_row(name: String, spread: &Spread) -> Vec<String> {
    let numbers = [
        spread.mean_mm,
        spread.sd_mm,
        spread.min_mm,
        spread.lower_quartile_mm,
        spread.median_mm,
        spread.upper_quartile_mm,
        spread.p95_mm,
        spread.max_mm,
    ];
    [name, spread.count.to_string()].into_iter().chain(numbers.map(mm)).collect()
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
            "A node of the truth is covered where {}. The thesis's values are {NOT_AT_HAND}.",
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
    let line =
        |name: &str, values: &[f64]| Line { name: name.into(), points: numbered(values), mark: Mark::Line };
    let Series { original, deformed, .. } = series;
    lines(
        Room::Half,
        "cylinders merged",
        "mean error (mm)",
        &[line("original", &original.growth_mean_mm), line("deformed", &deformed.growth_mean_mm)],
    )
}
