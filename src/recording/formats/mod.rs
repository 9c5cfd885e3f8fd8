//! File formats of recordings.

pub(super) mod csv;
pub(super) mod mat;
#[cfg(feature = "mcap")]
pub(super) mod mcap;
pub(super) mod ndjson;
mod status;
mod table;
mod units;

pub(crate) use table::Table;

use super::Recording;
use crate::Error;
use glam::{DMat3, DQuat};
use std::path::{Path, PathBuf};

/// The frames' numbers, or their places where the numbers do not rise, as a reader demands: then the frames
/// were put in another order or come from several files.
pub(super) fn rising_numbers(recording: &Recording) -> impl Iterator<Item = usize> + '_ {
    let numbers =
        |own: bool| (0..recording.frames.len()).map(move |k| if own { recording.number(k) } else { k });
    numbers(numbers(true).is_sorted_by(|a, b| a < b))
}

/// Quaternions this far from unit length are rounded ones.
const UNIT_TOLERANCE: f64 = 1e-3;

/// A rotation from a quaternion that may be rounded. A quaternion of any other norm n gives axes of length n²,
/// which [`Frame::defects`] reports.
fn rotation(q: DQuat) -> DMat3 {
    let norm = q.length();
    if norm == 0.0 {
        return DMat3::ZERO;
    }
    let unit = DMat3::from_quat(q / norm);
    if (norm - 1.0).abs() <= UNIT_TOLERANCE { unit } else { unit * (norm * norm) }
}

/// The file that holds what an error about a frame of the recording `path` is about.
pub(super) fn file_of(path: &Path, error: &Error) -> PathBuf {
    match error {
        Error::Frame { field, .. } if path.is_dir() => path.join(csv::file_of(field)),
        _ => path.to_owned(),
    }
}
