//! Fitting error and time by resolution and iterations, on one recording whose truth is known: the thesis leaves this as
//! future work.

use crate::cylinders::CylinderReconstruction;
use crate::cylinders::fit::Engine;
use crate::evaluate::{Truth, evaluate};
use crate::output::{ending, write_atomically};
use crate::recording::Recording;
use crate::settings::{Method, Settings};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The settings to try: every combination of the three lists.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct StudyGrid {
    /// Nodes per ring.
    pub nodes: Vec<u32>,
    /// Levels of faces.
    pub levels: Vec<u32>,
    /// Iterations of the fit.
    pub iterations: Vec<u32>,
}

impl StudyGrid {
    /// Every combination of the three lists.
    pub fn new(nodes: Vec<u32>, levels: Vec<u32>, iterations: Vec<u32>) -> Self {
        Self { nodes, levels, iterations }
    }

    /// The combinations, the iterations changing fastest; each once.
    pub fn cells(&self) -> Vec<Cell> {
        let mut cells = Vec::new();
        for &nodes in &self.nodes {
            for &levels in &self.levels {
                for &iterations in &self.iterations {
                    let cell = Cell { nodes, levels, iterations };
                    if !cells.contains(&cell) {
                        cells.push(cell);
                    }
                }
            }
        }
        cells
    }
}

/// One combination.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Cell {
    /// Nodes per ring.
    pub nodes: u32,
    /// Levels of faces.
    pub levels: u32,
    /// Iterations of the fit.
    pub iterations: u32,
}

/// The result of one combination.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct StudyRow {
    /// Checksum of recording, truth and the settings that the grid does not change.
    pub inputs: String,
    /// Nodes per ring.
    pub nodes: u32,
    /// Levels of faces.
    pub levels: u32,
    /// Iterations of the fit.
    pub iterations: u32,
    /// Fitting error: mean distance of the mesh's nodes to the truth, mm.
    pub mean_mm: f64,
    /// Median of these distances, mm.
    pub median_mm: f64,
    /// Their 95th percentile, mm.
    pub p95_mm: f64,
    /// Nodes of the mesh.
    pub mesh_nodes: usize,
    /// Time of the fit and the merging of one cylinder, on average, ms: the median of several runs.
    pub ms_per_cylinder: f64,
    /// The engine that was timed.
    pub engine: String,
    /// Threads available to it.
    pub threads: usize,
}

impl StudyRow {
    /// The combination.
    pub fn cell(&self) -> Cell {
        Cell { nodes: self.nodes, levels: self.levels, iterations: self.iterations }
    }
}

/// A recording, its truth and the settings that all combinations share.
pub struct Study<'a> {
    recording: &'a Recording,
    truth: &'a Truth,
    settings: &'a Settings,
    inputs: String,
}

impl<'a> Study<'a> {
    /// A study.
    ///
    /// # Errors
    /// [`Error::Setting`] where the settings are invalid.
    pub fn new(recording: &'a Recording, truth: &'a Truth, settings: &'a Settings) -> Result<Self> {
        settings.validate()?;
        Ok(Self { recording, truth, settings, inputs: checksum(recording, truth, settings)? })
    }

    /// Checksum of recording, truth and the settings that a grid does not change.
    pub fn inputs(&self) -> &str {
        &self.inputs
    }

    /// Reconstructs with one combination `repeats` times (at least once) and measures it.
    ///
    /// # Errors
    /// As [`CylinderReconstruction::of`] and [`evaluate`].
    pub fn measure(&self, cell: Cell, engine: &dyn Engine, repeats: usize) -> Result<StudyRow> {
        let Cell { nodes, levels, iterations } = cell;
        let settings = Settings { nodes, levels, iterations, ..self.settings.clone() };
        let mut times = Vec::new();
        loop {
            let done = CylinderReconstruction::of(self.recording, &settings, engine)?;
            let report = &done.report;
            times.push((report.seconds.fit + report.seconds.merge) * 1e3 / report.cylinders as f64);
            if times.len() < repeats {
                continue;
            }
            times.sort_unstable_by(f64::total_cmp);
            let evaluation = evaluate(&done.vessel.surface(), self.truth)?;
            return Ok(StudyRow {
                inputs: self.inputs.clone(),
                nodes,
                levels,
                iterations,
                mean_mm: evaluation.mesh_to_truth.mean_mm,
                median_mm: evaluation.mesh_to_truth.median_mm,
                p95_mm: evaluation.mesh_to_truth.p95_mm,
                mesh_nodes: report.nodes,
                ms_per_cylinder: times[times.len() / 2],
                engine: report.engine.name.clone(),
                threads: report.threads,
            });
        }
    }

    /// Measures the combinations that `rows` lacks, one after another, and calls `keep` with all rows after each.
    ///
    /// # Errors
    /// As [`Study::measure`], and those of `keep`.
    pub fn run(
        &self,
        grid: &StudyGrid,
        engine: &dyn Engine,
        repeats: usize,
        rows: &mut Vec<StudyRow>,
        mut keep: impl FnMut(&[StudyRow]) -> Result<()>,
    ) -> Result<()> {
        for cell in grid.cells() {
            if !rows.iter().any(|row| row.cell() == cell) {
                rows.push(self.measure(cell, engine, repeats)?);
                keep(rows)?;
            }
        }
        Ok(())
    }

