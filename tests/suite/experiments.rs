//! The thesis's experiments, the study and the pages that show them.

use crate::support::{lumenmesh, shared};
use lumenmesh::cylinders::engine;
use lumenmesh::evaluate::{Coverage, Truth, evaluate, evaluate_covered};
use lumenmesh::geometry::Pose;
use lumenmesh::reconstruction::Reconstructor;
use lumenmesh::recording::Recording;
use lumenmesh::report::{PageContent, experiments_page, html, tables};
use lumenmesh::settings::{Method, Settings};
use lumenmesh::simulate::{self, Centreline, Insertion, Phantom, Shape, SimulatedVessel, Simulation};
use lumenmesh::study::experiments::{Experiments, Outcome, Plan, run};
use lumenmesh::study::resolution::{self, Study, StudyGrid};
use lumenmesh::surface::Surface;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::OnceLock;

fn phantom(name: &str) -> SimulatedVessel {
    Phantom::from(name.parse::<Shape>().unwrap()).vessel().unwrap()
}

/// The quick experiments on the built-in arch, run once for all tests.
fn quick() -> &'static Outcome {
    static OUTCOME: OnceLock<Outcome> = OnceLock::new();
    OUTCOME.get_or_init(|| run_quick(1))
}

fn run_quick(seed: u64) -> Outcome {
    run(phantom("aorta"), &Plan::new("aorta phantom", seed).quick(), &|_, _, _| ()).unwrap()
}

fn json(experiments: &Experiments) -> String {
    serde_json::to_string(experiments).unwrap()
}

#[test]
fn the_number_of_threads_changes_no_number_and_the_seed_does() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        json(&pool.install(|| run_quick(1)).experiments)
    };
    assert_eq!(on(1), on(2));
    assert_ne!(on(1), json(&run_quick(2).experiments));
}

/// Most of the gain comes with the first iteration; with noise the third is a step back, without noise it is not.
fn has_the_pattern_of_table_4(experiments: &Experiments) -> bool {
    let medians = |series: &lumenmesh::study::experiments::Series| -> Vec<f64> {
        series.cylinder_spread.iter().map(|spread| spread.median_mm).collect()
    };
    let (clean, noisy) = (medians(&experiments.noiseless), medians(&experiments.noisy));
    // The first iteration gains most. Without noise the others gain a little more; with noise they lose again, and more
    // than in the thesis, whose cylinders begin farther off.
    let first_gains = |m: &[f64]| m[0] - m[1];
    first_gains(&clean) > 4.0 * (clean[1] - clean[3]).abs()
        && clean[3] < clean[1]
        && first_gains(&noisy) > (noisy[1] - noisy[2]).abs()
        && noisy[1] < noisy[2]
        && noisy[2] < noisy[3]
}

#[test]
fn the_pattern_of_table_4_shows() {
    let experiments = &quick().experiments;
    assert!(has_the_pattern_of_table_4(experiments));
    let mut other = experiments.clone();
    other.noisy.cylinder_spread.swap(1, 0);
    assert!(!has_the_pattern_of_table_4(&other));
}

#[test]
fn an_adult_aorta_at_full_length_is_fitted_as_well_as_the_thesis_fits_its_own() {
    let Some(surface) = shared("data/aorta_adult_full_steve.stl") else { return };
    let Some(centreline) = shared("data/aorta_adult_full_steve_centreline.csv") else { return };
    let branches = Centreline::read_branches(&centreline).unwrap();
    let vessel = SimulatedVessel::new(Surface::read(&surface).unwrap(), branches).unwrap();
    let outcome = run(vessel, &Plan::new("adult aorta", 1), &|_, _, _| ()).unwrap();
    let experiments = &outcome.experiments;
    assert!(has_the_pattern_of_table_4(experiments));
    for (i, spread) in experiments.noisy.cylinder_spread.iter().enumerate().skip(1) {
        let thesis = experiments.thesis.table_4_median_mm.noisy[i];
        assert!(spread.median_mm < thesis, "iteration {i}: {} mm, thesis {thesis}", spread.median_mm);
    }
}

