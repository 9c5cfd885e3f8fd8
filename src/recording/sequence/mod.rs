//! Sequence files of PLUS, IGSIO and 3D Slicer: transforms, times and images of each frame, in MetaImage (`.igs.mha`,
//! `.igs.mhd`, `.seq.mha`) or NRRD (`.igs.nrrd`, `.seq.nrrd`).
//!
//! A frame's fields are lines `Seq_FrameNNNN_Field = value`. Those that end in `Transform` are matrices, with a status beside
//! them that says whether the tracker saw the tool. No field for contours is common: [`CONTOUR_X`] and
//! [`CONTOUR_Y`] are this project's own.

mod contents;
mod header;
mod image;
mod transforms;
mod write;

pub use contents::{SequenceContents, SequenceImages, TransformContents};
pub use image::{Image, PixelType};
pub(super) use write::write;

use super::formats::csv;
use super::{Frame, ReadOptions, Recording, Timestamps};
use crate::geometry::Pose;
use crate::{Error, Result};
use glam::{DMat4, DVec2};
use image::Images;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use transforms::Graph;

/// The frame field with the contour's x, mm in the probe's plane, separated by blanks; `nan`: no echo. Where a line would
/// grow longer than other readers take, `LumenContourX0`, `LumenContourX1`, … follow each other.
pub const CONTOUR_X: &str = "LumenContourX";
/// As [`CONTOUR_X`], of y.
pub const CONTOUR_Y: &str = "LumenContourY";

/// The transform that is the pose where a file has several and none is named.
const USUAL_POSE: &str = "ProbeToTracker";

/// A sequence file. Its images are read when they are asked for.
#[derive(Debug, Clone)]
pub struct Sequence {
    path: PathBuf,
    frames: Vec<SequenceFrame>,
    /// How the images are stored, where there are any.
    images: Option<Images>,
}

/// What the file says about one frame.
#[derive(Debug, Clone, Default)]
struct SequenceFrame {
    /// Its number in the names of the fields.
    number: usize,
    transforms: BTreeMap<String, Tracked>,
    /// All other fields.
    fields: BTreeMap<String, String>,
}

/// A transform of a frame, and what the tracker says about it.
#[derive(Debug, Clone, Default)]
struct Tracked {
    /// `None`: its text is no matrix.
    matrix: Option<DMat4>,
    /// `None`: the file does not say, which counts as OK.
    status: Option<String>,
    /// The field's text, where it is no matrix.
    text: String,
}

impl Tracked {
    fn is_there(&self) -> bool {
        self.matrix.is_some() || !self.text.is_empty()
    }

    fn is_ok(&self) -> bool {
        self.status.as_ref().is_none_or(|status| status.eq_ignore_ascii_case("OK"))
    }
}

fn is_ending(ending: &str) -> bool {
    matches!(ending, "mha" | "mhd" | "nrrd" | "nhdr")
}

impl Sequence {
    /// Whether a file's name ends as those of sequence files do.
    pub fn has_ending(path: &Path) -> bool {
        !path.is_dir() && is_ending(&crate::output::ending(path))
    }

    /// Reads the header of a sequence file.
    ///
    /// # Errors
    /// Where the file cannot be read or is neither MetaImage nor NRRD.
    pub fn read(path: &Path) -> Result<Self> {
        header::read(path)
    }

    /// Frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// What the file has: its transforms with their statuses, times, images and other fields.
    pub fn contents(&self) -> SequenceContents {
        contents::contents(self)
    }

    /// The images, one for each frame in the order of the file, with the place of its frame.
    ///
    /// # Errors
    /// Where there are none, or they are stored in a way that is not read.
    pub fn images(&self) -> Result<impl Iterator<Item = Result<(usize, Image)>> + use<>> {
        let images = self.images.as_ref().ok_or_else(|| {
            Error::input(&self.path, "images", "none", "images, as DimSize or sizes announces them")
        })?;
        let places = self.places_of_images(images.count);
        let path = self.path.clone();
        let reader = images.reader(&self.path)?;
        Ok(reader.enumerate().filter_map(move |(k, image)| {
            let image = image.map_err(|e: Error| match (e, places.get(k)) {
                (Error::Recording { field, found, expected }, _) => {
                    Error::input(&path, format!("{field} of image {k}"), found, expected)
                }
                (other, _) => other,
            });
            match image {
                Ok(image) => places.get(k).copied().flatten().map(|place| Ok((place, image))),
                Err(error) => Some(Err(error)),
            }
        }))
    }

