//! Recordings as a folder of CSV files.
//!
//! | file | columns |
//! |---|---|
//! | `poses.csv` | `frame,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw`: the tracker sensor in the world; `time_s` may be absent or empty |
//! | `contours.csv` | `frame,x_mm,y_mm`, one line per ray; empty or NaN: no echo |
//! | `cylinders.csv` | `frame,px_mm,py_mm,theta_rad,phi_rad,radius_mm`, where there are models |
//!
//! Columns are found by name, others are ignored. Frame numbers rise in `poses.csv` and may leave gaps; a
//! recording in memory counts its frames from 0.

use super::table::{Column, Table, TableRow};
use crate::geometry::Pose;
use crate::output::write_atomically;
use crate::recording::CylinderModel;
use crate::recording::{Frame, Recording};
use crate::{Error, Result};
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::collections::BTreeMap;
use std::path::Path;

const POSES: &str = "poses.csv";
const CONTOURS: &str = "contours.csv";
const CYLINDERS: &str = "cylinders.csv";

/// Quaternions this far from unit length are rounded ones.
const UNIT_TOLERANCE: f64 = 1e-3;

pub(in crate::recording) fn read(folder: &Path) -> Result<Recording> {
    let mut poses = Table::open(&folder.join(POSES))?;
    let frame_column = poses.column("frame")?;
    let time = poses.optional_column("time_s")?;
    let [x, y, z] = columns(&poses, ["x_mm", "y_mm", "z_mm"])?;
    let [qx, qy, qz, qw] = columns(&poses, ["qx", "qy", "qz", "qw"])?;
    let mut frames = Vec::new();
    let mut index_of = BTreeMap::new();
    while let Some(row) = poses.next_row()? {
        let number = poses.count(&row, frame_column)?;
        if let Some((&last, _)) = index_of.last_key_value()
            && number <= last
        {
            return Err(poses.fault(&row, frame_column, number, format!("a number above {last}")));
        }
        index_of.insert(number, frames.len());
        let value = |column| poses.number(&row, column);
        let time_s = match time {
            Some(column) => poses.optional_number(&row, column)?,
            None => None,
        };
        frames.push(Frame {
            world_from_sensor: Pose {
                rotation: rotation(DQuat::from_xyzw(value(qx)?, value(qy)?, value(qz)?, value(qw)?)),
                translation_mm: DVec3::new(value(x)?, value(y)?, value(z)?),
            },
            time_s: time_s.filter(|t| !t.is_nan()),
            contour_mm: Vec::new(),
            cylinder: None,
        });
    }

    let mut contours = Table::open(&folder.join(CONTOURS))?;
    let frame_column = contours.column("frame")?;
    let [x, y] = columns(&contours, ["x_mm", "y_mm"])?;
    while let Some(row) = contours.next_row()? {
        let frame = known_frame(&contours, &row, frame_column, &index_of, &mut frames)?;
        let value =
            |column| -> Result<f64> { Ok(contours.optional_number(&row, column)?.unwrap_or(f64::NAN)) };
        frame.contour_mm.push(DVec2::new(value(x)?, value(y)?));
    }

    if folder.join(CYLINDERS).exists() {
        let mut cylinders = Table::open(&folder.join(CYLINDERS))?;
        let frame_column = cylinders.column("frame")?;
        let names = ["px_mm", "py_mm", "theta_rad", "phi_rad", "radius_mm"];
        let [px, py, theta, phi, radius] = columns(&cylinders, names)?;
        while let Some(row) = cylinders.next_row()? {
            let frame = known_frame(&cylinders, &row, frame_column, &index_of, &mut frames)?;
            let value = |column| cylinders.number(&row, column);
            let model = CylinderModel {
                px_mm: value(px)?,
                py_mm: value(py)?,
                theta_rad: value(theta)?,
                phi_rad: value(phi)?,
                radius_mm: value(radius)?,
            };
            if frame.cylinder.replace(model).is_some() {
                return Err(cylinders.fault(&row, frame_column, "a second line for this frame", "one"));
            }
        }
    }
    Ok(Recording { frames })
}

fn columns<const N: usize>(table: &Table, names: [&'static str; N]) -> Result<[Column<'static>; N]> {
    let mut found = [Column { index: 0, name: "" }; N];
    for (column, name) in found.iter_mut().zip(names) {
        *column = table.column(name)?;
    }
    Ok(found)
}

fn known_frame<'a>(
    table: &Table,
    row: &TableRow,
    column: Column<'_>,
    index_of: &BTreeMap<u64, usize>,
    frames: &'a mut [Frame],
) -> Result<&'a mut Frame> {
    let number = table.count(row, column)?;
    let frame = index_of.get(&number).and_then(|&k| frames.get_mut(k));
    frame.ok_or_else(|| table.fault(row, column, number, format!("a frame of {POSES}")))
}

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

/// A new folder is created as a whole. In an existing folder each of the three files is replaced as a whole.
pub(in crate::recording) fn write(recording: &Recording, folder: &Path) -> Result<()> {
    let failed = |source| Error::Write { path: folder.to_owned(), source };
    let parent = match folder.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let neighbour = tempfile::Builder::new().prefix(".lumenmesh-").tempdir_in(parent).map_err(failed)?;
    write_files(recording, neighbour.path())?;
    if folder.is_dir() {
        for name in [POSES, CONTOURS, CYLINDERS] {
            let (from, to) = (neighbour.path().join(name), folder.join(name));
            if from.exists() {
                std::fs::rename(from, to).map_err(failed)?;
            } else if to.exists() {
                std::fs::remove_file(to).map_err(failed)?;
            }
        }
    } else {
        open_to_all(neighbour.path()).map_err(failed)?;
        std::fs::rename(neighbour.path(), folder).map_err(failed)?;
        let _renamed = neighbour.keep();
    }
    Ok(())
}

fn write_files(recording: &Recording, folder: &Path) -> Result<()> {
    let frames = || recording.frames.iter().enumerate();
    write_atomically(&folder.join(POSES), |file| {
        writeln!(file, "frame,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw")?;
        for (k, frame) in frames() {
            let time = frame.time_s.map(|t| t.to_string()).unwrap_or_default();
            let (p, q) = (frame.world_from_sensor.translation_mm, frame.world_from_sensor.quaternion());
            writeln!(file, "{k},{time},{},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z, q.w)?;
        }
        Ok(())
    })?;
    write_atomically(&folder.join(CONTOURS), |file| {
        writeln!(file, "frame,x_mm,y_mm")?;
        for (k, frame) in frames() {
            for p in &frame.contour_mm {
                writeln!(file, "{k},{},{}", p.x, p.y)?;
            }
        }
        Ok(())
    })?;
    if frames().all(|(_, frame)| frame.cylinder.is_none()) {
        return Ok(());
    }
    write_atomically(&folder.join(CYLINDERS), |file| {
        writeln!(file, "frame,px_mm,py_mm,theta_rad,phi_rad,radius_mm")?;
        for (k, c) in frames().filter_map(|(k, frame)| Some((k, frame.cylinder.as_ref()?))) {
            writeln!(file, "{k},{},{},{},{},{}", c.px_mm, c.py_mm, c.theta_rad, c.phi_rad, c.radius_mm)?;
        }
        Ok(())
    })
}

/// A temporary folder is private by default; a result is not.
#[cfg(unix)]
fn open_to_all(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn open_to_all(_: &Path) -> std::io::Result<()> {
    Ok(())
}
