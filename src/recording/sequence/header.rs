//! The headers of MetaImage and NRRD files.

use super::image::{Encoding, Images, PixelType};
use super::transforms::{self, ENDING, STATUS_ENDING};
use super::{Sequence, SequenceFrame, Tracked};
use crate::{Error, Result, text};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// The longest line that is read, bytes. IGSIO and Slicer cut lines at 999 and drop what follows; longer ones come from
/// other programs.
const LONGEST_LINE: u64 = 1 << 22;
/// Frames of a file without frame fields that are taken for a sequence of images, at most.
const MAX_FRAMES: usize = 10_000_000;

pub(super) fn read(path: &Path) -> Result<Sequence> {
    let file = File::open(path).map_err(|source| Error::read(path, source))?;
    let mut lines = Lines { path, reader: BufReader::with_capacity(1 << 16, file), offset: 0 };
    let first = lines.next()?.unwrap_or_default();
    if first.starts_with("NRRD000") { nrrd(lines) } else { meta_image(lines, &first) }
}

/// The lines of a header, and how many bytes they take.
struct Lines<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    offset: u64,
}

impl Lines<'_> {
    /// The next line without its end; `None` at the end of the file.
    fn next(&mut self) -> Result<Option<String>> {
        let mut line = Vec::new();
        let read = self.reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line);
        let read = read.map_err(|source| Error::read(self.path, source))?;
        self.offset += read as u64;
        if read as u64 == LONGEST_LINE {
            let expected = format!("at most {LONGEST_LINE} bytes in a line of the header");
            return Err(Error::input(self.path, "line", "a longer one", expected));
        }
        Ok((read > 0).then(|| text::decoded(&line).trim().to_owned()))
    }

    /// The data after the header, or in a file that the header names.
    fn data(&self, named: Option<&str>) -> (PathBuf, u64) {
        match named {
            None => (self.path.to_owned(), self.offset),
            Some(name) => (crate::output::folder_of(self.path).join(name), 0),
        }
    }
}

/// The fields of a header: those of the file, and those of its frames.
#[derive(Default)]
struct Fields {
    file: BTreeMap<String, String>,
    frames: BTreeMap<usize, SequenceFrame>,
}

impl Fields {
    /// Takes a field of a frame or of the file.
    fn add(&mut self, name: &str, value: &str) {
        match frame_field(name) {
            Some((number, field)) => {
                let frame = self
                    .frames
                    .entry(number)
                    .or_insert_with(|| SequenceFrame { number, ..SequenceFrame::default() });
                if let Some(name) = field.strip_suffix(STATUS_ENDING) {
                    frame.transforms.entry(name.to_owned()).or_default().status = Some(value.to_owned());
                } else if let Some(name) = field.strip_suffix(ENDING).filter(|name| !name.is_empty()) {
                    let tracked: &mut Tracked = frame.transforms.entry(name.to_owned()).or_default();
                    tracked.matrix = transforms::matrix(value);
                    tracked.text =
                        if tracked.matrix.is_none() { text::shown(value, 200) } else { String::new() };
                } else {
                    frame.fields.insert(field.to_owned(), value.to_owned());
                }
            }
            None => drop(self.file.insert(name.to_owned(), value.to_owned())),
        }
    }

    /// The frames: those that have fields, or else one for each image.
    fn frames(self, images: Option<&Images>, times_s: &[f64]) -> Vec<SequenceFrame> {
        if !self.frames.is_empty() {
            return self.frames.into_values().collect();
        }
        let frame = |number: usize| {
            let time = times_s.get(number).map(|t| ("Timestamp".to_owned(), t.to_string()));
            SequenceFrame { number, fields: time.into_iter().collect(), ..SequenceFrame::default() }
        };
        (0..images.map_or(0, |images| images.count).min(MAX_FRAMES)).map(frame).collect()
    }
}

