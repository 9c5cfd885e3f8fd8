//! Rows and texts that several pages share.

use super::page::Table;
use crate::engine::EngineDescription;

/// What a violin plot shows.
pub(super) const VIOLIN: &str = "The width shows how common a value is, the bar reaches from the first to the third quartile, the dot \
    is the median; the axis ends at the largest 99th percentile.";

/// A table of names and values.
pub(super) fn facts(rows: Vec<(&str, String)>) -> Table {
    let rows = rows.into_iter().map(|(name, value)| vec![name.into(), value]).collect();
    Table { rows, ..Table::default() }
}

/// A count and what share of the whole that is.
pub(super) fn share(part: u64, whole: u64) -> String {
    format!("{part} ({:.2} %)", 100.0 * part as f64 / whole.max(1) as f64)
}

/// The engine, and the device or the threads that it ran on.
pub(super) fn engine_row(engine: &EngineDescription, threads: usize) -> String {
    match &engine.adapter {
        Some(adapter) => format!("{} on {adapter}", engine.name),
        None => format!("{} on {threads} threads", engine.name),
    }
}
