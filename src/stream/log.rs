//! A line for every frame, as soon as it was taken.

use super::times::FrameTimes;
use crate::output::ending;
use crate::reconstruction::Change;
use crate::{Error, Result};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A file that grows by a line per frame: CSV or NDJSON, by its ending. Unlike all other outputs it is there
/// from the beginning, so that it can be followed, and so that a process that is killed leaves it.
pub(crate) struct FrameLog {
    path: PathBuf,
    file: File,
    is_csv: bool,
    failed: bool,
}

const COLUMNS: [&str; 15] = [
    "frame",
    "time_s",
    "waiting_ms",
    "screening_ms",
    "axis_ms",
    "placing_ms",
    "solving_ms",
    "showing_ms",
    "latency_ms",
    "rings",
    "changed_rings",
    "echoes",
    "waiting_frames",
    "off_axis",
    "left_out",
];

impl FrameLog {
    /// Refuses a path whose ending names neither format.
    pub(crate) fn check_ending(path: &Path) -> Result<()> {
        match ending(path).as_str() {
            "csv" | "ndjson" | "jsonl" => Ok(()),
            ending => Err(Error::UnknownEnding {
                path: path.to_owned(),
                ending: ending.to_owned(),
                expected: ".csv, .ndjson, .jsonl",
            }),
        }
    }

    /// Begins a file anew.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        Self::check_ending(path)?;
        let file = File::create(path).map_err(|source| Error::write(path, source))?;
        let mut log = Self { path: path.to_owned(), file, is_csv: ending(path) == "csv", failed: false };
        if log.is_csv {
            log.write(COLUMNS.join(","))?;
        }
        Ok(log)
    }

    /// Adds a frame. After a failure nothing more is written, so that no line is missing in between.
    pub(crate) fn frame(
        &mut self,
        number: usize,
        time_s: Option<f64>,
        change: &Change,
        times: &FrameTimes,
    ) -> Result<()> {
        if self.failed {
            return Ok(());
        }
        let ms = |s: f64| format!("{:.3}", s * 1e3);
        let changed: usize = change.changed.iter().map(ExactSizeIterator::len).sum();
        let left_out: Vec<String> = change
            .left_out
            .iter()
            .map(|one| format!("{}: {}: {}", one.frame, one.field, one.found))
            .collect();
        let stages = &times.stages;
        let empty = if self.is_csv { "" } else { "null" };
        let cells = [
            number.to_string(),
            time_s.filter(|t| t.is_finite()).map_or_else(|| empty.into(), |t| t.to_string()),
            ms(times.waiting_s),
            ms(stages.screening_s),
            ms(stages.axis_s),
            ms(stages.placing_s),
            ms(stages.solving_s),
            ms(times.showing_s),
            ms(times.latency_s()),
            change.rings.to_string(),
            changed.to_string(),
            change.work.echoes.to_string(),
            change.waiting.to_string(),
            change.off_axis.to_string(),
            quoted(&left_out.join("; "), self.is_csv),
        ];
        let line = match self.is_csv {
            true => cells.join(","),
            false => {
                let members = COLUMNS.iter().zip(&cells).map(|(name, cell)| format!("\"{name}\":{cell}"));
                format!("{{{}}}", members.collect::<Vec<_>>().join(","))
            }
        };
        let written = self.write(line);
        self.failed = written.is_err();
        written
    }

    fn write(&mut self, mut line: String) -> Result<()> {
        line.push('\n');
        self.file.write_all(line.as_bytes()).map_err(|source| Error::write(&self.path, source))
    }
}

/// A text as a cell of CSV or as JSON.
fn quoted(text: &str, is_csv: bool) -> String {
    match is_csv {
        true if text.is_empty() => String::new(),
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => serde_json::Value::from(text).to_string(),
    }
}
