//! Recordings as MATLAB `.mat` files.
//!
//! | variable | size | |
//! |---|---|---|
//! | `rotm` | 3×3×F | rotation of the tracker sensor in the world |
//! | `Ep` | F×3 | its position, mm |
//! | `x_data`, `y_data` | F×M | the contours, mm; NaN: no echo on that ray |
//! | `rays` | F×1, optional | rays per frame where they differ: the rest of a row is padding |
//! | `time_s` | F×1, optional | time, s; NaN: not known |
//! | `phase` | F×1, optional | phase of the heart, cycles; NaN: not known |
//! | `frame_number` | F×1, optional | the frames' numbers, rising; by default from 0 |
//! | `cyl_px`, `cyl_py`, `theta`, `phi`, `rad` | F×1, all or none | the local cylinders, mm and rad; all NaN: none |
//!
//! That is what is written. What is read may also be otherwise:
//!
//! - The variables may be fields of structs.
//! - Arrays may be transposed: `rotm` F×3×3, `Ep` 3×F, contours M×F.
//! - Quaternions F×4 or 4×F may stand for `rotm`; the name states their order: `quat_wxyz`, `quat_xyzw`.
//! - Transforms 4×4×F or F×4×4 may stand for both, as `wTe`, `T`, `tform`, `transforms` or `poses`.
//! - `x_data` and `y_data` may be cells of F vectors, and `contours` cells of F arrays M×2 or 2×M may stand for
//!   both.
//! - `valid` or `ok` (F×1, 0: the pose is [lost](Pose::LOST)) or cells of words in `status` may be there.

use super::status::says_lost;
use super::table::index;
use super::{rising_numbers, rotation};
use crate::geometry::Pose;
use crate::matfile::{self, Array, Fields, Value};
use crate::output::{ending, write_atomically};
use crate::recording::CylinderModel;
use crate::recording::{Frame, Recording};
use crate::text::shown;
use crate::{Error, Result};
use glam::{DMat3, DMat4, DQuat, DVec2, DVec3};
use std::collections::BTreeMap;
use std::path::Path;

const CYLINDER: [&str; 5] = ["cyl_px", "cyl_py", "theta", "phi", "rad"];
const QUATERNIONS: [(&str, [usize; 4]); 6] = [
    ("quat_wxyz", [1, 2, 3, 0]),
    ("quaternion_wxyz", [1, 2, 3, 0]),
    ("q_wxyz", [1, 2, 3, 0]),
    ("quat_xyzw", [0, 1, 2, 3]),
    ("quaternion_xyzw", [0, 1, 2, 3]),
    ("q_xyzw", [0, 1, 2, 3]),
];
const UNORDERED_QUATERNIONS: [&str; 5] = ["quat", "quats", "quaternion", "quaternions", "q"];
const TRANSFORMS: [&str; 8] = ["wTe", "T", "tform", "tforms", "transform", "transforms", "pose", "poses"];
const CONTOURS: [&str; 2] = ["contours", "contour"];
const FLAGS: [&str; 3] = ["valid", "is_valid", "ok"];
const OTHERS: [&str; 9] =
    ["rotm", "Ep", "x_data", "y_data", "rays", "time_s", "phase", "frame_number", "status"];

/// The names of all variables that a recording may have.
fn names() -> Vec<&'static str> {
    let quaternions = QUATERNIONS.map(|(name, _)| name);
    let names: [&[&str]; 7] =
        [&OTHERS, &CYLINDER, &quaternions, &UNORDERED_QUATERNIONS, &TRANSFORMS, &CONTOURS, &FLAGS];
    names.concat()
}

