//! Frames as JSON objects, one per line, as programs send them while they record.
//!
//! ```json
//! {"time_s": 1.25, "pose": [1,0,0,10, 0,1,0,20, 0,0,1,30, 0,0,0,1], "contour": [[5.1,0.2], null, [4.8,1.1]]}
//! ```
//!
//! | member | |
//! |---|---|
//! | `pose` | the sensor in the world, a 4×4 matrix row by row (16 numbers, or four rows of four), mm; `null`: no pose |
//! | `contour` | points [x, y] in the probe's plane, mm, one per ray; `null` for a ray without an echo, or for no contour at all |
//! | `time_s` | may be absent or `null` |
//! | `phase` | phase of the heart, in cycles; may be absent or `null` |
//! | `frame` | the frame's number, where that is not its place; may be absent |
//! | `cylinder` | the frame's [`CylinderModel`], by the names of its fields; may be absent |
//!
//! NaN, which is not JSON but which Python's `json` writes, is read as `null`. Numbers are written with all
//! their digits: what is read back is equal.

use crate::geometry::Pose;
use crate::output::write_atomically;
use crate::recording::{CylinderModel, Frame, Recording};
use crate::{Error, Result};
use glam::DVec2;
use serde::Serialize;
use serde_json::{Map, Value};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// The longest line that is read, bytes: some 300,000 points.
const LONGEST_LINE: usize = 1 << 24;
/// What a line should be, for messages.
const FORM: &str = "{\"time_s\": s, \"pose\": [16 numbers] or null, \"contour\": [[x, y] or null, …]}";
/// The members of a frame.
const MEMBERS: [&str; 6] = ["time_s", "phase", "pose", "contour", "frame", "cylinder"];
/// The members of a cylinder.
const OF_CYLINDER: [&str; 5] = ["px_mm", "py_mm", "theta_rad", "phi_rad", "radius_mm"];

impl Frame {
    /// A frame from one line of NDJSON: `{"time_s": 1.25, "pose": [16 numbers, row by row, mm] or null,
    /// "contour": [[x, y], …] in mm, null for no echo}`, optionally with `frame` (its number), `phase` (of the heart, in cycles) and `cylinder`.
    ///
    /// # Errors
    /// [`Error::Recording`] that names all members that are unknown, missing or of another kind.
    pub fn from_json(text: &str) -> Result<Self> {
        parse(text).map_err(|found| Error::Recording { field: "frame", found, expected: FORM.into() })
    }

    /// The frame as one line of NDJSON, without the end of the line; [`from_json`](Self::from_json) gives an
    /// equal frame, but that numbers which are not finite become NaN.
    pub fn to_json(&self) -> String {
        let Pose { rotation: r, translation_mm: t } = self.world_from_sensor;
        let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]];
        let pose = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
        let is_whole = pose.as_flattened().iter().all(|x| x.is_finite());
        let point = |p: &DVec2| Some(p.to_array()).filter(|_| !(p.x.is_nan() && p.y.is_nan()));
        let line = Line {
            frame: self.number,
            time_s: self.time_s,
            phase: self.phase,
            pose: is_whole.then_some(pose.as_flattened()),
            contour: self.contour_mm.iter().map(point).collect(),
            cylinder: self.cylinder,
        };
        // A struct of numbers cannot fail to be written.
        serde_json::to_string(&line).unwrap_or_default()
    }
}

#[derive(Serialize)]
struct Line<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    frame: Option<usize>,
    time_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    phase: Option<f64>,
    pose: Option<&'a [f64]>,
    contour: Vec<Option<[f64; 2]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cylinder: Option<CylinderModel>,
}

/// The frame of a line, or all that is wrong with it.
fn parse(text: &str) -> Result<Frame, String> {
    let text = text.trim_start_matches('\u{feff}').trim();
    let value = serde_json::from_str(text).or_else(|error| match text.contains("NaN") {
        true => serde_json::from_str(&text.replace("NaN", "null")),
        false => Err(error),
    });
    let members = match value {
        Ok(Value::Object(members)) => members,
        Ok(other) => return Err(kind(&other).into()),
        Err(error) => return Err(format!("no JSON: {error}")),
    };
    frame_of(&members)
}

