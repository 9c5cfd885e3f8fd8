//! Recordings as a folder of CSV files.
//!
//! | file | columns |
//! |---|---|
//! | `poses.csv` | `frame,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw`: the tracker sensor in the world; `time_s` may be absent or empty; so may a column `phase`, of the heart, in cycles |
//! | `contours.csv` | `frame,x_mm,y_mm`, one line per ray, or `frame,x0_mm,y0_mm,x1_mm,…`, one per frame; empty: no echo |
//! | `cylinders.csv` | `frame,px_mm,py_mm,theta_rad,phi_rad,radius_mm`, where there are models |
//!
//! Columns are found by name, others are ignored. Frame numbers rise in `poses.csv` and may leave gaps. A pose
//! is [lost](Pose::LOST) where one of its numbers is missing, where a [status](StatusColumn) says so, and where
//! a frame of `contours.csv` has no line in `poses.csv`.

use super::status::StatusColumn;
use super::table::{Column, Table, TableRow};
use super::{rising_numbers, rotation};
use crate::geometry::Pose;
use crate::output::{Unfinished, folder_of, lock, permissions_of_new, write_atomically};
use crate::recording::{CylinderModel, Frame, ReadOptions, Recording};
use crate::{Error, Result};
use glam::{DQuat, DVec2, DVec3};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

const POSES: &str = "poses.csv";
const CONTOURS: &str = "contours.csv";
const CYLINDERS: &str = "cylinders.csv";