pub(in crate::recording) fn read_by_ending(path: &Path) -> Result<Recording> {
    std::fs::metadata(path).map_err(|source| Error::read(path, source))?;
    if ending(path) != "mat" {
        return Err(crate::recording::unknown_ending(path));
    }
    let names = names();
    let mut variables = Variables::new(path, matfile::read(path, &names)?, &names);
    let poses = variables.poses()?;
    let frames = poses.len();
    let contours = variables.contours(frames)?;
    let times = variables.column("time_s", frames)?;
    let phases = variables.column("phase", frames)?;
    let numbers = variables.frame_numbers(frames)?;
    let cylinders = variables.cylinders(frames)?;
    let lost = variables.lost(frames);
    variables.refuse_doubts()?;

    let frame = |(k, (pose, contour_mm)): (usize, (Pose, Vec<DVec2>))| {
        let mut frame = Frame::new(if lost[k] { Pose::LOST } else { pose }, contour_mm)
            .with_time_s(times.as_ref().map(|t| t[k]).filter(|t| !t.is_nan()))
            .with_phase(phases.as_ref().map(|p| p[k]).filter(|p| !p.is_nan()))
            .with_cylinder(cylinders.as_ref().and_then(|c| cylinder([0, 1, 2, 3, 4].map(|i| c[i][k]))))
            .with_number(numbers.as_ref().map(|n| n[k]).filter(|&number| number != k));
        frame.orthonormalise();
        frame
    };
    Ok(Recording { frames: poses.into_iter().zip(contours).enumerate().map(frame).collect() })
}

fn cylinder(numbers: [f64; 5]) -> Option<CylinderModel> {
    let [px_mm, py_mm, theta_rad, phi_rad, radius_mm] = numbers;
    let model = CylinderModel { px_mm, py_mm, theta_rad, phi_rad, radius_mm };
    (!numbers.iter().all(|x| x.is_nan())).then_some(model)
}

/// A variable: where it was found (`rec.Ep`), and what it is.
struct Named<T> {
    path: String,
    value: T,
}

/// An array with as many numbers for each frame.
struct PerFrame {
    values: Vec<f64>,
    frames: usize,
    width: usize,
    /// Whether the frames are its first dimension, or its last.
    frames_first: bool,
}

impl PerFrame {
    /// Number `i` of frame `k`, in column-major order.
    fn get(&self, k: usize, i: usize) -> f64 {
        self.values[if self.frames_first { k + self.frames * i } else { self.width * k + i }]
    }

    fn of<const N: usize>(&self, k: usize) -> [f64; N] {
        std::array::from_fn(|i| self.get(k, i))
    }

    /// Whether a test holds for all frames without NaN, and there are some.
    fn all<const N: usize>(&self, test: impl Fn([f64; N]) -> bool) -> bool {
        let mut numbers =
            (0..self.frames).map(|k| self.of(k)).filter(|n| !n.iter().any(|x| x.is_nan())).peekable();
        numbers.peek().is_some() && numbers.all(test)
    }
}

struct Variables<'a> {
    path: &'a Path,
    /// What was found under each name.
    by_name: BTreeMap<String, Vec<Named<Value>>>,
    /// Everything that the file holds, for messages.
    there: String,
    /// An array that can only be read transposed, and one that can be read either way, with its shape.
    transposed: Option<String>,
    doubtful: Option<(String, String)>,
}

impl<'a> Variables<'a> {
    fn new(path: &'a Path, fields: Fields, wanted: &[&str]) -> Self {
        let there = shown(&listed(&fields), 200);
        let mut by_name = BTreeMap::new();
        collect(fields, "", wanted, &mut by_name);
        Self { path, by_name, there, transposed: None, doubtful: None }
    }

    fn wrong_shape(&self, path: &str, array: &Array, expected: &str) -> Error {
        Error::input(self.path, path, array.shape_text(), expected)
    }

    /// The variable of that name: one of the file's own before one of a struct.
    fn find(&mut self, name: &str) -> Result<Option<Named<Value>>> {
        let Some(mut found) = self.by_name.remove(name) else { return Ok(None) };
        if let Some(own) = found.iter().position(|one| one.path == name) {
            return Ok(Some(found.swap_remove(own)));
        }
        match <[Named<Value>; 1]>::try_from(found) {
            Ok([one]) => Ok(Some(one)),
            Err(several) => {
                let paths: Vec<String> = several.into_iter().map(|one| one.path).collect();
                let found = shown(&paths.join(", "), 200);
                Err(Error::input(self.path, name, found, "one variable of that name"))
            }
        }
    }

    fn real(&self, Named { path, value }: Named<Value>) -> Result<Named<Array>> {
        match value {
            Value::Real(value) => Ok(Named { path, value }),
            other => Err(Error::input(self.path, path, other.kind(), "a full array of real numbers")),
        }
    }