    /// Reads earlier results of this study; none where the file is not there.
    ///
    /// # Errors
    /// [`Error::UnknownEnding`]; [`Error::Input`] where the file holds something else or the results of other inputs.
    pub fn read(&self, path: &Path) -> Result<Vec<StudyRow>> {
        check_ending(path)?;
        let bytes = match std::fs::read(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            read => read.map_err(|source| Error::Read { path: path.into(), source })?,
        };
        let broken = |e: String| Error::input(path, "rows", e, "results of a study");
        let rows: Vec<StudyRow> = match ending(path).as_str() {
            "json" => serde_json::from_slice(&bytes).map_err(|e| broken(e.to_string()))?,
            _ => csv::Reader::from_reader(bytes.as_slice())
                .into_deserialize()
                .collect::<Result<_, _>>()
                .map_err(|e| broken(e.to_string()))?,
        };
        match rows.iter().position(|row| row.inputs != self.inputs) {
            None => Ok(rows),
            Some(i) => Err(Error::input(
                path,
                format!("row {i}: checksum of recording, truth and settings"),
                &rows[i].inputs,
                format!("{}, or another file for these results", self.inputs),
            )),
        }
    }
}

/// Writes results: `.csv` or `.json`.
///
/// # Errors
/// [`Error::UnknownEnding`], [`Error::Write`]; the file is either as before or whole.
pub fn write(rows: &[StudyRow], path: &Path) -> Result<()> {
    check_ending(path)?;
    let json = ending(path) == "json";
    write_atomically(path, |w| {
        if json {
            serde_json::to_writer_pretty(&mut *w, rows)?;
            return writeln!(w);
        }
        let mut writer = csv::Writer::from_writer(w);
        rows.iter().try_for_each(|row| writer.serialize(row))?;
        writer.flush()
    })
}

fn check_ending(path: &Path) -> Result<()> {
    match ending(path) {
        ending if ending == "csv" || ending == "json" => Ok(()),
        ending => Err(Error::UnknownEnding { path: path.into(), ending, expected: ".csv, .json" }),
    }
}

/// Indices of the rows that no other row surpasses in both error and time, fastest first.
pub fn pareto_front(rows: &[StudyRow]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|&a, &b| {
        let time = rows[a].ms_per_cylinder.total_cmp(&rows[b].ms_per_cylinder);
        time.then(rows[a].mean_mm.total_cmp(&rows[b].mean_mm))
    });
    let mut least = f64::INFINITY;
    order.retain(|&i| {
        let better = rows[i].mean_mm < least;
        least = least.min(rows[i].mean_mm);
        better
    });
    order
}

/// The row with the least error among those that take at most so long for a cylinder.
pub fn best_within(rows: &[StudyRow], budget_ms: f64) -> Option<&StudyRow> {
    let affordable = rows.iter().filter(|row| row.ms_per_cylinder <= budget_ms);
    affordable.min_by(|a, b| a.mean_mm.total_cmp(&b.mean_mm))
}

/// CRC-32 of everything that decides a result, but for the grid.
fn checksum(recording: &Recording, truth: &Truth, settings: &Settings) -> Result<String> {
    let mut hasher = crc32fast::Hasher::new();
    let mut add = |values: &[f64]| values.iter().for_each(|v| hasher.update(&v.to_bits().to_le_bytes()));
    for frame in &recording.frames {
        add(&frame.world_from_sensor.rotation.to_cols_array());
        add(&frame.world_from_sensor.translation_mm.to_array());
        frame.contour_mm.iter().for_each(|p| add(&p.to_array()));
        if let Some(c) = &frame.cylinder {
            add(&[c.px_mm, c.py_mm, c.theta_rad, c.phi_rad, c.radius_mm]);
        }
        // Where the frame ends.
        add(&[f64::INFINITY]);
    }
    truth.surface().nodes_mm.iter().for_each(|p| add(&p.to_array()));
    truth.surface().triangles.iter().for_each(|t| add(&t.map(f64::from)));
    let Settings { nodes, levels, iterations, .. } = Settings::default();
    let shared = Settings { method: Method::Cylinders, nodes, levels, iterations, ..settings.clone() };
    hasher.update(shared.to_toml()?.as_bytes());
    Ok(format!("{:08x}", hasher.finalize()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(mean_mm: f64, ms_per_cylinder: f64) -> StudyRow {
        StudyRow {
            inputs: "00000000".into(),
            nodes: 12,
            levels: 5,
            iterations: 3,
            mean_mm,
            median_mm: mean_mm,
            p95_mm: mean_mm,
            mesh_nodes: 72,
            ms_per_cylinder,
            engine: "cpu".into(),
            threads: 1,
        }
    }

    #[test]
    fn nothing_beats_the_pareto_front() {
        let rows = [row(0.5, 1.0), row(0.4, 2.0), row(0.6, 1.5), row(0.4, 3.0), row(0.3, 4.0)];
        assert_eq!(pareto_front(&rows), [0, 1, 4]);
        assert_eq!(pareto_front(&[]), [0; 0]);
    }

    #[test]
    fn the_best_within_a_budget_is_affordable() {
        let rows = [row(0.5, 1.0), row(0.4, 2.0), row(0.3, 4.0)];
        assert_eq!(best_within(&rows, 3.0), Some(&rows[1]));
        assert_eq!(best_within(&rows, 0.5), None);
    }

    #[test]
    fn a_grid_has_each_combination_once() {
        let grid = StudyGrid { nodes: vec![12, 24, 12], levels: vec![5], iterations: vec![1, 3] };
        let cells: Vec<_> = grid.cells().iter().map(|c| (c.nodes, c.levels, c.iterations)).collect();
        assert_eq!(cells, [(12, 5, 1), (12, 5, 3), (24, 5, 1), (24, 5, 3)]);
    }
}