/// The frame of an object, or all that is wrong with it.
pub(super) fn frame_of(members: &Map<String, Value>) -> Result<Frame, String> {
    let mut faults = Vec::new();
    faults.extend(unknown(members, &MEMBERS));
    let mut took = |taken: Result<(), String>| faults.extend(taken.err());
    let mut frame = Frame::new(Pose::LOST, Vec::new());
    took(
        number(members.get("time_s")).map(|time_s| frame.time_s = time_s).map_err(|e| format!("time_s: {e}")),
    );
    took(number(members.get("phase")).map(|phase| frame.phase = phase).map_err(|e| format!("phase: {e}")));
    took(
        pose(members.get("pose"))
            .map(|pose| frame.world_from_sensor = pose)
            .map_err(|e| format!("pose: {e}")),
    );
    took(contour(members.get("contour")).map(|c| frame.contour_mm = c).map_err(|e| format!("contour: {e}")));
    took(match members.get("frame") {
        None | Some(Value::Null) => Ok(()),
        Some(value) => match value.as_u64().and_then(|n| usize::try_from(n).ok()) {
            Some(number) => {
                frame.number = Some(number);
                Ok(())
            }
            None => Err(format!("frame: {}, not a whole number from 0 on", shown(value))),
        },
    });
    took(cylinder(members.get("cylinder")).map(|c| frame.cylinder = c).map_err(|e| format!("cylinder: {e}")));
    if !faults.is_empty() {
        return Err(faults.join("; "));
    }
    frame.orthonormalise();
    Ok(frame)
}

fn unknown(members: &Map<String, Value>, known: &[&str]) -> Option<String> {
    const NAMED: usize = 5;
    let unknown: Vec<String> =
        members.keys().filter(|name| !known.contains(&name.as_str())).map(|name| cut(name)).collect();
    match unknown.len() {
        0 => None,
        1 => Some(format!("the unknown member {}", unknown[0])),
        n => Some(format!("{n} unknown members: {}", unknown[..n.min(NAMED)].join(", "))),
    }
}

/// A number, or none where it is `null` or absent.
fn number(value: Option<&Value>) -> Result<Option<f64>, String> {
    match value {
        None | Some(Value::Null) => Ok(None),
        Some(value) => value.as_f64().map(Some).ok_or_else(|| format!("{}, not a number", shown(value))),
    }
}

fn pose(value: Option<&Value>) -> Result<Pose, String> {
    const NUMBERS: &str = "not 16 numbers, row by row, or null";
    let items = match value {
        None => return Err("absent".into()),
        Some(Value::Null) => return Ok(Pose::LOST),
        Some(Value::Array(items)) => items,
        Some(other) => return Err(format!("{}, {NUMBERS}", shown(other))),
    };
    let is_nested = items.len() == 4 && items.iter().all(Value::is_array);
    let flat: Vec<&Value> = match is_nested {
        true => items.iter().filter_map(Value::as_array).flatten().collect(),
        false => items.iter().collect(),
    };
    if flat.len() != 16 {
        return Err(format!("{} numbers, {NUMBERS}", flat.len()));
    }
    let mut matrix = [[0.0; 4]; 4];
    for (to, from) in matrix.as_flattened_mut().iter_mut().zip(flat) {
        *to = number(Some(from))?.unwrap_or(f64::NAN);
    }
    if matrix.as_flattened().iter().any(|x| x.is_nan()) {
        return Ok(Pose::LOST);
    }
    Pose::from_matrix(&matrix).map_err(|row| {
        let column_by_column = [matrix[0][3], matrix[1][3], matrix[2][3]] == [0.0; 3] && matrix[3][3] == 1.0;
        let hint = if column_by_column { ": the matrix is written column by column" } else { "" };
        format!("a last row of {row:?}, not 0 0 0 1{hint}")
    })
}

fn contour(value: Option<&Value>) -> Result<Vec<DVec2>, String> {
    const POINTS: &str = "not points [x, y] in mm, or null where there is no echo";
    let items = match value {
        None => return Err("absent".into()),
        Some(Value::Null) => return Ok(Vec::new()),
        Some(Value::Array(items)) => items,
        Some(other) => return Err(format!("{}, {POINTS}", shown(other))),
    };
    let coordinate = |value: &Value| number(Some(value)).ok().map(|x| x.unwrap_or(f64::NAN));
    let point = |(i, value): (usize, &Value)| match value {
        Value::Null => Ok(DVec2::NAN),
        Value::Array(xy) => match xy.as_slice() {
            [x, y] => coordinate(x).zip(coordinate(y)).map(|(x, y)| DVec2::new(x, y)),
            _ => None,
        }
        .ok_or_else(|| format!("{} at point {i}, {POINTS}", shown(value))),
        other => Err(format!("{} at point {i}, {POINTS}", shown(other))),
    };
    items.iter().enumerate().map(point).collect()
}