    fn optional(&mut self, name: &str) -> Result<Option<Named<Array>>> {
        self.find(name)?.map(|one| self.real(one)).transpose()
    }

    fn missing(&self, name: &str) -> Error {
        let found = match self.there.as_str() {
            "" => "no variables".to_owned(),
            there => format!("no variable of that name among {there}"),
        };
        Error::input(self.path, name, found, "rotm, Ep, x_data and y_data")
    }

    /// The first of some variables that is there.
    fn first(&mut self, names: &[&'static str]) -> Result<Option<(&'static str, Named<Value>)>> {
        for &name in names {
            if let Some(one) = self.find(name)? {
                return Ok(Some((name, one)));
            }
        }
        Ok(None)
    }

    /// An array of the shape `inner` for each frame. Where it can be read with the frames first as well as
    /// last, `test` tells which is right; where it does not, the way that we document is taken, unless that is
    /// in [doubt](Self::refuse_doubts).
    fn per_frame(
        &mut self,
        Named { path, value: array }: Named<Array>,
        frames: usize,
        inner: &[usize],
        documented_first: bool,
        test: impl Fn(&PerFrame) -> bool,
    ) -> Result<PerFrame> {
        let last = [inner, &[frames]].concat();
        let can_be_first = array.shape == [&[frames], inner].concat();
        let can_be_last = array.shape == last || (frames == 1 && inner.len() > 1 && array.shape == inner);
        let documented = if documented_first { can_be_first } else { can_be_last };
        if !can_be_first && !can_be_last {
            let sizes =
                |inner: &[usize]| inner.iter().map(|size| size.to_string()).collect::<Vec<_>>().join("x");
            let (inner, frames) = (sizes(inner), frames);
            let expected =
                if documented_first { format!("{frames}x{inner}") } else { format!("{inner}x{frames}") };
            return Err(self.wrong_shape(&path, &array, &format!("{expected}, for {frames} frames")));
        }
        let width = inner.iter().product();
        let shape = array.shape_text();
        let mut numbers = PerFrame { values: array.values, frames, width, frames_first: can_be_first };
        if can_be_first && can_be_last && frames > 1 {
            let first_holds = test(&numbers);
            numbers.frames_first = false;
            let last_holds = test(&numbers);
            numbers.frames_first = if first_holds == last_holds { documented_first } else { first_holds };
            if first_holds == last_holds {
                self.doubtful.get_or_insert((path, shape));
            }
        } else if !documented {
            self.transposed.get_or_insert(path);
        }
        Ok(numbers)
    }

    /// Where one array is transposed, the others are likely to be, too.
    ///
    /// # Errors
    /// Where one that can be read either way is beside one that is transposed.
    fn refuse_doubts(&self) -> Result<()> {
        match (&self.transposed, &self.doubtful) {
            (Some(transposed), Some((path, shape))) => Err(Error::input(
                self.path,
                path,
                format!("{shape}, which can be read in two ways, beside {transposed}, which is transposed"),
                "all arrays as documented: rotm 3x3xF, Ep Fx3, x_data and y_data FxM",
            )),
            _ => Ok(()),
        }
    }

    fn poses(&mut self) -> Result<Vec<Pose>> {
        let rotm = self.optional("rotm")?;
        let ordered = QUATERNIONS.map(|(name, _)| name);
        let quaternions = self.first(&ordered)?;
        if rotm.is_none() && quaternions.is_none() {
            if let Some((_, transforms)) = self.first(&TRANSFORMS)? {
                return self.transforms(transforms);
            }
            if let Some((name, _)) = self.first(&UNORDERED_QUATERNIONS)? {
                let found = "quaternions in an order that the name does not state";
                return Err(Error::input(self.path, name, found, "the name quat_wxyz or quat_xyzw"));
            }
        }
        let position = self.optional("Ep")?.ok_or_else(|| self.missing("Ep"))?;
        let frames = match position.value.shape[..] {
            [frames, 3] | [3, frames] => frames,
            _ => return Err(self.wrong_shape(&position.path, &position.value, "Fx3, one row per frame")),
        };
        // Three positions in three coordinates: nothing in the numbers tells which is which.
        let positions = self.per_frame(position, frames, &[3], true, |_| true)?;
        let position = |k: usize| DVec3::from_array(positions.of(k));
        let pose = |(k, rotation): (usize, DMat3)| Pose { rotation, translation_mm: position(k) };
        let rotations: Vec<DMat3> = match (rotm, quaternions) {
            (Some(rotm), _) => {
                let rotations = self.per_frame(rotm, frames, &[3, 3], false, |rotations| {
                    rotations.all(|columns: [f64; 9]| is_rotation(DMat3::from_cols_array(&columns)))
                })?;
                (0..frames).map(|k| DMat3::from_cols_array(&rotations.of(k))).collect()
            }
            (None, Some((name, quaternions))) => {
                let quaternions = self.real(quaternions)?;
                let order =
                    QUATERNIONS.iter().find(|(n, _)| *n == name).map_or([0, 1, 2, 3], |(_, order)| *order);
                let quaternions = self.per_frame(quaternions, frames, &[4], true, |quaternions| {
                    quaternions.all(|q: [f64; 4]| (q.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < LOOSE)
                })?;
                let of_frame = |k| rotation(DQuat::from_array(order.map(|i| quaternions.get(k, i))));
                (0..frames).map(of_frame).collect()
            }
            (None, None) => return Err(self.missing("rotm")),
        };
        Ok(rotations.into_iter().enumerate().map(pose).collect())
    }

    /// Poses as homogeneous transforms.
    fn transforms(&mut self, transforms: Named<Value>) -> Result<Vec<Pose>> {
        let transforms = self.real(transforms)?;
        let path = transforms.path.clone();
        let frames = match transforms.value.shape[..] {
            [4, 4] => 1,
            [4, 4, frames] | [frames, 4, 4] => frames,
            _ => return Err(self.wrong_shape(&path, &transforms.value, "4x4xF, one transform per frame")),
        };
        let last_row = |m: DMat4| m.row(3).abs_diff_eq(glam::DVec4::W, 1e-6);
        let is_transform = |m: [f64; 16]| {
            let m = DMat4::from_cols_array(&m);
            last_row(m) || last_row(m.transpose())
        };
        let transforms = self.per_frame(transforms, frames, &[4, 4], false, |t| t.all(is_transform))?;
        let matrices =
            || (0..frames).map(|k| DMat4::from_cols_array(&transforms.of(k))).filter(|m| !m.is_nan());
        // Some write transforms for row vectors: the position is then the last row, and the last column is 0,
        // 0, 0, 1.
        let is_transposed = match (matrices().all(last_row), matrices().all(|m| last_row(m.transpose()))) {
            (true, false) => false,
            (false, true) => true,
            (true, true) => {
                let found = "transforms without a translation";
                return Err(Error::input(
                    self.path,
                    path,
                    found,
                    "4x4xF, a position in the last column of each",
                ));
            }
            (false, false) => {
                let found = "a transform whose last row is not 0, 0, 0, 1";
                return Err(Error::input(self.path, path, found, "4x4xF, rigid transforms"));
            }
        };
        let pose = |k| {
            let matrix = DMat4::from_cols_array(&transforms.of(k));
            let matrix = if is_transposed { matrix.transpose() } else { matrix };
            Pose { rotation: DMat3::from_mat4(matrix), translation_mm: matrix.w_axis.truncate() }
        };
        Ok((0..frames).map(pose).collect())
    }

    fn contours(&mut self, frames: usize) -> Result<Vec<Vec<DVec2>>> {
        let (x, y) = (self.find("x_data")?, self.find("y_data")?);
        let (x, y) = match (x, y) {
            (Some(x), Some(y)) => (x, y),
            (None, None) => match self.first(&CONTOURS)? {
                Some((_, contours)) => return self.cells_of_points(contours, frames),
                None => return Err(self.missing("x_data")),
            },
            (None, _) => return Err(self.missing("x_data")),
            (_, None) => return Err(self.missing("y_data")),
        };
        if let (Value::Cells(xs), Value::Cells(ys)) = (&x.value, &y.value) {
            let (xs, ys) = (self.vectors(&x.path, xs, frames)?, self.vectors(&y.path, ys, frames)?);
            if let Some(k) = (0..frames).find(|&k| xs[k].len() != ys[k].len()) {
                let found = format!("{} numbers", ys[k].len());
                let expected = format!("{} (as {})", xs[k].len(), x.path);
                return Err(Error::input(self.path, format!("{}{{{}}}", y.path, k + 1), found, expected));
            }
            let contour =
                |(x, y): (&[f64], &[f64])| x.iter().zip(y).map(|(&x, &y)| DVec2::new(x, y)).collect();
            return Ok(xs.into_iter().zip(ys).map(contour).collect());
        }
        let (x, y) = (self.real(x)?, self.real(y)?);
        let rays = match x.value.shape[..] {
            [rows, rays] if rows == frames => rays,
            [rays, columns] if columns == frames => rays,
            _ => {
                return Err(self.wrong_shape(&x.path, &x.value, &format!("{frames}xM, for {frames} frames")));
            }
        };
        if y.value.shape != x.value.shape {
            let expected = format!("{} (as {})", x.value.shape_text(), x.path);
            return Err(self.wrong_shape(&y.path, &y.value, &expected));
        }
        let x = self.per_frame(x, frames, &[rays], true, |_| true)?;
        let y = self.per_frame(y, frames, &[rays], true, |_| true)?;
        let counts = self.ray_counts(frames, rays)?;
        let contour = |k: usize| {
            let rays = counts.as_ref().map_or(rays, |counts| counts[k]);
            (0..rays).map(|j| DVec2::new(x.get(k, j), y.get(k, j))).collect()
        };
        Ok((0..frames).map(contour).collect())
    }

    /// Cells of vectors, one for each frame.
    fn vectors<'v>(&self, path: &str, cells: &'v [Value], frames: usize) -> Result<Vec<&'v [f64]>> {
        self.one_for_each_frame(path, cells, frames)?;
        let vector = |(k, cell): (usize, &'v Value)| match cell {
            Value::Real(Array { shape, values })
                if values.len() == shape.iter().copied().max().unwrap_or(0) =>
            {
                Ok(values.as_slice())
            }
            Value::Real(Array { values, .. }) if values.is_empty() => Ok(values.as_slice()),
            other => Err(self.wrong_cell(path, k, other, "a vector")),
        };
        cells.iter().enumerate().map(vector).collect()
    }

