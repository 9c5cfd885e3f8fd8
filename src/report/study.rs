//! A study's results as a plot.

use super::plot::{Line, Mark, Room, lines};
use crate::Result;
use crate::study::resolution::{StudyRow, pareto_front};

/// Error over time of every row, and the Pareto front, as SVG.
///
/// # Errors
/// [`Error::Setting`](crate::Error::Setting) without rows.
pub fn study_plot(rows: &[StudyRow]) -> Result<String> {
    let point = |row: &StudyRow| [row.ms_per_cylinder, row.mean_mm];
    let front = pareto_front(rows).into_iter().map(|i| point(&rows[i])).collect();
    let all = rows.iter().map(point).collect();
    lines(
        Room::Whole,
        "time of a cylinder (ms)",
        "fitting error (mm)",
        &[
            Line { name: "settings".into(), points: all, mark: Mark::Dots },
            Line { name: "Pareto front".into(), points: front, mark: Mark::Both },
        ],
    )
}