#[test]
fn the_mesh_that_grew_is_the_mesh_that_is_measured() {
    let experiments = &quick().experiments;
    for series in [&experiments.noiseless, &experiments.noisy] {
        assert_eq!(series.original.growth_mean_mm.len(), series.cylinder_frames.len());
        for merged in [&series.original, &series.deformed] {
            let grown = merged.growth_mean_mm.last().unwrap();
            // The same numbers, summed in another order.
            assert!((grown - merged.node_spread.mean_mm).abs() < 1e-12 * grown);
            assert_eq!(merged.node_spread.mean_mm, merged.evaluation.mesh_to_truth.mean_mm);
        }
        assert!(series.deformed.node_spread.mean_mm < series.original.node_spread.mean_mm);
    }
}

fn numbers(value: &serde_json::Value, found: &mut BTreeSet<String>) {
    match value {
        serde_json::Value::Number(n) => {
            let n = n.as_f64().unwrap();
            let shown =
                [format!("{n}"), format!("{n:.4}"), format!("{n:.1e}"), format!("{:.1} %", 100.0 * n)];
            found.extend(shown);
        }
        serde_json::Value::Array(values) => values.iter().for_each(|v| numbers(v, found)),
        serde_json::Value::Object(values) => values.values().for_each(|v| numbers(v, found)),
        _ => (),
    }
}

/// Cells of the tables with a number that the JSON does not hold. First columns count rows.
fn not_in(json: &str, experiments: &Experiments) -> Vec<String> {
    let mut known = BTreeSet::new();
    numbers(&serde_json::from_str(json).unwrap(), &mut known);
    let cells = tables(experiments).into_iter().flat_map(|t| t.rows).flat_map(|row| row.into_iter().skip(1));
    cells.filter(|cell| cell.starts_with(|c: char| c.is_ascii_digit()) && !known.contains(cell)).collect()
}

#[test]
fn every_number_of_the_tables_is_in_the_json() {
    let experiments = &quick().experiments;
    assert_eq!(not_in(&json(experiments), experiments), [""; 0]);
    let mut other = experiments.clone();
    other.noisy.cylinder_spread[2].median_mm = 71.234_56;
    assert_eq!(not_in(&json(experiments), &other).len(), 2, "in Table 4 and in Table 6");
}

/// The numbers of `thesis-figures.md`'s table, which follow the words of each of its rows.
fn thesis_numbers(text: &str) -> Vec<f64> {
    let rows = text.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| where"));
    let values = rows.map(|line| line.trim_end_matches(['|', ' ']).rsplit('|').next().unwrap());
    values.flat_map(|cell| cell.split(", ")).map(|n| n.trim().parse().unwrap()).collect()
}

#[test]
fn every_number_that_the_thesis_prints_is_in_the_json_and_in_the_tables() {
    let Some(path) = shared("spec/thesis-figures.md") else { return };
    let printed = thesis_numbers(&std::fs::read_to_string(path).unwrap());
    assert_eq!(printed.len(), 4 + 11 + 4 + 4 + 2 + 2 + 4 + 4 + 2);
    let experiments = &quick().experiments;
    let mut known = BTreeSet::new();
    let json: serde_json::Value = serde_json::from_str(&json(experiments)).unwrap();
    numbers(&json["thesis"], &mut known);
    let cells: BTreeSet<String> = tables(experiments).into_iter().flat_map(|t| t.rows).flatten().collect();
    let missing = |known: &BTreeSet<String>| {
        let is_missing = |n: &&f64| !known.contains(&format!("{n}"));
        printed.iter().filter(is_missing).copied().collect::<Vec<f64>>()
    };
    assert_eq!(missing(&known), [0.0; 0]);
    let shown = |n: &f64| cells.contains(&format!("{n:.4}")) || cells.contains(&format!("{n:.1e}"));
    assert!(printed.iter().all(shown), "{printed:?}");
    known.remove("0.5187");
    assert_eq!(missing(&known), [0.5187]);
    let page = experiments_page(quick(), "lumenmesh experiments --quick").unwrap();
    assert!(!page.contains("not at hand") && page.contains("but for cylinders 102 to 116"));
}