    /// Cells of points M×2 or 2×M, one for each frame.
    fn cells_of_points(&self, Named { path, value }: Named<Value>, frames: usize) -> Result<Vec<Vec<DVec2>>> {
        const EXPECTED: &str = "cells of Mx2 or of 2xM real numbers, one per frame";
        let Value::Cells(cells) = value else {
            return Err(Error::input(self.path, path, value.kind(), EXPECTED));
        };
        self.one_for_each_frame(&path, &cells, frames)?;
        let (mut rows, mut columns, mut square) = (None, None, None);
        for (k, cell) in cells.iter().enumerate() {
            match cell {
                Value::Real(Array { values, .. }) if values.is_empty() => {}
                Value::Real(Array { shape, .. }) => match shape[..] {
                    [2, 2] => square = Some(k),
                    [_, 2] => rows = Some(k),
                    [2, _] => columns = Some(k),
                    _ => return Err(self.wrong_cell(&path, k, cell, "Mx2 or 2xM")),
                },
                other => return Err(self.wrong_cell(&path, k, other, EXPECTED)),
            }
        }
        match (rows, columns, square) {
            (Some(_), Some(k), _) => {
                return Err(self.wrong_cell(&path, k, &cells[k], "Mx2, as in other cells"));
            }
            (None, None, Some(k)) => {
                return Err(self.wrong_cell(
                    &path,
                    k,
                    &cells[k],
                    "a cell that tells whether points are rows",
                ));
            }
            _ => {}
        }
        let points = |cell: &Value| match cell {
            Value::Real(Array { values, .. }) if columns.is_some() => {
                values.as_chunks().0.iter().map(|&point| DVec2::from_array(point)).collect()
            }
            Value::Real(Array { values, .. }) => {
                let (x, y) = values.split_at(values.len() / 2);
                x.iter().zip(y).map(|(&x, &y)| DVec2::new(x, y)).collect()
            }
            _ => Vec::new(),
        };
        Ok(cells.iter().map(points).collect())
    }

