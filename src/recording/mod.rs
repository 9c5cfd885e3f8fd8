//! Recordings: frames with their poses and contours, and their file formats.

mod conventions;
mod curves;
mod cylinder;
pub(crate) mod echo_error;
mod finding;
mod formats;
mod mask;
mod outline;
mod pullback;
mod screening;
mod sequence;
mod summary;

pub use conventions::{Conventions, LengthUnit, QuaternionOrder, TimeUnit};
pub use curves::Curves;
pub use cylinder::CylinderModel;
pub(crate) use cylinder::MAX_RADIUS_MM;
pub use finding::{Example, Finding};
pub(crate) use formats::Table;
pub use formats::ndjson::{BadLine, FrameLines};
pub use mask::{MaskContour, MaskFound, MaskOptions, Masks};
pub use pullback::{Pullback, PullbackOptions, PullbackPath};
pub use screening::{
    Chords, Cleaning, FixedChord, LeftOut, NoEcho, Reason, RingDown, Screened, Screening, UnfitFrames,
};
pub(crate) use screening::{Judged, LiveScreening};
pub use sequence::{
    CONTOUR_X, CONTOUR_Y, Image, PixelType, Sequence, SequenceContents, SequenceImages, TransformContents,
};
pub use summary::{MinMedianMax, Summary};

use crate::geometry::{Pose, polygon};
use crate::output::ending;
use crate::{Error, Result};
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Between frames without a time, s: the thesis's frame rate.
pub const FRAME_INTERVAL_S: f64 = 1.0 / 12.0;

/// One IVUS frame: a contour and the pose of the tracker sensor when it was taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Frame {
    /// `wTe`: the tracker sensor in the world, mm.
    pub world_from_sensor: Pose,
    /// When the frame was taken, in seconds; the origin is the recording's own.
    pub time_s: Option<f64>,
    /// Wall points (x, y) in mm in the xy-plane of the probe `{i}`, one per ray. NaN: no echo on that ray.
    pub contour_mm: Vec<DVec2>,
    /// The local cylinder, where the recording carries one.
    pub cylinder: Option<CylinderModel>,
    /// How far the rotation in its file was from orthonormal, the largest element of |RᵀR − I|, where that was
    /// more than [`Recording::check`] allows, so that the reader made it orthonormal.
    pub rotation_error: Option<f64>,
    /// The frame's number in its file, where that is not its place in the recording. See [`Recording::number`].
    pub number: Option<usize>,
    /// The phase of the heart, or of another cycle, when the frame was taken, in cycles: as from the R peaks of an ECG, 0 at
    /// each. The whole part does not count.
    // Live vessels, whose states are stored, do without.
    #[serde(skip)]
    pub phase: Option<f64>,
}

impl Frame {
    /// A frame without a time, a phase, a cylinder or a number of its own.
    pub fn new(world_from_sensor: Pose, contour_mm: Vec<DVec2>) -> Self {
        Self {
            world_from_sensor,
            time_s: None,
            contour_mm,
            cylinder: None,
            rotation_error: None,
            number: None,
            phase: None,
        }
    }

    /// Sets the phase.
    #[must_use]
    pub fn with_phase(mut self, phase: Option<f64>) -> Self {
        self.phase = phase;
        self
    }

    /// Sets the time.
    #[must_use]
    pub fn with_time_s(mut self, time_s: Option<f64>) -> Self {
        self.time_s = time_s;
        self
    }

    /// Sets the wall points.
    #[must_use]
    pub fn with_contour_mm(mut self, contour_mm: Vec<DVec2>) -> Self {
        self.contour_mm = contour_mm;
        self
    }

    /// Sets the local cylinder.
    #[must_use]
    pub fn with_cylinder(mut self, cylinder: Option<CylinderModel>) -> Self {
        self.cylinder = cylinder;
        self
    }

