//! Pullbacks of an untracked catheter.

use super::formats::Table;
use super::{Frame, Recording};
use crate::geometry::{Pose, polyline, rotation_minimising_frames};
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;
use std::path::Path;

/// A recording made from contours without measured poses, only with the distances that the catheter was pulled.
///
/// Poses are assumed: one probe origin in the image for all frames, and a probe axis along a straight line or
/// along a given centreline. **The roll about that axis is not measured**: it is kept as constant as the
/// curve allows.
#[derive(Debug, Clone, PartialEq)]
pub struct Pullback {
    /// The frames, by rising pullback position.
    pub recording: Recording,
    /// For each frame the number that the file gives it.
    pub frame_numbers: Vec<u64>,
    /// For each frame its pullback position, mm.
    pub positions_mm: Vec<f64>,
    /// The probe's origin in the image, mm.
    pub centre_mm: DVec2,
}

/// How the file of a [`Pullback`] is read, and what is assumed about its poses.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct PullbackOptions {
    /// Where the probe lies in the image, mm; without one, the mean over the frames of their contours' area centroids.
    pub centre_mm: Option<DVec2>,
    /// What the probe's z axis lies along, from its first point, which takes the smallest pullback position; without one,
    /// the world's z axis.
    pub centreline: Option<PullbackPath>,
    /// Names of the file's columns, where it has no line of them and they are not in the usual order.
    pub columns: Option<Vec<String>>,
}

crate::setters::setters!(PullbackOptions {
    with_centre_mm => centre_mm: Option<DVec2>,
    with_centreline => centreline: Option<PullbackPath>,
    with_columns => columns: Option<Vec<String>>,
});

impl Pullback {
    /// Reads contours with one line per wall point: frame number, x, y in the image and pullback position z, mm.
    ///
    /// Tabs, semicolons, commas or blanks separate. Columns are the first four, or those named `frame`, `x_mm`,
    /// `y_mm` and `z_mm`, also without a unit or with another one, which is converted. A last point that
    /// repeats its contour's first is dropped.
    ///
    /// # Errors
    /// Where the file cannot be read, a line is not a point of one frame at one position, no contour has an area whose
    /// centroid could serve as the probe's origin, or the centreline is shorter than the pullback.
    pub fn read(path: &Path, options: &PullbackOptions) -> Result<Self> {
        let mut contours: Vec<Contour> = read_contours(path, options.columns.as_deref())?;
        contours.sort_by(|a, b| a.position_mm.total_cmp(&b.position_mm).then(a.number.cmp(&b.number)));
        let (Some(first), Some(last)) = (contours.first(), contours.last()) else {
            return Err(Error::input(path, "contours", "no lines", "at least one contour"));
        };
        let start_mm = first.position_mm;
        let length_mm = last.position_mm - start_mm;
        let positions_mm: Vec<f64> = contours.iter().map(|c| c.position_mm).collect();
        let poses: Vec<Pose> = match &options.centreline {
            None => {
                let at = |&z: &f64| Pose { translation_mm: DVec3::Z * z, ..Pose::IDENTITY };
                positions_mm.iter().map(at).collect()
            }
            Some(line) if line.length_mm() < length_mm => {
                let expected = format!("at least {length_mm:.3} mm (the pullback)");
                return Err(Error::input(
                    &line.name,
                    "centreline length",
                    format!("{:.3} mm", line.length_mm()),
                    expected,
                ));
            }
            Some(line) => line.poses(positions_mm.iter().map(|z| z - start_mm)),
        };
        let frame_numbers = contours.iter().map(|c| c.number).collect();
        let frame = |(k, (pose, contour)): (usize, (Pose, Contour))| {
            let number = usize::try_from(contour.number).ok().filter(|&number| number != k);
            Frame::new(pose, contour.points_mm).with_number(number)
        };
        let mut frames: Vec<Frame> = poses.into_iter().zip(contours).enumerate().map(frame).collect();
        let centre_mm = match options.centre_mm {
            Some(centre) => centre,
            None => mean(frames.iter().filter_map(Frame::centroid_mm)).ok_or_else(|| {
                Error::input(path, "contours", "none with an area", "a contour to find the probe's origin by")
            })?,
        };
        for point in frames.iter_mut().flat_map(|f| &mut f.contour_mm) {
            *point -= centre_mm;
        }
        let recording = Recording { frames };
        recording.check().map_err(|e| e.in_file(path))?;
        Ok(Self { recording, frame_numbers, positions_mm, centre_mm })
    }
}

fn mean(points: impl Iterator<Item = DVec2>) -> Option<DVec2> {
    let (count, sum) = points.fold((0.0, DVec2::ZERO), |(count, sum), p| (count + 1.0, sum + p));
    (count > 0.0).then(|| sum / count)
}

/// A last point this near to the first is the first again, rounded, mm.
const CLOSING_GAP_MM: f64 = 1e-6;