    fn one_for_each_frame(&self, path: &str, cells: &[Value], frames: usize) -> Result<()> {
        match cells.len() == frames {
            true => Ok(()),
            false => Err(Error::input(
                self.path,
                path,
                format!("{} cells", cells.len()),
                format!("{frames}, one per frame"),
            )),
        }
    }

    fn wrong_cell(&self, path: &str, k: usize, cell: &Value, expected: &str) -> Error {
        let found = match cell {
            Value::Real(array) => array.shape_text(),
            other => other.kind().to_owned(),
        };
        Error::input(self.path, format!("{path}{{{}}}", k + 1), found, expected)
    }

    /// The frames whose poses are lost, as far as a variable says so that has one value per frame.
    fn lost(&mut self, frames: usize) -> Vec<bool> {
        let mut lost = vec![false; frames];
        for name in FLAGS {
            if let Ok(Some(Named { value: Value::Real(flags) | Value::Logical(flags), .. })) = self.find(name)
                && flags.values.len() == frames
                && flags.values.iter().all(|&flag| flag == 0.0 || flag == 1.0)
            {
                lost.iter_mut().zip(flags.values).for_each(|(lost, flag)| *lost |= flag == 0.0);
            }
        }
        if let Ok(Some(Named { value: Value::Cells(cells), .. })) = self.find("status")
            && cells.len() == frames
        {
            let said = |cell: &Value| if let Value::Text(word) = cell { says_lost(word) } else { None };
            if let Some(said) = cells.iter().map(said).collect::<Option<Vec<bool>>>() {
                lost.iter_mut().zip(said).for_each(|(lost, said)| *lost |= said);
            }
        }
        lost
    }