    /// Sets the frame's number in its file.
    #[must_use]
    pub fn with_number(mut self, number: Option<usize>) -> Self {
        self.number = number;
        self
    }

    /// The contour without its missing echoes.
    pub fn echoes_mm(&self) -> impl Iterator<Item = DVec2> + Clone + '_ {
        self.contour_mm.iter().copied().filter(|p| !p.is_nan())
    }

    /// Rays without an echo.
    pub fn missing_echoes(&self) -> usize {
        self.contour_mm.iter().filter(|p| p.is_nan()).count()
    }

    /// Centroid of the area inside the contour, mm in the probe's plane: a polygon through the echoes in ray
    /// order, straight across missing ones. `None` where there is no area.
    ///
    /// With noise as large as the lumen the polygon crosses itself: areas of both signs cancel, and the centroid can lie
    /// anywhere. Where it lies outside the echoes' bounding box, their mean is returned instead.
    pub fn centroid_mm(&self) -> Option<DVec2> {
        let origin = self.echoes_mm().next()?;
        let (twice_area, moment) = polygon::twice_area_and_moment(self.echoes_mm());
        let points = || self.echoes_mm().map(move |p| p - origin);
        let mut extent = 0.0_f64;
        let (mut low, mut high, mut sum) = (DVec2::ZERO, DVec2::ZERO, DVec2::ZERO);
        for p in points() {
            extent = extent.max(p.length_squared());
            (low, high, sum) = (low.min(p), high.max(p), sum + p);
        }
        if twice_area.abs() <= 1e-9 * extent {
            return None;
        }
        let centroid = moment / (3.0 * twice_area);
        let within = low.cmple(centroid).all() && centroid.cmple(high).all();
        Some(origin + if within { centroid } else { sum / points().count() as f64 })
    }
}

/// A tracked IVUS recording, frames in the order in which they were taken.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recording {
    /// The frames.
    pub frames: Vec<Frame>,
}

impl Recording {
    /// Reads a recording: a MATLAB `.mat` file (v4 to v7.3), a folder of CSV files, or a [sequence
    /// file](Sequence) of PLUS or 3D Slicer (`.igs.mha`, `.igs.mhd`, `.seq.mha`, `.igs.nrrd`, `.seq.nrrd`), or
    /// one [frame as JSON](Frame::from_json) per line (`.ndjson`, `.jsonl`); with the feature `mcap` also an
    /// MCAP file with poses of Foxglove or ROS 2 (`.mcap`).
    ///
    /// A `.mat` file holds `rotm` (3×3×F, the sensor's rotation in the world), `Ep` (F×3, its position, mm),
    /// `x_data` and `y_data` (F×M, contours, mm, NaN where there is no echo) and optionally `cyl_px`, `cyl_py`,
    /// `theta`, `phi`, `rad` and `time_s` (F×1 each). A folder holds `poses.csv`
    /// (`frame,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw`), `contours.csv` (`frame,x_mm,y_mm`) and optionally
    /// `cylinders.csv` (`frame,px_mm,py_mm,theta_rad,phi_rad,radius_mm`). Frames keep their
    /// [numbers](Recording::number). A pose that is missing is [`Pose::LOST`], and so is one whose status says
    /// that the tracker did not see its sensor.
    ///
    /// `.mat` files may also hold these variables in structs, quaternions (`quat_wxyz`, `quat_xyzw`, F×4) for
    /// `rotm`, transforms (`wTe`, 4×4×F) for the poses, cells of vectors for the contours, or `contours`, cells
    /// of M×2 arrays, and arrays that are transposed where their sizes or numbers tell so. The columns of CSV
    /// files may be in other units that their names state (`x [cm]`), and `contours.csv` may have one line per
    /// frame (`frame,x0_mm,y0_mm,x1_mm,…`).
    ///
    /// # Errors
    /// Where a file cannot be read, lacks a variable, or holds a frame that fails [`Recording::check`].
    pub fn read(path: &Path) -> Result<Self> {
        let recording = Self::read_unchecked(path)?;
        recording.check().map_err(|e| {
            let file = formats::file_of(path, &e);
            e.in_file(&file)
        })?;
        Ok(recording)
    }

