//! Recordings as sequence files.

use super::{CONTOUR_X, CONTOUR_Y, USUAL_POSE};
use crate::output::{ending, write_atomically};
use crate::recording::formats::rising_numbers;
use crate::recording::{Frame, Recording};
use crate::{Error, Result};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Characters of a line that IGSIO and Slicer read; they cut longer ones.
const LONGEST_LINE: usize = 999;
/// Numbers of frames up to which the file gets an image each: PLUS counts images and frames alike.
const MAX_IMAGES: usize = 10_000_000;

/// Writes a recording for PLUS and Slicer: the pose as `ProbeToTracker`, times as `Timestamp`, contours in
/// [fields of their own](CONTOUR_X), and an image of one pixel for each frame, since other readers refuse files without images.
pub(in crate::recording) fn write(recording: &Recording, path: &Path) -> Result<()> {
    let mut numbers: Vec<usize> = rising_numbers(recording).collect();
    if numbers.last().is_some_and(|&last| last >= MAX_IMAGES) {
        numbers = (0..numbers.len()).collect();
    }
    let images = numbers.last().map_or(0, |last| last + 1);
    let frames = || numbers.iter().zip(&recording.frames);
    let pixels =
        |out: &mut dyn Write| std::io::copy(&mut std::io::repeat(0).take(images as u64), out).map(drop);
    use std::io::Read;
    match ending(path).as_str() {
        "nrrd" => write_atomically(path, |out| {
            writeln!(out, "NRRD0004\n# Complete NRRD file format specification at:")?;
            writeln!(out, "# http://teem.sourceforge.net/nrrd/format.html")?;
            writeln!(out, "type: uint8\ndimension: 3\nspace dimension: 3\nsizes: 1 1 {images}")?;
            writeln!(out, "space directions: (1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain list")?;
            writeln!(out, "encoding: raw\nspace origin: (0,0,0)")?;
            frames().try_for_each(|(number, frame)| fields(out, ":=", *number, frame))?;
            writeln!(out)?;
            pixels(out)
        }),
        ending => {
            let data = match ending {
                "mhd" => Some(raw_file(path)?),
                _ => None,
            };
            if let Some(data) = &data {
                write_atomically(data, pixels)?;
            }
            write_atomically(path, |out| {
                writeln!(
                    out,
                    "ObjectType = Image\nNDims = 3\nAnatomicalOrientation = RAI\nBinaryData = True"
                )?;
                writeln!(out, "BinaryDataByteOrderMSB = False\nCenterOfRotation = 0 0 0")?;
                writeln!(out, "CompressedData = False\nDimSize = 1 1 {images}\nElementNumberOfChannels = 1")?;
                writeln!(out, "ElementSpacing = 1 1 1\nElementType = MET_UCHAR\nKinds = domain domain list")?;
                writeln!(out, "Offset = 0 0 0\nTransformMatrix = 1 0 0 0 1 0 0 0 1")?;
                writeln!(out, "UltrasoundImageOrientation = MF\nUltrasoundImageType = BRIGHTNESS")?;
                frames().try_for_each(|(number, frame)| fields(out, " = ", *number, frame))?;
                match data.as_deref().and_then(Path::file_name) {
                    Some(name) => writeln!(out, "ElementDataFile = {}", name.to_string_lossy()),
                    None => writeln!(out, "ElementDataFile = LOCAL").and_then(|()| pixels(out)),
                }
            })
        }
    }
}

/// The file of the pixels beside a header.
fn raw_file(path: &Path) -> Result<PathBuf> {
    let data = path.with_extension("raw");
    match data.file_name().is_some_and(|name| name.to_str().is_some()) {
        true => Ok(data),
        false => Err(Error::input(path, "name", "bytes that are no UTF-8", "a name that a header can state")),
    }
}

fn fields(out: &mut dyn Write, equals: &str, number: usize, frame: &Frame) -> std::io::Result<()> {
    let prefix = format!("Seq_Frame{number:04}_");
    let (r, p) = (frame.world_from_sensor.rotation, frame.world_from_sensor.translation_mm);
    let row = |x: f64, y: f64, z: f64, t: f64| format!("{x} {y} {z} {t} ");
    writeln!(
        out,
        "{prefix}{USUAL_POSE}Transform{equals}{}{}{}0 0 0 1",
        row(r.x_axis.x, r.y_axis.x, r.z_axis.x, p.x),
        row(r.x_axis.y, r.y_axis.y, r.z_axis.y, p.y),
        row(r.x_axis.z, r.y_axis.z, r.z_axis.z, p.z)
    )?;
    writeln!(out, "{prefix}{USUAL_POSE}TransformStatus{equals}OK")?;
    if let Some(time) = frame.time_s {
        writeln!(out, "{prefix}Timestamp{equals}{time}")?;
    }
    writeln!(out, "{prefix}ImageStatus{equals}INVALID")?;
    if frame.contour_mm.is_empty() {
        return Ok(());
    }
    for (name, of) in [(CONTOUR_X, 0), (CONTOUR_Y, 1)] {
        let room = LONGEST_LINE - prefix.len() - name.len() - equals.len() - "1000000".len();
        let numbers = frame.contour_mm.iter().map(|point| match point[of] {
            x if x.is_nan() => "nan".to_owned(),
            x => x.to_string(),
        });
        let mut lines = vec![String::new()];
        for number in numbers {
            match lines.last_mut() {
                Some(line) if line.is_empty() => *line = number,
                Some(line) if line.len() + 1 + number.len() <= room => {
                    line.push(' ');
                    line.push_str(&number);
                }
                _ => lines.push(number),
            }
        }
        match &lines[..] {
            [line] => writeln!(out, "{prefix}{name}{equals}{line}")?,
            lines => {
                for (k, line) in lines.iter().enumerate() {
                    writeln!(out, "{prefix}{name}{k}{equals}{line}")?;
                }
            }
        }
    }
    Ok(())
}