    /// One number per frame, as a row or a column; none where the array is empty.
    fn column(&mut self, name: &str, frames: usize) -> Result<Option<Vec<f64>>> {
        match self.optional(name)? {
            Some(Named { value: a, .. }) if a.values.is_empty() && frames > 0 => Ok(None),
            Some(Named { value: a, .. }) if a.shape == [frames, 1] || a.shape == [1, frames] => {
                Ok(Some(a.values))
            }
            Some(Named { path, value }) => {
                Err(self.wrong_shape(&path, &value, &format!("{frames}x1 (one number per frame)")))
            }
            None => Ok(None),
        }
    }

    fn ray_counts(&mut self, frames: usize, rays: usize) -> Result<Option<Vec<usize>>> {
        let Some(counts) = self.column("rays", frames)? else { return Ok(None) };
        let count = |(k, &count): (usize, &f64)| {
            if count.fract() == 0.0 && (0.0..=rays as f64).contains(&count) {
                return Ok(count as usize);
            }
            Err(Error::Input {
                path: self.path.to_owned(),
                frame: Some(k),
                field: "rays".into(),
                found: count.to_string(),
                expected: format!("a whole number from 0 to {rays} (the columns of x_data)"),
            })
        };
        counts.iter().enumerate().map(count).collect::<Result<_>>().map(Some)
    }

    fn frame_numbers(&mut self, frames: usize) -> Result<Option<Vec<usize>>> {
        let Some(numbers) = self.column("frame_number", frames)? else { return Ok(None) };
        let mut whole: Vec<usize> = Vec::with_capacity(frames);
        for (k, &number) in numbers.iter().enumerate() {
            match index(number).filter(|number| whole.last().is_none_or(|last| last < number)) {
                Some(number) => whole.push(number),
                None => {
                    let (field, expected) = (format!("frame_number({})", k + 1), "whole numbers that rise");
                    return Err(Error::input(self.path, field, number, expected));
                }
            }
        }
        Ok(Some(whole))
    }

    fn cylinders(&mut self, frames: usize) -> Result<Option<Vec<Vec<f64>>>> {
        let mut columns = Vec::new();
        let mut missing = Vec::new();
        for name in CYLINDER {
            match self.column(name, frames)? {
                Some(values) => columns.push(values),
                None => missing.push(name),
            }
        }
        if missing.is_empty() {
            Ok(Some(columns))
        } else if columns.is_empty() {
            Ok(None)
        } else {
            let found = "no variable of that name";
            let expected = "all of cyl_px, cyl_py, theta, phi, rad or none";
            Err(Error::input(self.path, missing.join(", "), found, expected))
        }
    }
}

