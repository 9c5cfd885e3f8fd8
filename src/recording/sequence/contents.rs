//! What a sequence file has, for people who have to choose from it.

use super::{CONTOUR_X, Sequence};
use crate::recording::summary::{MinMedianMax, min_median_max};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// What a sequence file has.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SequenceContents {
    /// Frames.
    pub frames: usize,
    /// Numbers between the first and the last frame's that no frame has.
    pub gaps: usize,
    /// The transforms, by name.
    pub transforms: Vec<TransformContents>,
    /// First and last `Timestamp`, s.
    pub times_s: Option<[f64; 2]>,
    /// Time between consecutive frames, s.
    pub interval_s: Option<MinMedianMax>,
    /// Frames whose time does not lie after that of the frame before.
    pub times_not_rising: usize,
    /// The images.
    pub images: Option<SequenceImages>,
    /// Frames with a [contour](CONTOUR_X).
    pub contours: usize,
    /// Other fields of frames, by name.
    pub fields: Vec<String>,
}

/// One transform of a sequence file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct TransformContents {
    /// Its name, such as `ProbeToTracker`.
    pub name: String,
    /// Frames by the status that they give it: `OK`, `INVALID`, …; `not stated` where there is none, `absent` where the frame
    /// lacks the transform. The first two count as poses.
    pub statuses: BTreeMap<String, usize>,
}

/// The images of a sequence file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct SequenceImages {
    /// How many.
    pub count: usize,
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Type of the pixels, in the words of the file.
    pub pixels: String,
    /// What the file says about the directions of rows and columns, such as `MF`.
    pub orientation: String,
}

pub(super) fn contents(sequence: &Sequence) -> SequenceContents {
    let frames = &sequence.frames;
    let transform = |name: &str| {
        let mut statuses = BTreeMap::new();
        for frame in frames {
            let status = match frame.transforms.get(name) {
                None => "absent",
                Some(tracked) if !tracked.is_there() => "absent",
                Some(tracked) => tracked.status.as_deref().unwrap_or("not stated"),
            };
            *statuses.entry(crate::text::shown(status, 40)).or_insert(0) += 1;
        }
        TransformContents { name: name.to_owned(), statuses }
    };
    let times: Vec<f64> = frames
        .iter()
        .filter_map(|frame| frame.fields.get("Timestamp")?.parse().ok())
        .filter(|t: &f64| t.is_finite())
        .collect();
    let intervals = || times.windows(2).map(|pair| pair[1] - pair[0]);
    let is_contour = |name: &&String| name.starts_with("LumenContour");
    let fields: BTreeSet<&String> = frames.iter().flat_map(|frame| frame.fields.keys()).collect();
    let has_contour = |fields: &BTreeMap<String, String>| {
        fields.contains_key(CONTOUR_X) || fields.contains_key(&format!("{CONTOUR_X}0"))
    };
    let numbers = frames.first().zip(frames.last()).map_or(0, |(a, b)| b.number - a.number + 1);
    SequenceContents {
        frames: frames.len(),
        gaps: numbers.saturating_sub(frames.len()),
        transforms: sequence.transform_names().into_iter().map(transform).collect(),
        times_s: times.first().zip(times.last()).map(|(first, last)| [*first, *last]),
        interval_s: min_median_max(intervals()),
        times_not_rising: intervals().filter(|s| *s <= 0.0).count(),
        images: sequence.images.as_ref().map(|images| SequenceImages {
            count: images.count,
            width: images.width,
            height: images.height,
            pixels: images.pixel_name.clone(),
            orientation: images.orientation.clone(),
        }),
        contours: frames.iter().filter(|frame| has_contour(&frame.fields)).count(),
        fields: fields.into_iter().filter(|name| !is_contour(name)).cloned().collect(),
    }
}

impl fmt::Display for SequenceContents {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "sequence        {} frames", self.frames)?;
        match self.gaps {
            0 => writeln!(f)?,
            gaps => writeln!(f, ", {gaps} numbers between them are missing")?,
        }
        if self.transforms.is_empty() {
            writeln!(f, "transforms      none")?;
        }
        for (k, TransformContents { name, statuses }) in self.transforms.iter().enumerate() {
            let label = if k == 0 { "transforms" } else { "" };
            let counts: Vec<String> =
                statuses.iter().map(|(status, count)| format!("{count} {status}")).collect();
            writeln!(f, "{label:<15} {name}: {}", counts.join(", "))?;
        }
        match (self.times_s, self.interval_s) {
            (Some([first, last]), Some(interval)) => {
                write!(f, "timestamps      {first:.3} to {last:.3} s, {interval:.4} s between frames")?;
                match self.times_not_rising {
                    0 => writeln!(f)?,
                    n => writeln!(f, "; {n} do not rise")?,
                }
            }
            (Some([first, _]), None) => writeln!(f, "timestamps      {first:.3} s")?,
            _ => writeln!(f, "timestamps      none")?,
        }
        match &self.images {
            None => writeln!(f, "images          none")?,
            Some(SequenceImages { count, width, height, pixels, orientation }) => {
                write!(f, "images          {count} of {width} × {height}, {pixels}")?;
                match orientation.as_str() {
                    "" => writeln!(f)?,
                    orientation => writeln!(f, ", orientation {}", crate::text::shown(orientation, 40))?,
                }
            }
        }
        writeln!(f, "contours        in {} frames", self.contours)?;
        if !self.fields.is_empty() {
            writeln!(f, "other fields    {}", crate::text::shown(&self.fields.join(", "), 400))?;
        }
        Ok(())
    }
}