    /// A recording from arrays, as hosts have them: for each frame the sensor in the world as a 4×4 matrix, as
    /// [`Frame::from_matrix`] takes it, and the contour.
    ///
    /// # Errors
    /// [`Error::Recording`] where there are not as many contours as poses; [`Error::Frame`] where a matrix is no rigid
    /// transform's.
    pub fn from_matrices(
        world_from_sensor: &[[[f64; 4]; 4]],
        contours_mm: impl IntoIterator<Item = Vec<DVec2>>,
    ) -> Result<Self> {
        let contours_mm: Vec<Vec<DVec2>> = contours_mm.into_iter().collect();
        if contours_mm.len() != world_from_sensor.len() {
            return Err(Error::Recording {
                field: "contours",
                found: contours_mm.len().to_string(),
                expected: format!("{}, one for each pose", world_from_sensor.len()),
            });
        }
        let frame = |(k, (matrix, contour_mm))| {
            Frame::from_matrix(matrix, contour_mm).map_err(|error| match error {
                Error::Recording { field, found, expected } => {
                    Error::Frame { frame: k, field, found, expected }
                }
                other => other,
            })
        };
        let frames =
            world_from_sensor.iter().zip(contours_mm).enumerate().map(frame).collect::<Result<_>>()?;
        Ok(Self { frames })
    }

    /// Reads a recording as [`Recording::read`] does, but keeps frames that no reconstruction can use, so that their
    /// defects can be inspected.
    ///
    /// # Errors
    /// Where a file cannot be read, lacks a variable, or has one of a wrong shape or of one that can be read in
    /// two ways.
    pub fn read_unchecked(path: &Path) -> Result<Self> {
        Self::read_with(path, &ReadOptions::default())
    }

    /// As [`Recording::read_unchecked`], with what the file leaves open.
    ///
    /// # Errors
    /// As [`Recording::read_unchecked`], and where an option is for recordings of another kind.
    pub fn read_with(path: &Path, options: &ReadOptions) -> Result<Self> {
        let is_sequence = Sequence::has_ending(path);
        if let Some((option, kind)) = options.misplaced(path.is_dir(), is_sequence, is_mcap(path)) {
            let found = match () {
                () if path.is_dir() => "a folder of CSV files",
                () if is_sequence => "a sequence file",
                () => "a file",
            };
            return Err(Error::input(path, option, found, kind));
        }
        match () {
            () if path.is_dir() => formats::csv::read(path, options),
            () if is_sequence => Sequence::read(path)?.recording(options),
            () if is_ndjson(path) => formats::ndjson::read(path),
            #[cfg(feature = "mcap")]
            () if is_mcap(path) => formats::mcap::read(path, options),
            () => formats::mat::read_by_ending(path),
        }
    }

    /// The number of the frame at place `k`, for messages: the one that its file gives it, or else `k`.
    pub fn number(&self, k: usize) -> usize {
        self.frames.get(k).and_then(|frame| frame.number).unwrap_or(k)
    }

    /// Writes a recording: `.mat` and `.ndjson` by that ending, a [sequence file](Sequence) by `.mha`, `.mhd`
    /// or `.nrrd` (`.mhd` with a `.raw` beside it), else (no ending, or a folder that is there) a folder of CSV
    /// files. All read back equal, but that CSV files hold rotations as quaternions (equal to 1e-12), and
    /// sequence files no cylinder models. `.ndjson` is one [frame as JSON](Frame::to_json) per line.
    ///
    /// # Errors
    /// Where the recording fails [`Recording::check`] (but in `.ndjson`, where a frame may have no pose), the
    /// ending is another one, or the file or folder cannot be written; no partial file is left behind.
    pub fn write(&self, path: &Path) -> Result<()> {
        if is_ndjson(path) && !path.is_dir() {
            return formats::ndjson::write(self, path);
        }
        self.check().map_err(|e| e.in_file(path))?;
        match ending(path).as_str() {
            _ if path.is_dir() => formats::csv::write(self, path),
            "mat" => formats::mat::write(self, path),
            "" => formats::csv::write(self, path),
            "mha" | "mhd" | "nrrd" => sequence::write(self, path),
            _ => Err(unknown_ending(path)),
        }
    }