/// |RᵀR − I| of rotations at least, as against anything else that might have their shape.
const LOOSE: f64 = 0.05;

fn is_rotation(matrix: DMat3) -> bool {
    let pose = Pose { rotation: matrix, translation_mm: DVec3::ZERO };
    pose.orthogonality_error() < LOOSE
}

/// The names in a file, with the fields of structs: `a, rec (Ep, rotm)`.
fn listed(fields: &Fields) -> String {
    let name = |(name, value): (&String, &Value)| match value {
        Value::Struct(fields) => format!("{name} ({})", listed(fields)),
        _ => name.clone(),
    };
    fields.iter().map(name).collect::<Vec<_>>().join(", ")
}

/// Sorts what was wanted by its name, from structs too.
fn collect(fields: Fields, prefix: &str, wanted: &[&str], by_name: &mut BTreeMap<String, Vec<Named<Value>>>) {
    for (name, value) in fields {
        let path = format!("{prefix}{name}");
        match value {
            Value::Struct(fields) => {
                collect(fields, &format!("{path}."), wanted, by_name);
                if wanted.contains(&name.as_str()) {
                    let value = Value::Struct(Fields::new());
                    by_name.entry(name).or_insert_with(|| vec![Named { path, value }]);
                }
            }
            value if wanted.contains(&name.as_str()) => {
                by_name.entry(name).or_default().push(Named { path, value })
            }
            _ => {}
        }
    }
}

pub(in crate::recording) fn write(recording: &Recording, path: &Path) -> Result<()> {
    let frames = &recording.frames;
    let rays = frames.iter().map(|f| f.contour_mm.len()).max().unwrap_or(0);
    let column = |of: &dyn Fn(&Frame) -> f64| Array {
        shape: vec![frames.len(), 1],
        values: frames.iter().map(of).collect(),
    };
    let table = |columns: usize, of: &dyn Fn(&Frame, usize) -> f64| Array {
        shape: vec![frames.len(), columns],
        values: (0..columns).flat_map(|c| frames.iter().map(move |f| of(f, c))).collect(),
    };
    let rotation = Array {
        shape: vec![3, 3, frames.len()],
        values: frames.iter().flat_map(|f| f.world_from_sensor.rotation.to_cols_array()).collect(),
    };
    let point = |f: &Frame, j: usize| f.contour_mm.get(j).copied().unwrap_or(DVec2::NAN);
    let mut variables = vec![
        ("rotm", rotation),
        ("Ep", table(3, &|f, c| f.world_from_sensor.translation_mm[c])),
        ("x_data", table(rays, &|f, j| point(f, j).x)),
        ("y_data", table(rays, &|f, j| point(f, j).y)),
    ];
    if frames.iter().any(|f| f.contour_mm.len() != rays) {
        variables.push(("rays", column(&|f| f.contour_mm.len() as f64)));
    }
    if frames.iter().any(|f| f.time_s.is_some()) {
        variables.push(("time_s", column(&|f| f.time_s.unwrap_or(f64::NAN))));
    }
    if frames.iter().any(|f| f.phase.is_some()) {
        variables.push(("phase", column(&|f| f.phase.unwrap_or(f64::NAN))));
    }
    if frames.iter().any(|f| f.number.is_some()) {
        let values = rising_numbers(recording).map(|number| number as f64).collect();
        variables.push(("frame_number", Array { shape: vec![frames.len(), 1], values }));
    }
    if frames.iter().any(|f| f.cylinder.is_some()) {
        let number = |of: fn(&CylinderModel) -> f64| column(&|f| f.cylinder.as_ref().map_or(f64::NAN, of));
        let columns = [
            number(|c| c.px_mm),
            number(|c| c.py_mm),
            number(|c| c.theta_rad),
            number(|c| c.phi_rad),
            number(|c| c.radius_mm),
        ];
        variables.extend(CYLINDER.into_iter().zip(columns));
    }
    let variables: Vec<(&str, Value)> =
        variables.into_iter().map(|(name, array)| (name, Value::Real(array))).collect();
    write_atomically(path, |file| matfile::write(file, &variables))
}
