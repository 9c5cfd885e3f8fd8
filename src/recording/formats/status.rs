//! What trackers say about their poses, beside the poses.

use super::table::{Column, Table, TableRow, is_missing, quoted};
use crate::Result;

/// A column that says whether the tracker saw its sensor.
pub(super) struct StatusColumn {
    column: Column,
    kind: Kind,
    /// The number in the lines before, where there was one.
    number: Option<f64>,
}

/// What may stand in a status column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// `ok`, `valid`, …: 1 or 0, or a word.
    Flag,
    /// `status`, `transform status`, …: a word. Numbers mean other things in each tracker.
    Status,
    /// `state`, `quality`: often about something else, so that only a word for a lost sensor counts.
    Remark,
}

impl Kind {
    fn of(header: &str) -> Option<Self> {
        let name = letters(header);
        match name.strip_prefix("is").unwrap_or(&name) {
            "ok" | "valid" | "tracked" | "visible" | "posevalid" | "poseok" => Some(Kind::Flag),
            "state" | "quality" => Some(Kind::Remark),
            _ if name.ends_with("transformvalid") => Some(Kind::Flag),
            _ if name.ends_with("status") && !name.contains("image") => Some(Kind::Status),
            _ => None,
        }
    }
}

/// Words of a tracker that saw its sensor, and of one that did not: those of PLUS and of NDI's tools, and plain
/// ones.
const SEEN: [&str; 10] =
    ["ok", "good", "valid", "tracked", "tracking", "visible", "enabled", "normal", "true", "yes"];
const LOST: [&str; 32] = [
    "missing",
    "lost",
    "invalid",
    "outofview",
    "outofvolume",
    "partiallyoutofvolume",
    "outofrange",
    "disabled",
    "unknown",
    "reqtimeout",
    "timeout",
    "pathnotfound",
    "switch1ison",
    "switch2ison",
    "switch3ison",
    "notok",
    "notvalid",
    "notvisible",
    "nottracked",
    "nottracking",
    "notfound",
    "notseen",
    "bad",
    "error",
    "fail",
    "failed",
    "absent",
    "occluded",
    "hidden",
    "interference",
    "false",
    "no",
];

/// Whether a word says that the sensor was lost; `None`: no word of a tracker.
pub(super) fn says_lost(word: &str) -> Option<bool> {
    let letters = letters(word);
    let word = letters.strip_prefix("tool").unwrap_or(&letters);
    match () {
        () if SEEN.contains(&word) => Some(false),
        () if LOST.contains(&word) => Some(true),
        () => None,
    }
}

fn letters(text: &str) -> String {
    text.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

impl StatusColumn {
    /// The status columns of a table.
    pub fn all(table: &Table) -> Vec<Self> {
        table.columns_where(Kind::of).map(|(column, kind)| Self { column, kind, number: None }).collect()
    }

    /// Whether a line says that the sensor was lost.
    ///
    /// # Errors
    /// Where what it says cannot be told.
    pub fn is_lost(&mut self, table: &Table, row: &TableRow) -> Result<bool> {
        let field = table.text(row, self.column)?;
        match (says_lost(field), field.parse::<f64>(), self.kind) {
            (Some(lost), ..) => Ok(lost),
            _ if is_missing(field) => Ok(false),
            (None, Ok(number), Kind::Flag) => Ok(number == 0.0),
            (None, Ok(number), Kind::Status) if *self.number.get_or_insert(number) == number => Ok(false),
            (None, Ok(number), Kind::Status) => {
                let before = self.number.unwrap_or(number);
                let expected = "words such as OK and MISSING, or 1 and 0 in a column named valid";
                Err(table.fault(row, self.column, format!("{number} after {before}"), expected))
            }
            (None, _, Kind::Remark) => Ok(false),
            (None, Err(_), _) => {
                Err(table.fault(row, self.column, quoted(field), "OK, or MISSING, INVALID, LOST, …"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_of_plus_and_ndi_are_known() {
        for word in ["OK", "TOOL_OK", "Valid", "true"] {
            assert_eq!(says_lost(word), Some(false), "{word}");
        }
        for word in ["MISSING", "OUT_OF_VIEW", "Partially out of volume", "TOOL_REQ_TIMEOUT", "not ok"] {
            assert_eq!(says_lost(word), Some(true), "{word}");
        }
        assert_eq!(says_lost("systole"), None);
    }

    #[test]
    fn columns_are_known_by_their_names() {
        let kinds = ["OK", "is_valid", "ProbeToTrackerTransformStatus", "tracking status", "state"];
        let kinds = kinds.map(|name| Kind::of(name).unwrap());
        assert_eq!(kinds, [Kind::Flag, Kind::Flag, Kind::Status, Kind::Status, Kind::Remark]);
        for name in ["ImageStatus", "x_mm", "note", "look"] {
            assert_eq!(Kind::of(name), None, "{name}");
        }
    }
}