    /// Refuses recordings that no reconstruction can use: those without frames or with a frame that has
    /// [defects](Frame::defects).
    ///
    /// # Errors
    /// [`Error::Frame`] with the first frame to blame.
    pub fn check(&self) -> Result<()> {
        if self.frames.is_empty() {
            return Err(Error::Recording {
                field: "frames",
                found: "0 frames".into(),
                expected: "at least 1".into(),
            });
        }
        let frames = self.frames.par_iter().enumerate();
        frames.find_map_first(|(k, frame)| frame.check(self.number(k)).err()).map_or(Ok(()), Err)
    }
}

/// What a recording's file leaves open.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct ReadOptions {
    /// Names of the columns of `poses.csv`, where it lacks a line of them, in their order.
    pub pose_columns: Option<Vec<String>>,
    /// The same of the file of the contours.
    pub contour_columns: Option<Vec<String>>,
    /// Of a sequence file, the transform that is the sensor in the world, such as `ProbeToTracker`; or a name
    /// for which a chain of its transforms and their inverses stands, such as `ProbeToReference`. Of an MCAP
    /// file, the transform of the child `Probe` in the parent `Tracker`.
    pub transform: Option<String>,
    /// Of an MCAP file, the topic of the poses, where there are several.
    pub topic: Option<String>,
    /// Of an MCAP file, the topic of the contours, where there are several.
    pub contour_topic: Option<String>,
    /// Of a sequence file, which of its times count.
    pub timestamps: Timestamps,
    /// Of a sequence file, contours in a CSV file as [`Recording::read`] has them in a folder, by the frames' numbers.
    pub contours: Option<PathBuf>,
    /// Of a sequence file, a PLUS configuration with more transforms, such as `ImageToProbe`.
    pub plus_config: Option<PathBuf>,
}

crate::setters::setters!(ReadOptions {
    with_pose_columns => pose_columns: Option<Vec<String>>,
    with_contour_columns => contour_columns: Option<Vec<String>>,
    with_transform => transform: Option<String>,
    with_topic => topic: Option<String>,
    with_contour_topic => contour_topic: Option<String>,
    with_timestamps => timestamps: Timestamps,
    with_contours => contours: Option<PathBuf>,
    with_plus_config => plus_config: Option<PathBuf>,
});

impl ReadOptions {
    /// The first option that is not for this kind of recording, and the kind that it is for.
    fn misplaced(
        &self,
        is_folder: bool,
        is_sequence: bool,
        is_mcap: bool,
    ) -> Option<(&'static str, &'static str)> {
        const CSV: &str = "a folder of CSV files";
        const SEQUENCE: &str = "a sequence file (.igs.mha, .igs.nrrd, …)";
        const MCAP: &str = "an MCAP file";
        let with_contours = is_sequence && self.contours.is_some();
        [
            (self.pose_columns.is_some() && !is_folder, "names of pose columns", CSV),
            (
                self.contour_columns.is_some() && !is_folder && !with_contours,
                "names of contour columns",
                "a folder of CSV files, or a sequence file with contours in one",
            ),
            (
                self.transform.is_some() && !is_sequence && !is_mcap,
                "name of a transform",
                "a sequence file (.igs.mha, .igs.nrrd, …) or an MCAP file",
            ),
            (self.topic.is_some() && !is_mcap, "topic of poses", MCAP),
            (self.contour_topic.is_some() && !is_mcap, "topic of contours", MCAP),
            (self.timestamps != Timestamps::default() && !is_sequence, "kind of timestamps", SEQUENCE),
            (self.contours.is_some() && !is_sequence, "file of contours", SEQUENCE),
            (self.plus_config.is_some() && !is_sequence, "PLUS configuration", SEQUENCE),
        ]
        .into_iter()
        .find(|(is_misplaced, ..)| *is_misplaced)
        .map(|(_, option, kind)| (option, kind))
    }
}