/// A page without the pages within it, and these as they are written there.
fn apart(page: &str) -> (String, Vec<&str>) {
    let mut parts = page.split("srcdoc=\"");
    let mut outer = parts.next().unwrap_or_default().to_owned();
    let mut inner = Vec::new();
    for part in parts {
        let (within, after) = part.split_once('"').unwrap();
        inner.push(within);
        outer += after;
    }
    (outer, inner)
}

/// Whether a page loads nothing and runs nothing, and the pages within it may not reach a network.
fn is_self_contained(page: &str) -> bool {
    let (page, inner) = apart(page);
    let is_confined = |within: &&str| within.contains("default-src 'none'");
    if !inner.iter().all(is_confined)
        || page.matches("<iframe").count() != page.matches("sandbox=\"allow-scripts ").count()
    {
        return false;
    }
    let sources = page.matches(" src=\"").count() == page.matches(" src=\"data:image/png;base64,").count();
    let links = page.replace("http://www.w3.org/2000/svg", "").contains("http");
    sources && !links && !page.contains("<script") && !page.contains("<link") && !page.contains("url(")
}

#[test]
fn the_page_of_the_experiments_has_all_tables_and_figures() {
    let page = experiments_page(quick(), "lumenmesh experiments --quick").unwrap();
    assert!(is_self_contained(&page));
    assert!(!is_self_contained("<img src=\"error.png\">"));
    assert!(!is_self_contained("<iframe sandbox=\"allow-scripts \" srcdoc=\"&lt;script src=x>\"></iframe>"));
    let (page, inner) = apart(&page);
    assert_eq!(inner.len(), 2, "the vessel with and without noise, to turn");
    for n in 1..=7 {
        assert!(page.contains(&format!("<caption>Table {n}: ")), "table {n}");
    }
    for figures in ["30 to 32", "33 and 34", "35 and 36"] {
        assert!(page.contains(&format!("Figures {figures}")), "figures {figures}");
    }
    assert_eq!((page.matches("<svg").count(), page.matches("<img").count()), (10, 2));
    // Every plot has axes with units; iterations and counts have none.
    assert_eq!(page.matches("(mm)\n</text>").count(), 10);
    assert!(page.contains("lumenmesh experiments --quick"));
}

fn steady(vessel: &str) -> Simulation {
    let insertion = Insertion::steady().with_end_mm(Some(60.0));
    let settings = simulate::SimulationSettings::default().with_insertion(insertion);
    Simulation::run(phantom(vessel), &settings).unwrap()
}

#[test]
fn a_reconstruction_fills_a_page_with_and_without_its_truth() {
    let simulation = steady("stenosis");
    let truth = Truth::new(simulation.vessel.surface().clone()).unwrap();
    let cylinders = Settings::default().with_method(Method::Cylinders);
    for settings in [&cylinders, &Settings::default()] {
        let lumen = Reconstructor::new(settings.clone()).history(true).run(&simulation.recording).unwrap();
        let evaluation = evaluate(&lumen.surface(), &truth).unwrap();
        let page = |content: PageContent| html(&content).unwrap();
        let content = || PageContent::new("A <stenosis>", &simulation.recording, &lumen, "lumenmesh report");
        let (with, without) = (page(content().with_truth(&truth, &evaluation)), page(content()));
        assert!(with.contains(&format!("<td>{:.4}</td>", evaluation.mesh_to_truth.mean_mm)));
        for page in [&with, &without] {
            assert!(is_self_contained(page) && page.contains("<h1>A &lt;stenosis&gt;</h1>"));
            for part in [
                "Summary",
                "Vessel",
                "Areas and diameters",
                "Coverage",
                "Noise",
                "Settings",
                "How to reproduce",
            ] {
                assert!(page.contains(&format!("<h2>{part}</h2>")), "{part}");
            }
            assert_eq!(page.contains("<h2>Convergence</h2>"), settings.method == Method::Cylinders);
        }
        assert!(with.contains("<h2>Error</h2>") && without.contains("<h2>Residual</h2>"));
    }
    let settings = cylinders.with_iterations(0);
    let lumen = Reconstructor::new(settings).run(&simulation.recording).unwrap();
    let command = "lumenmesh report --method cylinders --iterations 0";
    let unfitted = html(&PageContent::new("Cylinders as they are", &simulation.recording, &lumen, command));
    assert!(unfitted.unwrap().contains("nothing was fitted"));
}