fn cylinder(value: Option<&Value>) -> Result<Option<CylinderModel>, String> {
    let members = match value {
        None | Some(Value::Null) => return Ok(None),
        Some(Value::Object(members)) => members,
        Some(other) => return Err(format!("{}, not an object", shown(other))),
    };
    if let Some(unknown) = unknown(members, &OF_CYLINDER) {
        return Err(unknown);
    }
    let field = |name: &str| match number(members.get(name)) {
        Ok(Some(value)) => Ok(value),
        Ok(None) => Err(format!("{name}: absent")),
        Err(fault) => Err(format!("{name}: {fault}")),
    };
    let [px_mm, py_mm, theta_rad, phi_rad, radius_mm] = OF_CYLINDER.map(field);
    Ok(Some(CylinderModel {
        px_mm: px_mm?,
        py_mm: py_mm?,
        theta_rad: theta_rad?,
        phi_rad: phi_rad?,
        radius_mm: radius_mm?,
    }))
}

/// A value for a message.
fn shown(value: &Value) -> String {
    match value {
        Value::Object(_) | Value::Array(_) => kind(value).into(),
        Value::String(text) => cut(text),
        other => other.to_string(),
    }
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "an array",
        Value::Object(_) => "an object",
    }
}

fn cut(text: &str) -> String {
    const LONGEST: usize = 30;
    match text.chars().count() > LONGEST {
        true => format!("{:?}", text.chars().take(LONGEST).chain(['…']).collect::<String>()),
        false => format!("{text:?}"),
    }
}

/// The frames of a text, line by line. Empty lines count, but are no frames.
///
/// An item is a frame; or, with an inner error, a line that is none; or the failure to read, after which
/// nothing follows.
pub struct FrameLines<R> {
    reader: R,
    line: usize,
    bytes: Vec<u8>,
    ended: bool,
}

/// A line that is no frame.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct BadLine {
    /// Its number, from 1 on.
    pub line: usize,
    /// What is wrong with it.
    pub found: String,
}

impl std::fmt::Display for BadLine {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "line {}: found {}, expected {FORM}", self.line, self.found)
    }
}

impl<R: BufRead> FrameLines<R> {
    /// Reads from here on.
    pub fn new(reader: R) -> Self {
        Self { reader, line: 0, bytes: Vec::new(), ended: false }
    }

    /// The next line into `bytes`: whether there was one, and whether it was short enough.
    fn read_line(&mut self) -> std::io::Result<Option<bool>> {
        self.bytes.clear();
        let limit = LONGEST_LINE as u64 + 1;
        if (&mut self.reader).take(limit).read_until(b'\n', &mut self.bytes)? == 0 {
            return Ok(None);
        }
        self.line += 1;
        if self.bytes.last() == Some(&b'\n') || self.bytes.len() <= LONGEST_LINE {
            return Ok(Some(true));
        }
        self.reader.skip_until(b'\n')?;
        Ok(Some(false))
    }
}

impl<R: BufRead> Iterator for FrameLines<R> {
    type Item = std::io::Result<std::result::Result<Frame, BadLine>>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            let bad = |line: usize, found: String| Some(Ok(Err(BadLine { line, found })));
            match self.read_line() {
                Ok(None) => self.ended = true,
                Ok(Some(false)) => return bad(self.line, format!("more than {LONGEST_LINE} bytes")),
                Ok(Some(true)) => match std::str::from_utf8(&self.bytes) {
                    Ok(text) if text.trim().is_empty() => {}
                    Ok(text) => {
                        return match parse(text) {
                            Ok(frame) => Some(Ok(Ok(frame))),
                            Err(found) => bad(self.line, found),
                        };
                    }
                    Err(_) => return bad(self.line, "bytes that are no UTF-8".into()),
                },
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
        None
    }
}

/// Reads a file of frames.
pub(in crate::recording) fn read(path: &Path) -> Result<Recording> {
    let failed = |source| Error::read(path, source);
    let file = File::open(path).map_err(failed)?;
    let mut frames: Vec<Frame> = Vec::new();
    for line in FrameLines::new(BufReader::with_capacity(1 << 16, file)) {
        let frame = line
            .map_err(failed)?
            .map_err(|BadLine { line, found }| Error::input(path, format!("line {line}"), found, FORM))?;
        let number = frame.number.filter(|&number| number != frames.len());
        frames.push(frame.with_number(number));
    }
    Ok(Recording { frames })
}

/// Writes a file of frames, also of such that no reconstruction can use.
pub(in crate::recording) fn write(recording: &Recording, path: &Path) -> Result<()> {
    write_atomically(path, |out| {
        recording.frames.iter().try_for_each(|frame| writeln!(out, "{}", frame.to_json()))
    })
}