/// Times of a sequence file's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Timestamps {
    /// `Timestamp`, from which PLUS has taken the jitter.
    #[default]
    Filtered,
    /// `UnfilteredTimestamp`: when the data arrived.
    Unfiltered,
}

/// Why a frame cannot be used.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Defect {
    /// The quantity.
    pub field: &'static str,
    /// What was there.
    pub found: String,
    /// What should have been there.
    pub expected: &'static str,
}

impl Frame {
    /// See [`Recording::check`]; `index` is the frame's number for the message.
    ///
    /// # Errors
    /// [`Error::Frame`] with the first defect.
    pub fn check(&self, index: usize) -> Result<()> {
        match self.defects().into_iter().next() {
            None => Ok(()),
            Some(Defect { field, found, expected }) => {
                Err(Error::Frame { frame: index, field, found, expected: expected.into() })
            }
        }
    }

    /// The defects that make the frame unusable, at most one per quantity: a pose that is not finite or not a rotation, a
    /// time or a phase that is not finite, a contour point with one coordinate missing or farther than 1 km from the probe, a cylinder that is not finite or whose
    /// radius is not positive or larger than that of any vessel.
    pub fn defects(&self) -> Vec<Defect> {
        let position = self.world_from_sensor.translation_mm;
        let mut defects = Vec::new();
        let mut add = |field, found, expected| defects.push(Defect { field, found, expected });
        let is_lost = position.is_nan() && self.world_from_sensor.rotation.is_nan();
        if is_lost {
            add("pose", "none".into(), "a pose: the tracker reported none");
        } else if !position.is_finite() || position.abs().max_element() > MAX_POSITION_MM {
            let [x, y, z] = position.to_array().map(shown);
            add(
                "position",
                format!("[{x}, {y}, {z}]"),
                "three finite numbers in mm, at most 1e6 from the origin",
            );
        }
        if let Some((found, expected)) = self.rotation_defect().filter(|_| !is_lost) {
            add("rotation", found, expected);
        }
        if let Some(t) = self.time_s.filter(|t| !t.is_finite()) {
            add("time", t.to_string(), "a finite number of seconds");
        }
        if let Some(phase) = self.phase.filter(|phase| !phase.is_finite()) {
            add("phase", phase.to_string(), "a finite number of cycles");
        }
        let is_echo = |p: &DVec2| p.abs().max_element() <= MAX_POSITION_MM && !p.is_nan();
        let is_missing = |p: &DVec2| p.x.is_nan() && p.y.is_nan();
        if let Some(i) = self.contour_mm.iter().position(|p| !is_echo(p) && !is_missing(p)) {
            let [x, y] = self.contour_mm[i].to_array().map(shown);
            let expected =
                "two finite numbers in mm, at most 1e6 from the probe, or NaN in both for a missing echo";
            add("contour", format!("({x}, {y}) at point {i}"), expected);
        }
        if let Some(c) = &self.cylinder {
            if !c.is_finite() {
                add("cylinder", format!("{c:?}"), "five finite numbers");
            } else if !(0.0 < c.radius_mm && c.radius_mm <= MAX_RADIUS_MM) {
                add("cylinder radius", format!("{:?} mm", c.radius_mm), "more than 0 and at most 10000 mm");
            }
        }
        defects
    }