    /// For each image the place of its frame: by number where the numbers are those of images, else by order.
    fn places_of_images(&self, count: usize) -> Vec<Option<usize>> {
        let by_number = self.frames.last().is_none_or(|last| last.number < count);
        let mut places = vec![None; count];
        for (k, frame) in self.frames.iter().enumerate() {
            let image = if by_number { frame.number } else { k };
            if let Some(place) = places.get_mut(image) {
                *place = Some(k);
            }
        }
        places
    }

    /// The recording of this file. Poses are those of the transform that the options name, or of a chain of transforms and
    /// their inverses that leads from its first coordinate system to its second; frames in which one of them is missing or not OK have a
    /// [lost](Pose::LOST) pose. Contours are those of the [fields](CONTOUR_X), or of the options' CSV file.
    ///
    /// # Errors
    /// Where the transform is not there, none is named and no one is obvious, a field that is used cannot be understood,
    /// or there is no contour at all.
    pub fn recording(&self, options: &ReadOptions) -> Result<Recording> {
        let mut recording = self.poses(options)?;
        match &options.contours {
            Some(path) => self.add_contours(path, options, &mut recording)?,
            None => {
                for (frame, there) in recording.frames.iter_mut().zip(&self.frames) {
                    frame.contour_mm = self.contour_mm(there)?;
                }
            }
        }
        if recording.frames.iter().all(|frame| frame.contour_mm.is_empty()) {
            let found = format!("none in its {} frames", self.frames.len());
            let expected = format!(
                "frame fields {CONTOUR_X} and {CONTOUR_Y}, a CSV file of them (--contours FILE), or images \
                 of the lumen (lumenmesh import mask)"
            );
            return Err(Error::input(&self.path, "contours", found, expected));
        }
        Ok(recording)
    }

    /// The poses and times, without contours.
    ///
    /// # Errors
    /// As [`recording`](Self::recording), but for contours.
    pub(super) fn poses(&self, options: &ReadOptions) -> Result<Recording> {
        if self.frames.is_empty() {
            return Err(Error::input(&self.path, "frames", "none", "fields Seq_Frame0000_… or images"));
        }
        let graph = Graph::of(self, options.plus_config.as_deref())?;
        let name = match &options.transform {
            Some(name) => transforms::without_ending(name).to_owned(),
            None => self.obvious_pose()?,
        };
        let chain = graph.chain(&name).ok_or_else(|| self.no_transform(&name, &graph))?;
        let frame = |(k, there): (usize, &SequenceFrame)| {
            let in_file = |e: Error| e.in_frame_of(&self.path, there.number);
            let frame = match chain.of(there).map_err(in_file)? {
                Some(matrix) => {
                    let rows = matrix.transpose().to_cols_array_2d();
                    Frame::from_matrix(&rows, Vec::new()).map_err(in_file)?
                }
                None => Frame::new(Pose::LOST, Vec::new()),
            };
            Ok(frame
                .with_time_s(self.time_s(there, options.timestamps)?)
                .with_number(Some(there.number).filter(|&number| number != k)))
        };
        Ok(Recording { frames: self.frames.iter().enumerate().map(frame).collect::<Result<_>>()? })
    }

    /// For each frame the matrix that takes coordinates of one system to those of another; `None` where it is not known.
    ///
    /// # Errors
    /// Where no chain of transforms leads from one to the other.
    pub(super) fn matrices(&self, name: &str, options: &ReadOptions) -> Result<Vec<Option<DMat4>>> {
        let graph = Graph::of(self, options.plus_config.as_deref())?;
        let chain = graph.chain(name).ok_or_else(|| self.no_transform(name, &graph))?;
        let of = |there: &SequenceFrame| chain.of(there).map_err(|e| e.in_frame_of(&self.path, there.number));
        self.frames.iter().map(of).collect()
    }