/// The number and the field of a name such as `Seq_Frame0012_Timestamp`.
fn frame_field(name: &str) -> Option<(usize, &str)> {
    const PREFIX: &str = "Seq_Frame";
    let (prefix, rest) = name.split_at_checked(PREFIX.len())?;
    let (digits, field) = rest.split_once('_').filter(|_| prefix.eq_ignore_ascii_case(PREFIX))?;
    Some((digits.parse().ok().filter(|_| !digits.starts_with('+'))?, field))
}

fn meta_image(mut lines: Lines, first: &str) -> Result<Sequence> {
    let path = lines.path;
    let mut fields = Fields::default();
    let mut line = first.to_owned();
    let data = loop {
        if let Some((name, value)) = line.split_once('=') {
            let (name, value) = (name.trim(), value.trim());
            if name == "ElementDataFile" {
                break value.to_owned();
            }
            fields.add(name, value);
        }
        let is_known = !fields.file.is_empty() || !fields.frames.is_empty();
        line = match lines.next()? {
            Some(next) if is_known => next,
            _ => {
                let found = if is_known { "a header without an end" } else { "another kind of file" };
                let expected = "a MetaImage, whose header ends with ElementDataFile, or NRRD";
                return Err(Error::input(path, "header", found, expected));
            }
        };
    };
    let named = Some(data.as_str()).filter(|name| !name.eq_ignore_ascii_case("LOCAL"));
    let get = |name: &str| fields.file.get(name).map(String::as_str);
    let is_true = |name: &str| get(name).is_some_and(|value| value.eq_ignore_ascii_case("true"));
    let sizes = counts(path, "DimSize", get("DimSize").unwrap_or_default())?;
    let channels = counts(path, "ElementNumberOfChannels", get("ElementNumberOfChannels").unwrap_or("1"))?;
    let (data, offset) = lines.data(named);
    let images = shape(&sizes, sizes.len().saturating_sub(1)).map(|[width, height, count]| Images {
        width,
        height,
        count,
        channels: channels.first().copied().unwrap_or(1),
        frames_first: false,
        pixel: PixelType::of_meta_image(get("ElementType").unwrap_or_default()),
        pixel_name: get("ElementType").unwrap_or("none").to_owned(),
        big_endian: is_true("BinaryDataByteOrderMSB") || is_true("ElementByteOrderMSB"),
        encoding: if is_true("CompressedData") { Encoding::Zlib } else { Encoding::Raw },
        orientation: get("UltrasoundImageOrientation").unwrap_or_default().to_owned(),
        data,
        offset,
    });
    let frames = fields.frames(images.as_ref(), &[]);
    Ok(Sequence { path: path.to_owned(), frames, images })
}