/// A contour in the image.
struct Contour {
    number: u64,
    position_mm: f64,
    points_mm: Vec<DVec2>,
}

fn read_contours(path: &Path, columns: Option<&[String]>) -> Result<Vec<Contour>> {
    let mut table = Table::open_named(path, columns)?;
    let [frame, x, y, z] = table.columns(["frame", "x_mm", "y_mm", "z_mm"], 0)?;
    let mut contours: BTreeMap<u64, Contour> = BTreeMap::new();
    while let Some(row) = table.next_row()? {
        let number = table.count(&row, frame)? as u64;
        let point = |column| -> Result<f64> { Ok(table.optional_number(&row, column)?.unwrap_or(f64::NAN)) };
        let point = DVec2::new(point(x)?, point(y)?);
        let position_mm = table.number(&row, z)?;
        if !position_mm.is_finite() {
            return Err(table.fault(&row, z, position_mm, "a finite position in mm"));
        }
        let contour =
            contours.entry(number).or_insert(Contour { number, position_mm, points_mm: Vec::new() });
        if contour.position_mm != position_mm {
            let expected = format!("{} (as before in frame {number})", contour.position_mm);
            return Err(table.fault(&row, z, position_mm, expected));
        }
        contour.points_mm.push(point);
    }
    for points in contours.values_mut().map(|c| &mut c.points_mm) {
        if let [first, .., last] = points[..]
            && first.distance(last) <= CLOSING_GAP_MM
        {
            points.pop();
        }
    }
    Ok(contours.into_values().collect())
}

/// The path of a pullback: the centreline of a vessel as a polyline.
#[derive(Debug, Clone, PartialEq)]
pub struct PullbackPath {
    /// Where it came from, for messages.
    name: std::path::PathBuf,
    /// Its points in the world, mm; no two consecutive ones coincide.
    points_mm: Vec<DVec3>,
    /// Arc length from the first point to each, mm.
    lengths_mm: Vec<f64>,
}

impl PullbackPath {
    /// Reads points x, y, z in mm, one a line: the first three columns, or those named `x_mm`, `y_mm`, `z_mm`,
    /// also without a unit or with another one, which is converted. Where a column `branch` is there, the first
    /// branch counts.
    ///
    /// # Errors
    /// Where the file cannot be read, a number is missing or not finite, or fewer than two points differ.
    pub fn read(path: &Path) -> Result<Self> {
        let mut table = Table::open(path)?;
        let branch_column = table.optional_column("branch")?;
        let [x, y, z] = table.columns(["x_mm", "y_mm", "z_mm"], 0)?;
        let mut first_branch = None;
        let mut points: Vec<DVec3> = Vec::new();
        while let Some(row) = table.next_row()? {
            let number = |column| match table.number(&row, column)? {
                number if number.is_finite() => Ok(number),
                number => Err(table.fault(&row, column, number, "a finite number")),
            };
            if let Some(column) = branch_column {
                let branch = number(column)?;
                if *first_branch.get_or_insert(branch) != branch {
                    continue;
                }
            }
            let point = DVec3::new(number(x)?, number(y)?, number(z)?);
            if points.last() != Some(&point) {
                points.push(point);
            }
        }
        if points.len() < 2 {
            let found = format!("{} different points", points.len());
            return Err(Error::input(path, "centreline", found, "at least 2"));
        }
        let lengths_mm = polyline::lengths(&points);
        Ok(Self { name: path.to_owned(), points_mm: points, lengths_mm })
    }

    /// Its length, mm.
    pub fn length_mm(&self) -> f64 {
        self.lengths_mm.last().copied().unwrap_or(0.0)
    }

    /// The point at an arc length from the start, mm; beyond an end, that end.
    pub fn point_mm(&self, length_mm: f64) -> DVec3 {
        polyline::point_at(&self.points_mm, &self.lengths_mm, length_mm)
    }

    /// Poses at rising arc lengths with z along the curve and as little roll as it allows.
    fn poses(&self, lengths_mm: impl Iterator<Item = f64> + Clone) -> Vec<Pose> {
        // A chord of a few points' spacing: a digitised line zigzags.
        let reach = TANGENT_REACH_MM.min(self.length_mm() / 2.0);
        let points: Vec<DVec3> = lengths_mm.clone().map(|s| self.point_mm(s)).collect();
        let tangents: Vec<DVec3> = lengths_mm
            .map(|s| (self.point_mm(s + reach) - self.point_mm(s - reach)).normalize_or(DVec3::Z))
            .collect();
        let frames = rotation_minimising_frames(&points, &tangents);
        let pose = |(rotation, translation_mm)| Pose { rotation, translation_mm };
        frames.into_iter().zip(points).map(pose).collect()
    }
}

/// Tangents are chords that reach this far to both sides, mm.
const TANGENT_REACH_MM: f64 = 1.5;