pub(in crate::recording) fn read(folder: &Path, options: &ReadOptions) -> Result<Recording> {
    let _unchanged = locked(folder, Use::Read);
    let mut frames = read_poses(&folder.join(POSES), options.pose_columns.as_deref())?;
    let numbers: Vec<usize> = frames.keys().copied().collect();
    read_contours(&folder.join(CONTOURS), options.contour_columns.as_deref(), &mut frames)?;
    check_numbering(&folder.join(CONTOURS), POSES, &frames, numbers.into_iter())?;
    if folder.join(CYLINDERS).exists() {
        let mut cylinders = Table::open(&folder.join(CYLINDERS))?;
        let frame_column = cylinders.column("frame")?;
        let names = ["px_mm", "py_mm", "theta_rad", "phi_rad", "radius_mm"];
        let [px, py, theta, phi, radius] = cylinders.columns(names, 0)?;
        while let Some(row) = cylinders.next_row()? {
            let number = cylinders.count(&row, frame_column)?;
            let frame = frames.get_mut(&number).ok_or_else(|| {
                cylinders.fault(&row, frame_column, number, format!("a frame of {POSES} or {CONTOURS}"))
            })?;
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
    let place = |(k, (number, mut frame)): (usize, (usize, Frame))| {
        frame.orthonormalise();
        frame.with_number(Some(number).filter(|&number| number != k))
    };
    Ok(Recording { frames: frames.into_iter().enumerate().map(place).collect() })
}

/// Refuses contours whose numbers are those of the poses, but one more or less.
///
/// # Errors
/// [`Error::Input`] about the contours' file; `poses` names where the poses are from.
pub(in crate::recording) fn check_numbering(
    contours: &Path,
    poses: &str,
    frames: &BTreeMap<usize, Frame>,
    numbers: impl Iterator<Item = usize>,
) -> Result<()> {
    let with_contour = frames.iter().filter(|(_, frame)| !frame.contour_mm.is_empty());
    let (Some(a), Some(b)) = (ends(numbers), ends(with_contour.map(|(number, _)| *number))) else {
        return Ok(());
    };
    if a.0.abs_diff(b.0) != 1 || a.1 - a.0 != b.1 - b.0 {
        return Ok(());
    }
    let expected = format!("{} to {} as in {poses}: one counts from 0 and the other from 1", a.0, a.1);
    Err(Error::input(contours, "frame", format!("frames {} to {}", b.0, b.1), expected))
}

/// The first and the last of some rising numbers.
fn ends(mut numbers: impl Iterator<Item = usize>) -> Option<(usize, usize)> {
    let first = numbers.next()?;
    Some((first, numbers.last().unwrap_or(first)))
}

/// Frames by their numbers, without contours.
fn read_poses(path: &Path, names: Option<&[String]>) -> Result<BTreeMap<usize, Frame>> {
    let mut table = Table::open_named(path, names)?;
    let frame_column = table.column("frame")?;
    let time = table.optional_column("time_s")?;
    let phase = table.optional_column("phase_cycles")?;
    let columns = table.columns(["x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"], 0)?;
    let mut statuses = StatusColumn::all(&table);
    let mut frames = BTreeMap::new();
    while let Some(row) = table.next_row()? {
        let number = table.count(&row, frame_column)?;
        if let Some((&last, _)) = frames.last_key_value()
            && number <= last
        {
            return Err(table.fault(&row, frame_column, number, format!("a number above {last}")));
        }
        let number_in = |column| match column {
            Some(column) => table.optional_number(&row, column),
            None => Ok(None),
        };
        let (time_s, phase) = (number_in(time)?, number_in(phase)?);
        let mut lost = false;
        for status in &mut statuses {
            lost |= status.is_lost(&table, &row)?;
        }
        let pose = if lost { Pose::LOST } else { pose(&table, &row, &columns)? };
        frames.insert(number, Frame::new(pose, Vec::new()).with_time_s(time_s).with_phase(phase));
    }
    Ok(frames)
}

/// Adds contours to the frames: a line per point, or a line per frame with the columns `x0`, `y0`, `x1`, … in
/// any order. A frame that is not there yet gets a lost pose.
pub(in crate::recording) fn read_contours(
    path: &Path,
    names: Option<&[String]>,
    frames: &mut BTreeMap<usize, Frame>,
) -> Result<()> {
    let mut table = Table::open_named(path, names)?;
    let frame_column = table.column("frame")?;
    let [xs, ys] = [table.numbered_columns("x_mm")?, table.numbered_columns("y_mm")?];
    let is_wide = !xs.is_empty() && table.optional_column("x_mm")?.is_none();
    let columns: Vec<[Column; 2]> = match is_wide {
        true if xs.len() != ys.len() => {
            let found = format!("{} columns of x and {} of y", xs.len(), ys.len());
            return Err(Error::input(path, "columns", found, "as many of each"));
        }
        true => xs.into_iter().zip(ys).map(|(x, y)| [x, y]).collect(),
        false => vec![table.columns(["x_mm", "y_mm"], 0)?],
    };
    while let Some(row) = table.next_row()? {
        let number = table.count(&row, frame_column)?;
        let frame = frames.entry(number).or_insert_with(|| Frame::new(Pose::LOST, Vec::new()));
        if is_wide && !frame.contour_mm.is_empty() {
            return Err(table.fault(&row, frame_column, "a second line for this frame", "one"));
        }
        for &[x, y] in &columns {
            let value =
                |column| -> Result<f64> { Ok(table.optional_number(&row, column)?.unwrap_or(f64::NAN)) };
            frame.contour_mm.push(DVec2::new(value(x)?, value(y)?));
        }
    }
    Ok(())
}

/// The pose in a line: position, then quaternion. Where one of its numbers is missing, it is lost.
fn pose(table: &Table, row: &TableRow, columns: &[Column; 7]) -> Result<Pose> {
    let mut numbers = [Some(0.0); 7];
    for (number, &column) in numbers.iter_mut().zip(columns) {
        *number = table.optional_number(row, column)?;
    }
    Ok(match numbers {
        [Some(x), Some(y), Some(z), Some(qx), Some(qy), Some(qz), Some(qw)] => {
            Pose { rotation: rotation(DQuat::from_xyzw(qx, qy, qz, qw)), translation_mm: DVec3::new(x, y, z) }
        }
        _ => Pose::LOST,
    })
}

/// The file that holds a field of [`Frame::defects`].
pub(super) fn file_of(field: &str) -> &'static str {
    match field {
        "contour" => CONTOURS,
        "cylinder" | "cylinder radius" => CYLINDERS,
        _ => POSES,
    }
}

/// A new folder is created as a whole. In an existing folder each of the three files is replaced as a whole.
pub(in crate::recording) fn write(recording: &Recording, folder: &Path) -> Result<()> {
    let failed = |source: std::io::Error| Error::Write { path: folder.to_owned(), source };
    let parent = folder_of(folder);
    std::fs::metadata(parent).map_err(failed)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".lumenmesh-");
    if let Some(permissions) = permissions_of_new(0o777) {
        builder.permissions(permissions);
    }
    let neighbour = builder.tempdir_in(parent).map_err(|e| failed(std::io::Error::from(e.kind())))?;
    let _unfinished = Unfinished::new(neighbour.path());
    write_files(recording, neighbour.path())?;
    if folder.is_dir() {
        // Other processes that read or write this recording wait meanwhile.
        let _alone = locked(folder, Use::Write);
        let _committing = lock();
        for name in [POSES, CONTOURS, CYLINDERS] {
            let (from, to) = (neighbour.path().join(name), folder.join(name));
            if from.exists() {
                std::fs::rename(from, to).map_err(failed)?;
            } else if to.exists() {
                std::fs::remove_file(to).map_err(failed)?;
            }
        }
    } else {
        let _committing = lock();
        std::fs::rename(neighbour.path(), folder).map_err(failed)?;
        let _renamed = neighbour.keep();
    }
    Ok(())
}

/// What a folder is locked for.
#[derive(Clone, Copy, PartialEq)]
enum Use {
    Read,
    Write,
}

/// Holds a folder so that no other process replaces its files in the meantime, until the result is dropped. Where the
/// system cannot, nothing is held.
fn locked(folder: &Path, what_for: Use) -> Option<File> {
    let file = File::open(folder).ok()?;
    let held = if what_for == Use::Write { file.lock() } else { file.lock_shared() };
    held.ok().map(|()| file)
}

fn write_files(recording: &Recording, folder: &Path) -> Result<()> {
    let frames = || rising_numbers(recording).zip(&recording.frames);
    write_atomically(&folder.join(POSES), |file| {
        let has_phases = recording.frames.iter().any(|frame| frame.phase.is_some());
        let name = if has_phases { ",phase" } else { "" };
        writeln!(file, "frame,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw{name}")?;
        for (k, frame) in frames() {
            let text = |number: Option<f64>| number.map(|x| x.to_string()).unwrap_or_default();
            let time = text(frame.time_s);
            let phase = if has_phases { format!(",{}", text(frame.phase)) } else { String::new() };
            let (p, q) = (frame.world_from_sensor.translation_mm, frame.world_from_sensor.quaternion());
            writeln!(file, "{k},{time},{},{},{},{},{},{},{}{phase}", p.x, p.y, p.z, q.x, q.y, q.z, q.w)?;
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