    /// The only transform, or the one that PLUS gives the probe.
    fn obvious_pose(&self) -> Result<String> {
        let names: Vec<&str> = self.transform_names().into_iter().collect();
        match names[..] {
            [] => Err(Error::input(
                &self.path,
                "transforms",
                "none",
                "frame fields such as Seq_Frame0000_ProbeToTrackerTransform",
            )),
            [only] => Ok(only.to_owned()),
            _ if names.contains(&USUAL_POSE) => Ok(USUAL_POSE.to_owned()),
            _ => Err(Error::input(
                &self.path,
                "transform",
                format!("{}, and none named", names.join(", ")),
                "the name of one (--transform), or of a chain of them",
            )),
        }
    }

    /// The transforms that some frame has; a status alone is none.
    fn transform_names(&self) -> BTreeSet<&str> {
        let transforms = self.frames.iter().flat_map(|frame| &frame.transforms);
        transforms.filter(|(_, tracked)| tracked.is_there()).map(|(name, _)| name.as_str()).collect()
    }

    fn no_transform(&self, name: &str, graph: &Graph) -> Error {
        let expected = match graph.names() {
            names if names.is_empty() => "a file with transforms".into(),
            names => format!("one of {names}, or a chain of them and their inverses"),
        };
        Error::input(&self.path, "transform", name, expected)
    }

    fn time_s(&self, frame: &SequenceFrame, timestamps: Timestamps) -> Result<Option<f64>> {
        let names = match timestamps {
            Timestamps::Filtered => ["Timestamp", "UnfilteredTimestamp"],
            Timestamps::Unfiltered => ["UnfilteredTimestamp", "Timestamp"],
        };
        let Some((name, text)) = names.iter().find_map(|name| Some((name, frame.fields.get(*name)?))) else {
            return Ok(None);
        };
        let seconds = text.parse::<f64>().map_err(|_| {
            Error::input(&self.path, *name, format!("{text:?}"), "a number of seconds")
                .in_frame_of(&self.path, frame.number)
        })?;
        // A NaN is how a tracker's program says that it does not know.
        Ok(Some(seconds).filter(|s| !s.is_nan()))
    }

    fn contour_mm(&self, frame: &SequenceFrame) -> Result<Vec<DVec2>> {
        let of = |name: &'static str| self.numbers(frame, name);
        let (xs, ys) = (of(CONTOUR_X)?, of(CONTOUR_Y)?);
        if xs.len() != ys.len() {
            let found = format!("{} numbers in {CONTOUR_X} and {} in {CONTOUR_Y}", xs.len(), ys.len());
            return Err(Error::input(&self.path, "contour", found, "as many of each")
                .in_frame_of(&self.path, frame.number));
        }
        Ok(xs.into_iter().zip(ys).map(|(x, y)| DVec2::new(x, y)).collect())
    }

    /// The numbers of a field, or of its pieces with 0, 1, … after its name.
    fn numbers(&self, frame: &SequenceFrame, name: &'static str) -> Result<Vec<f64>> {
        let whole = frame.fields.get(name);
        let pieces = (0..).map_while(|k| frame.fields.get(&format!("{name}{k}")));
        let number = |text: &str| {
            text.parse::<f64>().map_err(|_| {
                Error::input(&self.path, name, format!("{text:?}"), "numbers separated by blanks")
                    .in_frame_of(&self.path, frame.number)
            })
        };
        whole.into_iter().chain(pieces).flat_map(|text| text.split_ascii_whitespace()).map(number).collect()
    }

    /// Contours from a CSV file, by the frames' numbers.
    fn add_contours(&self, path: &Path, options: &ReadOptions, recording: &mut Recording) -> Result<()> {
        let numbers = self.frames.iter().map(|frame| frame.number);
        let mut frames: BTreeMap<usize, Frame> =
            numbers.clone().zip(std::mem::take(&mut recording.frames)).collect();
        let count = frames.len();
        csv::read_contours(path, options.contour_columns.as_deref(), &mut frames)?;
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        csv::check_numbering(path, &name, &frames, numbers)?;
        if frames.len() > count {
            let is_there = |number| self.frames.binary_search_by_key(number, |frame| frame.number).is_ok();
            let number = frames.keys().find(|number| !is_there(number)).copied().unwrap_or_default();
            return Err(Error::input(path, "frame", number, format!("a frame of {name}")));
        }
        recording.frames = frames.into_values().collect();
        Ok(())
    }
}