#[test]
fn a_side_branch_that_the_probe_never_saw_is_not_covered() {
    // Up to the middle of the trunk, which ends just where the branch leaves it.
    let insertion = Insertion::steady().with_end_mm(Some(40.0));
    let settings = simulate::SimulationSettings::default().with_insertion(insertion);
    let simulation = Simulation::run(phantom("side_branch"), &settings).unwrap();
    let truth = Truth::new(simulation.vessel.surface().clone()).unwrap();
    let coverage =
        Coverage::of(&simulation.recording, Pose::IDENTITY, truth.surface(), Coverage::WITHIN_MM).unwrap();
    for (p, covered) in truth.surface().nodes_mm.iter().zip(&coverage.nodes) {
        // The probe goes from 5 to 40 mm; noise of the tracker and the distance asked for add a little.
        assert!(!covered || (1.0..44.0).contains(&p.z), "{p}");
        assert!(*covered || !(8.0..37.0).contains(&p.z) || p.x > 11.5, "{p}");
    }
    let mesh = truth.surface().clone();
    let evaluation = evaluate_covered(&mesh, &truth, &coverage).unwrap();
    assert!(evaluation.covered_area_share < 0.5, "{}", evaluation.covered_area_share);
    assert!(evaluation.covered_rule.contains("2 mm"));
    assert_eq!(evaluation.hausdorff_mm, 0.0);
    // All but the rims.
    assert!(evaluate(&mesh, &truth).unwrap().covered_area_share > 0.98);
    let far = Pose { translation_mm: glam::DVec3::splat(900.0), ..Pose::IDENTITY };
    let error = Coverage::of(&simulation.recording, far, truth.surface(), 2.0).unwrap_err().to_string();
    assert!(error.contains("same frame of reference"), "{error}");
}

/// A recording, its truth and a small grid.
struct Studied(Recording, Truth, Settings, StudyGrid);

fn studied() -> Studied {
    let simulation = steady("frustum");
    let truth = Truth::new(simulation.vessel.surface().clone()).unwrap();
    let grid = StudyGrid::new(vec![8, 12], vec![5], vec![0, 2]);
    Studied(simulation.recording, truth, Settings::default(), grid)
}

#[test]
fn a_study_that_was_interrupted_goes_on_where_it_was() {
    let Studied(recording, truth, settings, grid) = studied();
    let study = Study::new(&recording, &truth, &settings).unwrap();
    let engine = engine(&settings).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for name in ["study.csv", "study.json"] {
        let path = folder.path().join(name);
        let mut rows = study.read(&path).unwrap();
        assert!(rows.is_empty());
        let interrupted = study.run(&grid, &*engine, 1, &mut rows, |rows| {
            resolution::write(rows, &path)?;
            if rows.len() < 2 { Ok(()) } else { Err(failure()) }
        });
        assert!(interrupted.is_err());
        let mut rows = study.read(&path).unwrap();
        assert_eq!(rows.len(), 2);
        let before = rows.clone();
        let mut measured = 0;
        study
            .run(&grid, &*engine, 1, &mut rows, |rows| {
                measured += 1;
                resolution::write(rows, &path)
            })
            .unwrap();
        assert_eq!((measured, rows.len()), (2, 4));
        assert_eq!(rows[..2], before);
        assert_eq!(study.read(&path).unwrap(), rows);
        let by_iterations = |n| rows.iter().find(|row| row.iterations == n).unwrap().mean_mm;
        assert!(by_iterations(2) < by_iterations(0));
    }
}

fn failure() -> lumenmesh::Error {
    lumenmesh::Error::setting("test", "an interruption", "none")
}