    /// A frame from a 4×4 matrix `m[row][column]`, the tracker sensor in the world with the translation in mm, and its
    /// contour in the probe's plane, mm. A matrix with a number that is NaN is a [lost](Pose::LOST) pose; a rotation that
    /// was rounded to few digits, such as one of single precision, is made orthonormal.
    ///
    /// # Errors
    /// [`Error::Recording`] where the last row is not 0 0 0 1.
    pub fn from_matrix(world_from_sensor: &[[f64; 4]; 4], contour_mm: Vec<DVec2>) -> Result<Self> {
        let is_lost = world_from_sensor.as_flattened().iter().any(|x| x.is_nan());
        let pose = match is_lost {
            true => Pose::LOST,
            false => Pose::from_matrix(world_from_sensor).map_err(|row| Error::Recording {
                field: "pose",
                found: format!("a matrix whose last row is {row:?}"),
                expected: "0 0 0 1 there, and the translation in the last column".into(),
            })?,
        };
        let mut frame = Self::new(pose, contour_mm);
        frame.orthonormalise();
        Ok(frame)
    }

    /// Makes a rotation orthonormal that was rounded to few digits.
    fn orthonormalise(&mut self) {
        let error = self.world_from_sensor.orthogonality_error();
        if ROTATION_TOLERANCE < error && error <= ROUNDING_TOLERANCE {
            self.world_from_sensor = self.world_from_sensor.orthonormalised();
            self.rotation_error = Some(error);
        }
    }

    fn rotation_defect(&self) -> Option<(String, &'static str)> {
        let rotation = &self.world_from_sensor.rotation;
        if !rotation.is_finite() {
            return Some(("a number that is not finite".into(), "nine finite numbers"));
        }
        let determinant = rotation.determinant();
        if determinant < 0.0 {
            return Some((format!("determinant {determinant:.3}"), "1 (right-handed axes)"));
        }
        let error = self.world_from_sensor.orthogonality_error();
        if error <= ROTATION_TOLERANCE {
            return None;
        }
        // Orthogonal axes of equal length come from a quaternion that is not unit.
        let length = rotation.x_axis.length();
        let scaled = Pose { rotation: *rotation * length.recip(), ..self.world_from_sensor };
        if length == 0.0 {
            Some(("a first axis of length 0".into(), "unit axes (a unit quaternion)"))
        } else if scaled.orthogonality_error() <= ROTATION_TOLERANCE {
            let norm = length.sqrt();
            Some((
                format!("axes of length {length:.4} (a quaternion of norm {norm:.4})"),
                "unit axes (a unit quaternion)",
            ))
        } else {
            Some((format!("|RᵀR - I| = {error:.3e}"), "at most 1e-3 (orthogonal unit axes)"))
        }
    }
}

/// A number for a message: without hundreds of digits where it is large.
fn shown(number: f64) -> String {
    if number.abs() < 1e7 || !number.is_finite() { number.to_string() } else { format!("{number:e}") }
}

/// Farthest that a sensor lies from its tracker's origin in each axis, mm: a kilometre. Trackers send larger numbers for
/// a sensor that they have lost.
const MAX_POSITION_MM: f64 = 1e6;

/// Largest element of |RᵀR − I| that rounding in a tracker's output explains.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// Largest element of |RᵀR − I| that rounding to two or three digits explains: readers make such rotations
/// orthonormal.
const ROUNDING_TOLERANCE: f64 = 1e-2;

fn is_ndjson(path: &Path) -> bool {
    matches!(ending(path).as_str(), "ndjson" | "jsonl")
}

fn is_mcap(path: &Path) -> bool {
    cfg!(feature = "mcap") && ending(path) == "mcap"
}

fn unknown_ending(path: &Path) -> Error {
    Error::UnknownEnding {
        path: path.to_owned(),
        ending: ending(path),
        expected: "mat, mha, mhd, nrrd, ndjson, or none for a folder of CSV files",
    }
}
