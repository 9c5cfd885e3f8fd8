//! Recordings as MATLAB `.mat` files.
//!
//! | variable | size | |
//! |---|---|---|
//! | `rotm` | 3×3×F | rotation of the tracker sensor in the world |
//! | `Ep` | F×3 | its position, mm |
//! | `x_data`, `y_data` | F×M | the contours, mm; NaN: no echo on that ray |
//! | `rays` | F×1, optional | rays per frame where they differ: the rest of a row is padding |
//! | `time_s` | F×1, optional | time, s; NaN: not known |
//! | `frame_number` | F×1, optional | the frames' numbers, rising; by default from 0 |
//! | `cyl_px`, `cyl_py`, `theta`, `phi`, `rad` | F×1, all or none | the local cylinders, mm and rad; all NaN: none |

use super::mat5::{self, Array, Variable};
use super::rising_numbers;
use super::table::index;
use crate::geometry::Pose;
use crate::output::{ending, write_atomically};
use crate::recording::CylinderModel;
use crate::recording::{Frame, Recording};
use crate::{Error, Result};
use glam::{DMat3, DVec2, DVec3};
use std::collections::BTreeMap;
use std::path::Path;

const CYLINDER: [&str; 5] = ["cyl_px", "cyl_py", "theta", "phi", "rad"];
const NAMES: [&str; 12] = [
    "rotm",
    "Ep",
    "x_data",
    "y_data",
    "rays",
    "time_s",
    "frame_number",
    CYLINDER[0],
    CYLINDER[1],
    CYLINDER[2],
    CYLINDER[3],
    CYLINDER[4],
];

pub(in crate::recording) fn read_by_ending(path: &Path) -> Result<Recording> {
    std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    if ending(path) != "mat" {
        return Err(crate::recording::unknown_ending(path));
    }
    let mut variables = Variables { path, by_name: mat5::read(path, &NAMES)? };

    let position = variables.required("Ep")?;
    let frames = match position.shape[..] {
        [frames, 3] => frames,
        _ => return Err(variables.wrong_shape("Ep", &position, "Fx3, one row per frame")),
    };
    let rotation = variables.required("rotm")?;
    if rotation.shape != [3, 3, frames] && !(frames == 1 && rotation.shape == [3, 3]) {
        let expected = format!("3x3x{frames} (Ep is {})", position.shape_text());
        return Err(variables.wrong_shape("rotm", &rotation, &expected));
    }
    let x = variables.required("x_data")?;
    let rays = match x.shape[..] {
        [rows, rays] if rows == frames => rays,
        _ => {
            let expected = format!("{frames}xM (Ep is {})", position.shape_text());
            return Err(variables.wrong_shape("x_data", &x, &expected));
        }
    };
    let y = variables.required("y_data")?;
    if y.shape != x.shape {
        let expected = format!("{} (as x_data)", x.shape_text());
        return Err(variables.wrong_shape("y_data", &y, &expected));
    }
    let ray_counts = variables.ray_counts(frames, rays)?;
    let times = variables.column("time_s", frames)?;
    let numbers = variables.frame_numbers(frames)?;
    let cylinders = variables.cylinders(frames)?;

    let frame = |k: usize| {
        let component = |array: &Array, c: usize| array.values[k + frames * c];
        let columns = &rotation.values[9 * k..9 * k + 9];
        Frame {
            world_from_sensor: Pose {
                rotation: DMat3::from_cols_slice(columns),
                translation_mm: DVec3::from_array([0, 1, 2].map(|c| component(&position, c))),
            },
            time_s: times.as_ref().map(|t| t[k]).filter(|t| !t.is_nan()),
            contour_mm: (0..ray_counts.as_ref().map_or(rays, |counts| counts[k]))
                .map(|j| DVec2::new(component(&x, j), component(&y, j)))
                .collect(),
            cylinder: cylinders.as_ref().and_then(|c| cylinder([0, 1, 2, 3, 4].map(|i| c[i][k]))),
            number: numbers.as_ref().map(|n| n[k]).filter(|&number| number != k),
        }
    };
    Ok(Recording { frames: (0..frames).map(frame).collect() })
}

fn cylinder(numbers: [f64; 5]) -> Option<CylinderModel> {
    let [px_mm, py_mm, theta_rad, phi_rad, radius_mm] = numbers;
    let model = CylinderModel { px_mm, py_mm, theta_rad, phi_rad, radius_mm };
    (!numbers.iter().all(|x| x.is_nan())).then_some(model)
}

struct Variables<'a> {
    path: &'a Path,
    by_name: BTreeMap<String, Variable>,
}

impl Variables<'_> {
    fn wrong_shape(&self, name: &str, array: &Array, expected: &str) -> Error {
        Error::input(self.path, name, array.shape_text(), expected)
    }

    fn optional(&mut self, name: &str) -> Result<Option<Array>> {
        match self.by_name.remove(name) {
            None => Ok(None),
            Some(Variable::Real(array)) => Ok(Some(array)),
            Some(Variable::Other(found)) => {
                Err(Error::input(self.path, name, found, "a full array of real numbers"))
            }
        }
    }

    fn required(&mut self, name: &str) -> Result<Array> {
        self.optional(name)?.ok_or_else(|| {
            Error::input(self.path, name, "no variable of that name", "rotm, Ep, x_data and y_data")
        })
    }

    /// One number per frame, as a row or a column.
    fn column(&mut self, name: &str, frames: usize) -> Result<Option<Vec<f64>>> {
        match self.optional(name)? {
            Some(a) if a.shape == [frames, 1] || a.shape == [1, frames] => Ok(Some(a.values)),
            Some(a) => Err(self.wrong_shape(name, &a, &format!("{frames}x1 (one number per frame)"))),
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
            Err(Error::input(
                self.path,
                missing.join(", "),
                found,
                "all of cyl_px, cyl_py, theta, phi, rad or none",
            ))
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
    write_atomically(path, |file| mat5::write(file, &variables))
}