#[test]
fn results_of_other_inputs_are_not_mixed_in() {
    let Studied(recording, truth, settings, grid) = studied();
    let study = Study::new(&recording, &truth, &settings).unwrap();
    let engine = engine(&settings).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("study.csv");
    let rows = [study.measure(grid.cells()[0], &*engine, 1).unwrap()];
    resolution::write(&rows, &path).unwrap();
    let refused = |recording: &Recording, truth: &Truth, settings: &Settings| {
        Study::new(recording, truth, settings).unwrap().read(&path).is_err()
    };
    let mut other = recording.clone();
    other.frames[7].contour_mm[3].x += 1e-9;
    assert!(refused(&other, &truth, &settings));
    assert!(refused(&recording, &truth, &settings.clone().with_every(7)));
    let mut wall = truth.surface().clone();
    wall.nodes_mm[5].z += 1e-9;
    assert!(refused(&recording, &Truth::new(wall).unwrap(), &settings));
    assert!(!refused(&recording, &truth, &settings.clone().with_nodes(99)), "the grid's to choose");
    std::fs::write(&path, "inputs,nodes\n1,2\n").unwrap();
    assert!(study.read(&path).unwrap_err().to_string().contains("study.csv: rows"));
    assert!(study.read(Path::new("study.txt")).is_err());
}

#[test]
fn the_commands_write_what_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| lumenmesh(arguments, folder.path());
    let (status, out, err) = run(&["experiments", "--quick", "--vessel", "small_arch", "--out", "results"]);
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.contains("Table 4: median fitting error (mm)") && out.contains("not public"));
    for name in ["experiments.json", "timings.json", "report.html", "noiseless.vtp", "noisy.vtp"] {
        assert!(out.contains(&format!("wrote results/{name}")), "{name}");
        assert!(folder.path().join("results").join(name).exists(), "{name}");
    }
    let written = std::fs::read_to_string(folder.path().join("results/experiments.json")).unwrap();
    let (_, out, _) = run(&["experiments", "--quick", "--vessel", "small_arch", "--json"]);
    assert_eq!(out.trim_end(), written.trim_end());
    let (status, _, err) = run(&["experiments", "--vessel", "tube"]);
    assert!(status == 1 && err.contains("found tube, expected one of aorta"), "{err}");

    let recording = ["simulate", "--vessel", "small_arch", "--steady", "-o", "recording"];
    let (status, ..) =
        run(&[&recording[..], &["--truth", "wall.vtp", "--truth-centreline", "middle.csv"]].concat());
    assert_eq!(status, 0);
    let grid =
        ["--nodes", "8,12", "--levels", "5", "--iterations", "1,2", "--repeats", "1", "-o", "study.csv"];
    let study = [&["study", "recording", "--truth", "wall.vtp", "--budget-ms", "1e6"], &grid[..]].concat();
    let (status, out, err) = run(&study);
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.contains("Best within 1000000 ms per cylinder"), "{out}");
    let (_, out, _) = run(&study);
    assert!(out.contains("4 of 4 combinations were in the file already"), "{out}");
    let (_, out, _) = run(&[&study[..], &["--json", "--plot", "study.svg"]].concat());
    let summary: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(summary["rows"].as_array().unwrap().len(), 4);
    assert!(std::fs::read_to_string(folder.path().join("study.svg")).unwrap().contains("Pareto front"));
    let (status, _, err) = run(&["study", "recording", "--truth", "wall.vtp", "--nodes", "2"]);
    assert!(status == 1 && err.contains("setting nodes: found 2"), "{err}");

    let (status, out, err) = run(&["report", "recording", "--truth", "wall.vtp", "-o", "page.html"]);
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.contains("page.html") && folder.path().join("page.html").exists());
    let (status, _, err) = run(&["report", "recording", "-o", "page.pdf"]);
    assert!(status == 1 && err.contains("expected one of .html"), "{err}");

    let mesh = ["evaluate", "results/noisy.vtp", "--truth", "wall.vtp"];
    let more = ["--recording", "recording", "--centreline", "middle.csv", "--region", "10"];
    let (status, out, err) = run(&[&mesh[..], &more].concat());
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.contains("within 2 mm") && out.contains("10 to 20 mm") && out.contains("Hausdorff"), "{out}");
    let (_, out, _) = run(&[&mesh[..], &more, &["--json"]].concat());
    let evaluation: serde_json::Value = serde_json::from_str(&out).unwrap();
    let regions = evaluation["regions"].as_array().unwrap();
    let nodes: u64 = regions.iter().filter_map(|r| r["mesh_to_truth"]["nodes"].as_u64()).sum();
    assert_eq!(evaluation["mesh_to_truth"]["nodes"], nodes);
    assert!(evaluation["volumes"]["truth_mm3"].as_f64().unwrap() > 0.0);
}