fn nrrd(mut lines: Lines) -> Result<Sequence> {
    let path = lines.path;
    let mut fields = Fields::default();
    // Lower case without blanks: `space directions` is also written `spacedirections`.
    let mut own: BTreeMap<String, String> = BTreeMap::new();
    while let Some(line) = lines.next()?.filter(|line| !line.is_empty()) {
        if line.starts_with('#') {
            continue;
        }
        // `key:=value` is free, `field: value` is the format's own.
        match (line.split_once(":="), line.split_once(':')) {
            (Some((name, value)), Some((shorter, _))) if name == shorter => {
                fields.add(name.trim(), value.trim());
            }
            (_, Some((name, value))) => {
                let name = name.chars().filter(|c| !c.is_whitespace()).collect::<String>().to_lowercase();
                own.insert(name, value.trim().to_owned());
            }
            _ => {}
        }
    }
    let get = |name: &str| own.get(name).map(String::as_str);
    let sizes = counts(path, "sizes", get("sizes").unwrap_or_default())?;
    let kinds: Vec<String> =
        get("kinds").unwrap_or_default().split_whitespace().map(str::to_lowercase).collect();
    let is_of_frames = |kind: &String| kind == "list" || kind == "time";
    let is_of_channels = |kind: &String| kind.contains("color") || kind.contains("vector");
    let channel_axis = kinds.iter().position(is_of_channels).filter(|&axis| axis < sizes.len());
    let mut axes: Vec<usize> = (0..sizes.len()).filter(|&axis| Some(axis) != channel_axis).collect();
    let list_axis = axes.iter().position(|&axis| kinds.get(axis).is_some_and(is_of_frames));
    let frame_axis = list_axis.unwrap_or(axes.len().saturating_sub(1));
    let frames_first = frame_axis == 0 && axes.len() > 2;
    let sizes: Vec<usize> = axes.drain(..).map(|axis| sizes[axis]).collect();
    // Two axes without a list are one image.
    let shape = match (sizes.len(), list_axis) {
        (2, None) => shape(&[sizes[0], sizes[1], 1], 2),
        _ => shape(&sizes, frame_axis),
    };
    let channels = channel_axis.map_or(1, |axis| {
        counts(path, "sizes", get("sizes").unwrap_or_default()).map_or(1, |sizes| sizes[axis])
    });
    let (data, offset) = lines.data(get("datafile"));
    let skips = ["byteskip", "lineskip"].iter().any(|name| get(name).is_some_and(|n| n != "0"));
    let encoding = match get("encoding").unwrap_or("raw").to_lowercase().as_str() {
        "raw" if !skips => Encoding::Raw,
        "gz" | "gzip" if !skips => Encoding::Gzip,
        other => Encoding::Other(if skips { "skipped bytes or lines".into() } else { other.to_owned() }),
    };
    let orientation = ["ultrasound image orientation", "UltrasoundImageOrientation"];
    let orientation = orientation.iter().find_map(|name| fields.file.get(*name)).cloned();
    let images = shape.map(|[width, height, count]| Images {
        width,
        height,
        count,
        channels,
        frames_first,
        pixel: PixelType::of_nrrd(get("type").unwrap_or_default()),
        pixel_name: get("type").unwrap_or("none").to_owned(),
        big_endian: get("endian").is_some_and(|endian| endian.eq_ignore_ascii_case("big")),
        encoding,
        orientation: orientation.unwrap_or_default(),
        data,
        offset,
    });
    // Slicer's own sequences of images: the times are those of an axis.
    let times_s: Vec<f64> = fields
        .file
        .iter()
        .find(|(name, _)| name.starts_with("axis ") && name.ends_with(" index values"))
        .map(|(_, values)| values.split_whitespace().map_while(|t| t.parse().ok()).collect())
        .unwrap_or_default();
    let frames = fields.frames(images.as_ref(), &times_s);
    Ok(Sequence { path: path.to_owned(), frames, images })
}

/// Width, height and number of images; `None` where the sizes are of no images.
fn shape(sizes: &[usize], frame_axis: usize) -> Option<[usize; 3]> {
    let count = *sizes.get(frame_axis)?;
    let others: Vec<usize> =
        sizes.iter().enumerate().filter(|(axis, _)| *axis != frame_axis).map(|(_, size)| *size).collect();
    match others[..] {
        [width, height] | [width, height, 1] if width > 0 && height > 0 => Some([width, height, count]),
        _ => None,
    }
}

fn counts(path: &Path, field: &str, text: &str) -> Result<Vec<usize>> {
    let count = |word: &str| {
        word.parse::<usize>()
            .map_err(|_| Error::input(path, field, format!("{text:?}"), "whole numbers separated by blanks"))
    };
    text.split_whitespace().map(count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_frames_are_told_from_others() {
        assert_eq!(frame_field("Seq_Frame0003_Timestamp"), Some((3, "Timestamp")));
        assert_eq!(frame_field("seq_frame12345_A_B"), Some((12345, "A_B")));
        for other in ["Seq_Frame_Timestamp", "Seq_Frame+1_Timestamp", "Seq_Frame1", "DimSize", "Seq_Früme1_A"]
        {
            assert_eq!(frame_field(other), None, "{other}");
        }
    }
}
