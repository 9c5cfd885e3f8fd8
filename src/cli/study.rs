use super::{print_json, progress, read_screened, refuse_inputs};
use crate::cylinders::fit::engine;
use crate::evaluate::Truth;
use crate::output::write_atomically;
use crate::report::{Table, study_plot};
use crate::settings::{Backend, Settings};
use crate::study::resolution::{Study, StudyGrid, StudyRow, best_within, pareto_front, write};
use crate::surface::Surface;
use crate::{Error, Result};
use std::path::PathBuf;

/// Find the resolution and the number of iterations that suit a recording
///
/// Every combination is reconstructed and measured against the truth: error against time, the Pareto front, and the
/// best setting within a time budget. With -o, results are saved row by row, and an interrupted study continues where
/// it stopped.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh study recording/ --truth wall.vtp
  lumenmesh study recording/ --truth wall.vtp --nodes 12,24,48 --levels 5,8 --iterations 1,3,10 -o study.csv
  lumenmesh study recording/ --truth wall.vtp --budget-ms 5 -o study.csv --plot study.svg")]
pub(super) struct Arguments {
    /// Recording: a MATLAB .mat file (v4 to v7.3), a folder of CSV files or a sequence file (.igs.mha, .igs.nrrd, …)
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// The vessel's wall
    #[arg(long, value_name = "SURFACE")]
    truth: PathBuf,
    /// Nodes per ring
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', default_values_t = [12, 24, 48])]
    nodes: Vec<u32>,
    /// Levels of faces per cylinder
    #[arg(long, value_name = "L,L,…", value_delimiter = ',', default_values_t = [5, 8])]
    levels: Vec<u32>,
    /// Iterations of the fit
    #[arg(long, value_name = "COUNT,…", value_delimiter = ',', default_values_t = [1, 3, 10])]
    iterations: Vec<u32>,
    /// Results: .csv or .json; an existing file is read first
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Error over time as a plot: .svg
    #[arg(long, value_name = "SVG")]
    plot: Option<PathBuf>,
    /// Time that one cylinder may take: name the best setting within it, ms
    #[arg(long, value_name = "MS")]
    budget_ms: Option<f64>,
    /// Runs of each combination; the median time counts
    #[arg(long, value_name = "COUNT", default_value_t = 3)]
    repeats: usize,
    /// All other settings, from a TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Backend, the same for all combinations so that their times are comparable
    #[arg(long, value_enum, default_value = "cpu")]
    backend: Backend,
    /// Print JSON instead of a table
    #[arg(long)]
    json: bool,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        refuse_inputs(
            [self.output.as_deref(), self.plot.as_deref()],
            [Some(&*self.recording), Some(&*self.truth), self.config.as_deref()],
        )?;
        let settings = match &self.config {
            Some(path) => Settings::read_toml(path)?,
            None => Settings::default(),
        };
        let settings = Settings { backend: self.backend, ..settings };
        if let Some(path) = self.plot.as_deref().filter(|path| crate::output::ending(path) != "svg") {
            let ending = crate::output::ending(path);
            return Err(Error::UnknownEnding { path: path.into(), ending, expected: ".svg" });
        }
        let grid = StudyGrid {
            nodes: self.nodes.clone(),
            levels: self.levels.clone(),
            iterations: self.iterations.clone(),
        };
        let cells = grid.cells();
        for cell in &cells {
            let (nodes, levels) = (cell.nodes, cell.levels);
            Settings { nodes, levels, ..settings.clone() }.validate()?;
        }
        let (recording, _) = read_screened(&self.recording, &settings)?;
        let truth = Truth::new(Surface::read(&self.truth)?)?;
        let study = Study::new(&recording, &truth, &settings)?;
        let mut rows = match &self.output {
            Some(path) => study.read(path)?,
            None => Vec::new(),
        };
        let known = |rows: &[StudyRow]| cells.iter().filter(|&&c| rows.iter().any(|r| r.cell() == c)).count();
        let resumed = known(&rows);

        let engine = engine(&settings)?;
        let bar = progress::bar("measuring settings", cells.len());
        bar.set_position(resumed as u64);
        let done = study.run(&grid, &*engine, self.repeats, &mut rows, |rows| {
            bar.set_position(known(rows) as u64);
            self.output.as_ref().map_or(Ok(()), |path| write(rows, path))
        });
        bar.finish_and_clear();
        done.map_err(|e| e.in_file(&self.recording))?;

        // Rows of an earlier grid stay in the file and are left out here.
        rows.retain(|row| cells.contains(&row.cell()));
        let front = pareto_front(&rows);
        let best = self.budget_ms.map(|budget| best_within(&rows, budget));
        if let Some(path) = &self.plot {
            let svg = study_plot(&rows)?;
            write_atomically(path, |w| w.write_all(svg.as_bytes()))?;
        }
        if self.json {
            return print_json(&serde_json::json!({
                "inputs": study.inputs(),
                "rows": rows,
                "pareto_front": front.iter().map(|&i| &rows[i]).collect::<Vec<_>>(),
                "budget_ms": self.budget_ms,
                "best_within_budget": best.flatten(),
            }));
        }
        let mut text = table(&rows, &front).to_string();
        if resumed > 0 {
            text += &format!("{resumed} of {} combinations were in the file already.\n", cells.len());
        }
        match (self.budget_ms, best.flatten()) {
            (Some(budget), Some(row)) => {
                text += &format!(
                    "Best within {budget} ms per cylinder: {} nodes, {} levels, {} iterations: {:.4} mm in {:.3} ms.\n",
                    row.nodes, row.levels, row.iterations, row.mean_mm, row.ms_per_cylinder
                );
            }
            (Some(budget), None) => {
                text += &format!("No combination takes at most {budget} ms per cylinder.\n")
            }
            (None, _) => (),
        }
        for path in self.output.iter().chain(&self.plot) {
            text += &format!("wrote {}\n", path.display());
        }
        print!("{}", text);
        Ok(())
    }
}

fn table(rows: &[StudyRow], front: &[usize]) -> Table {
    let cells = rows.iter().enumerate().map(|(i, row)| {
        vec![
            format!("{} × {}, {}", row.nodes, row.levels, row.iterations),
            format!("{:.4}", row.mean_mm),
            format!("{:.4}", row.median_mm),
            format!("{:.4}", row.p95_mm),
            format!("{:.3}", row.ms_per_cylinder),
            if front.contains(&i) { "*".into() } else { String::new() },
        ]
    });
    let head =
        ["nodes × levels, iterations", "mean (mm)", "median (mm)", "95 % (mm)", "ms per cylinder", "front"];
    let threads = rows.first().map_or(0, |row| row.threads);
    Table {
        title: "Fitting error (nodes of the stitched mesh to the truth) and time".into(),
        head: head.map(String::from).to_vec(),
        rows: cells.collect(),
        note: format!(
            "*: no other is better in both mean and time. Time: fit and merge of one cylinder on average, {threads} threads."
        ),
    }
}
