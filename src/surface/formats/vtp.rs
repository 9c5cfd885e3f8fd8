//! VTK XML PolyData, which ParaView and VMTK open: written as inline base64, read in all of VTK's own encodings (text,
//! base64, appended base64 or raw; plain or zlib; 32- or 64-bit block headers; either byte order).
//!
//! Layout: <https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html>

use crate::surface::{NodeArray, Surface, push_polygon};
use crate::{Error, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::io::{Read as _, Write};
use std::path::Path;

/// Deflate cannot expand by more than this: a block that claims more is wrong, and no block can demand much memory.
const LARGEST_DEFLATE_RATIO: u64 = 1032;

/// A `DataArray` as the file holds it.
struct DataArray {
    /// The element about it: `Points`, `Polys`, `Strips`, `PointData`, …
    parent: String,
    name: String,
    number: String,
    components: usize,
    format: String,
    offset: usize,
    text: String,
}

struct Document<'a> {
    path: &'a Path,
    big_endian: bool,
    /// Bytes of one number in the headers of binary blocks: 4 or 8.
    header_width: usize,
    compressed: bool,
    nodes: usize,
    arrays: Vec<DataArray>,
    appended_raw: bool,
    /// What follows the `_` of `AppendedData`.
    appended: &'a [u8],
}

pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<Surface> {
    let document = Document::parse(path, bytes)?;
    let mut surface = Surface::default();
    let points = document.array("Points", None)?;
    if points.components != 3 {
        return Err(Error::input(path, "Points", format!("{} components", points.components), "3"));
    }
    let coordinates = document.numbers(points)?;
    if coordinates.len() != document.nodes.saturating_mul(3) {
        return Err(Error::input(
            path,
            "Points",
            format!("{} coordinates", coordinates.len()),
            format!("3 for each of {} points", document.nodes),
        ));
    }
    surface.nodes_mm = coordinates.as_chunks::<3>().0.iter().copied().map(DVec3::from_array).collect();
    for array in document.arrays.iter().filter(|a| a.parent == "PointData" && a.components == 1) {
        let values = document.numbers(array)?;
        if values.len() != document.nodes {
            return Err(Error::input(
                path,
                format!("node array {:?}", array.name),
                format!("{} values", values.len()),
                document.nodes,
            ));
        }
        surface.arrays.push(NodeArray { name: array.name.clone(), values });
    }
    for (k, corners) in document.cells("Polys")?.iter().enumerate() {
        push_polygon(path, k, corners, surface.nodes_mm.len(), &mut surface.triangles)?;
    }
    for (k, strip) in document.cells("Strips")?.iter().enumerate() {
        for (i, corners) in strip.windows(3).enumerate() {
            // Every second triangle of a strip runs the other way round.
            let (b, c) = if i % 2 == 0 { (1, 2) } else { (2, 1) };
            let corners = [corners[0], corners[b], corners[c]];
            push_polygon(path, k, &corners, surface.nodes_mm.len(), &mut surface.triangles)?;
        }
    }
    Ok(surface)
}

impl<'a> Document<'a> {
    fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        // Raw appended bytes are not XML: the text ends with the tag that opens them.
        let mark = b"<AppendedData";
        let end = bytes.windows(mark.len()).position(|w| w == mark).unwrap_or(bytes.len());
        let (text, tail) = bytes.split_at(end);
        let text = std::str::from_utf8(text).map_err(|e| {
            Error::input(path, "XML", format!("bytes that are not UTF-8 at {}", e.valid_up_to()), "XML")
        })?;
        let mut document = Self {
            path,
            big_endian: false,
            header_width: 4,
            compressed: false,
            nodes: 0,
            arrays: Vec::new(),
            appended_raw: false,
            appended: &[],
        };
        document.read_appended(tail)?;
        document.read_elements(text)?;
        Ok(document)
    }

    fn read_appended(&mut self, tail: &'a [u8]) -> Result<()> {
        if tail.is_empty() {
            return Ok(());
        }
        let wrong =
            |found: &str| Error::input(self.path, "AppendedData", found, "encoding and, after a _, data");
        let close = tail.iter().position(|&b| b == b'>').ok_or_else(|| wrong("the end of the file"))?;
        let tag = String::from_utf8_lossy(&tail[..close]);
        self.appended_raw = match (tag.contains("raw"), tag.contains("base64")) {
            (true, false) => true,
            (false, true) => false,
            _ => return Err(wrong(&tag)),
        };
        let start = tail[close..].iter().position(|&b| b == b'_').ok_or_else(|| wrong("no _"))?;
        self.appended = &tail[close + start + 1..];
        Ok(())
    }

    fn read_elements(&mut self, text: &str) -> Result<()> {
        let path = self.path;
        let xml = |error: quick_xml::Error| Error::input(path, "XML", error, "well-formed XML");
        let mut reader = quick_xml::Reader::from_str(text);
        let mut open: Vec<String> = Vec::new();
        let mut pieces = 0;
        loop {
            let event = reader.read_event().map_err(xml)?;
            match &event {
                Event::Start(tag) | Event::Empty(tag) => {
                    let name = String::from_utf8_lossy(tag.name().as_ref().as_ref()).into_owned();
                    match name.as_str() {
                        "VTKFile" => self.read_file_tag(tag)?,
                        "Piece" => {
                            pieces += 1;
                            self.nodes = self.count(tag, "NumberOfPoints", 0)?;
                        }
                        "DataArray" => {
                            let parent = open.last().cloned().unwrap_or_default();
                            let array = self.data_array(tag, parent)?;
                            self.arrays.push(array);
                        }
                        _ => {}
                    }
                    if matches!(event, Event::Start(_)) {
                        open.push(name);
                    }
                }
                // VTK nests information keys in an array: only text right below the array is data.
                Event::Text(content) if open.last().is_some_and(|name| name == "DataArray") => {
                    if let Some(array) = self.arrays.last_mut() {
                        array.text.push_str(&content.xml_content(XmlVersion::Explicit1_0));
                    }
                }
                Event::End(_) => drop(open.pop()),
                Event::Eof => break,
                _ => {}
            }
        }
        // AppendedData lies within VTKFile and is cut off above.
        if open.iter().any(|name| name != "VTKFile") {
            return Err(Error::input(
                path,
                "XML",
                "the end of the file",
                format!("</{}>", open[open.len() - 1]),
            ));
        }
        match pieces {
            1 => Ok(()),
            _ => Err(Error::input(path, "Piece", format!("{pieces} pieces"), "one piece of PolyData")),
        }
    }

    fn attribute(&self, tag: &BytesStart, name: &str) -> Result<Option<String>> {
        let wrong = |error: &dyn std::fmt::Display| Error::input(self.path, name, error, "an XML attribute");
        match tag.try_get_attribute(name).map_err(|e| wrong(&e))? {
            Some(found) => {
                let value = found.normalized_value(XmlVersion::Explicit1_0).map_err(|e| wrong(&e))?;
                Ok(Some(value.into_owned()))
            }
            None => Ok(None),
        }
    }

    fn count(&self, tag: &BytesStart, name: &str, default: usize) -> Result<usize> {
        match self.attribute(tag, name)? {
            Some(text) => {
                text.trim().parse().map_err(|_| Error::input(self.path, name, text, "a whole number"))
            }
            None => Ok(default),
        }
    }

    fn read_file_tag(&mut self, tag: &BytesStart) -> Result<()> {
        let wrong =
            |name: &str, found: String, expected: &str| Err(Error::input(self.path, name, found, expected));
        match self.attribute(tag, "type")? {
            Some(kind) if kind == "PolyData" => {}
            kind => return wrong("VTKFile type", kind.unwrap_or_default(), "PolyData"),
        }
        let big_endian = match self.attribute(tag, "byte_order")?.as_deref() {
            Some("LittleEndian") | None => false,
            Some("BigEndian") => true,
            Some(other) => return wrong("byte_order", other.into(), "LittleEndian or BigEndian"),
        };
        let header_width = match self.attribute(tag, "header_type")?.as_deref() {
            Some("UInt32") | None => 4,
            Some("UInt64") => 8,
            Some(other) => return wrong("header_type", other.into(), "UInt32 or UInt64"),
        };
        let compressed = match self.attribute(tag, "compressor")?.as_deref() {
            Some("") | None => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => return wrong("compressor", other.into(), "none or vtkZLibDataCompressor"),
        };
        (self.big_endian, self.header_width, self.compressed) = (big_endian, header_width, compressed);
        Ok(())
    }

    fn data_array(&self, tag: &BytesStart, parent: String) -> Result<DataArray> {
        Ok(DataArray {
            parent,
            name: self.attribute(tag, "Name")?.unwrap_or_default(),
            number: self.attribute(tag, "type")?.unwrap_or_default(),
            components: self.count(tag, "NumberOfComponents", 1)?,
            format: self.attribute(tag, "format")?.unwrap_or_else(|| "ascii".into()),
            offset: self.count(tag, "offset", 0)?,
            text: String::new(),
        })
    }

    fn array(&self, parent: &str, name: Option<&str>) -> Result<&DataArray> {
        let wanted = |a: &&DataArray| a.parent == parent && name.is_none_or(|name| a.name == name);
        self.arrays.iter().find(wanted).ok_or_else(|| {
            Error::input(
                self.path,
                parent,
                "no such array",
                format!("a DataArray {}", name.unwrap_or_default()),
            )
        })
    }

    /// The node indices of each cell of `Polys` or `Strips`.
    fn cells(&self, parent: &str) -> Result<Vec<Vec<i64>>> {
        if !self.arrays.iter().any(|a| a.parent == parent) {
            return Ok(Vec::new());
        }
        let connectivity = self.integers(self.array(parent, Some("connectivity"))?)?;
        let offsets = self.integers(self.array(parent, Some("offsets"))?)?;
        let mut start = 0;
        let mut cells = Vec::with_capacity(offsets.len());
        for (k, &end) in offsets.iter().enumerate() {
            let cell =
                usize::try_from(end).ok().and_then(|end| connectivity.get(start..end)).ok_or_else(|| {
                    Error::input(
                        self.path,
                        format!("{parent} offset {k}"),
                        end,
                        format!("{start} to {}", connectivity.len()),
                    )
                })?;
            start += cell.len();
            cells.push(cell.to_vec());
        }
        Ok(cells)
    }

    fn integers(&self, array: &DataArray) -> Result<Vec<i64>> {
        // Whole numbers below 2^53 pass through f64 unchanged, and node indices are below 2^32.
        let whole = |x: f64| match x.fract() == 0.0 {
            true => Ok(x as i64),
            false => Err(Error::input(self.path, field(array), x, "whole numbers")),
        };
        self.numbers(array)?.into_iter().map(whole).collect()
    }

    fn numbers(&self, array: &DataArray) -> Result<Vec<f64>> {
        let text =
            |word: &str| word.parse().map_err(|_| Error::input(self.path, field(array), word, "a number"));
        let bytes = match array.format.as_str() {
            "ascii" => return array.text.split_ascii_whitespace().map(text).collect(),
            "binary" => {
                let inline: Vec<u8> = array.text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
                self.block(array, &inline, false)?
            }
            "appended" => {
                let data = self.appended.get(array.offset..).ok_or_else(|| {
                    let expected = format!("an offset up to {}", self.appended.len());
                    Error::input(self.path, field(array), format!("offset {}", array.offset), expected)
                })?;
                self.block(array, data, self.appended_raw)?
            }
            other => return Err(Error::input(self.path, field(array), other, "ascii, binary or appended")),
        };
        let big = self.big_endian;
        match array.number.as_str() {
            "Int8" => Ok(convert(&bytes, big, |b| i8::from_le_bytes(b).into())),
            "UInt8" => Ok(convert(&bytes, big, |b| u8::from_le_bytes(b).into())),
            "Int16" => Ok(convert(&bytes, big, |b| i16::from_le_bytes(b).into())),
            "UInt16" => Ok(convert(&bytes, big, |b| u16::from_le_bytes(b).into())),
            "Int32" => Ok(convert(&bytes, big, |b| i32::from_le_bytes(b).into())),
            "UInt32" => Ok(convert(&bytes, big, |b| u32::from_le_bytes(b).into())),
            "Int64" => Ok(convert(&bytes, big, |b| i64::from_le_bytes(b) as f64)),
            "UInt64" => Ok(convert(&bytes, big, |b| u64::from_le_bytes(b) as f64)),
            "Float32" => Ok(convert(&bytes, big, |b| f32::from_le_bytes(b).into())),
            "Float64" => Ok(convert(&bytes, big, f64::from_le_bytes)),
            other => Err(Error::input(self.path, field(array), format!("type {other:?}"), "Int8 to Float64")),
        }
    }

    /// The content of the block that starts `data`.
    ///
    /// Plain: one number, the bytes to follow. Compressed: number of blocks, size of a block, size of the last one
    /// where it is smaller, and each block's compressed size; then the blocks.
    fn block(&self, array: &DataArray, data: &[u8], raw: bool) -> Result<Vec<u8>> {
        let short =
            || Error::input(self.path, field(array), "a block cut short or malformed", "a whole block");
        let width = self.header_width;
        let plain = |from: usize, bytes: usize| -> Result<Vec<u8>> {
            let range = data.get(from..).and_then(|d| d.get(..bytes)).ok_or_else(short)?;
            Ok(range.to_vec())
        };
        let decoded = |from: usize, bytes: usize| -> Result<Vec<u8>> {
            let text = data.get(from..).and_then(|d| d.get(..base64_length(bytes)?)).ok_or_else(short)?;
            let mut out = STANDARD.decode(text).map_err(|_| short())?;
            out.truncate(bytes);
            Ok(out)
        };
        let head =
            |bytes: usize| if raw { plain(0, bytes) } else { decoded_head(data, bytes).ok_or_else(short) };
        let header_number = |bytes: &[u8], k: usize| -> Result<usize> {
            let word = bytes.get(k * width..(k + 1) * width).ok_or_else(short)?;
            let fold = |n: u64, b: &u8| n << 8 | u64::from(*b);
            let number =
                if self.big_endian { word.iter().fold(0, fold) } else { word.iter().rev().fold(0, fold) };
            usize::try_from(number).map_err(|_| short())
        };
        if !self.compressed {
            let bytes = header_number(&head(width)?, 0)?;
            if raw {
                return plain(width, bytes);
            }
            // VTK encodes header and content as one; some writers encode them one after the other.
            let apart = base64_length(width).ok_or_else(short)?;
            if data.get(apart - 1) == Some(&b'=') {
                return decoded(apart, bytes);
            }
            return Ok(decoded(0, width.checked_add(bytes).ok_or_else(short)?)?.split_off(width));
        }
        let blocks = header_number(&head(width)?, 0)?;
        if blocks == 0 {
            return Ok(Vec::new());
        }
        let header_bytes = blocks.checked_add(3).and_then(|n| n.checked_mul(width)).ok_or_else(short)?;
        let header = head(header_bytes)?;
        let [full, last] = [header_number(&header, 1)?, header_number(&header, 2)?];
        let sizes: Vec<usize> = (0..blocks).map(|k| header_number(&header, 3 + k)).collect::<Result<_>>()?;
        let total = sizes.iter().try_fold(0usize, |sum, &n| sum.checked_add(n)).ok_or_else(short)?;
        let packed = if raw {
            plain(header_bytes, total)?
        } else {
            decoded(base64_length(header_bytes).ok_or_else(short)?, total)?
        };
        let mut rest = packed.as_slice();
        let mut content = Vec::new();
        for (k, &size) in sizes.iter().enumerate() {
            let (block, after) = rest.split_at_checked(size).ok_or_else(short)?;
            rest = after;
            let expected = if k + 1 == blocks && last > 0 { last } else { full };
            if expected as u64 > LARGEST_DEFLATE_RATIO * (size as u64 + 1) {
                return Err(short());
            }
            let before = content.len();
            let mut inflated = flate2::read::ZlibDecoder::new(block).take(expected as u64);
            inflated.read_to_end(&mut content).map_err(|_| short())?;
            if content.len() - before != expected {
                return Err(short());
            }
        }
        Ok(content)
    }
}

fn field(array: &DataArray) -> String {
    format!("{} {}", array.parent, array.name)
}

/// Characters of base64 for so many bytes.
fn base64_length(bytes: usize) -> Option<usize> {
    bytes.div_ceil(3).checked_mul(4)
}

/// The first bytes of a base64 text, whatever follows them.
fn decoded_head(text: &[u8], bytes: usize) -> Option<Vec<u8>> {
    let mut out = STANDARD.decode(text.get(..base64_length(bytes)?)?).ok()?;
    out.truncate(bytes);
    (out.len() == bytes).then_some(out)
}

fn convert<const N: usize>(bytes: &[u8], big_endian: bool, number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    let number = |b: &[u8; N]| {
        let mut b = *b;
        if big_endian {
            b.reverse();
        }
        number(b)
    };
    bytes.as_chunks::<N>().0.iter().map(number).collect()
}

/// Float64 throughout, so that nothing is lost.
pub(in crate::surface) fn write(surface: &Surface, w: &mut dyn Write) -> std::io::Result<()> {
    let (nodes, triangles) = (surface.nodes_mm.len(), surface.triangles.len());
    writeln!(w, "<?xml version=\"1.0\"?>")?;
    writeln!(
        w,
        "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<PolyData>"
    )?;
    writeln!(
        w,
        "<Piece NumberOfPoints=\"{nodes}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"{triangles}\">"
    )?;
    writeln!(w, "<PointData>")?;
    for array in &surface.arrays {
        write_array(w, "Float64", &array.name, 1, array.values.iter().map(|x| x.to_le_bytes()))?;
    }
    writeln!(w, "</PointData>\n<Points>")?;
    let coordinates = surface.nodes_mm.iter().flat_map(|p| p.to_array());
    write_array(w, "Float64", "Points", 3, coordinates.map(f64::to_le_bytes))?;
    writeln!(w, "</Points>\n<Polys>")?;
    let corners = surface.triangles.iter().flatten();
    write_array(w, "Int64", "connectivity", 1, corners.map(|&n| i64::from(n).to_le_bytes()))?;
    write_array(w, "Int64", "offsets", 1, (1..=triangles as i64).map(|k| (3 * k).to_le_bytes()))?;
    writeln!(w, "</Polys>\n</Piece>\n</PolyData>\n</VTKFile>")
}

fn write_array(
    w: &mut dyn Write,
    number: &str,
    name: &str,
    components: usize,
    values: impl Iterator<Item = [u8; 8]>,
) -> std::io::Result<()> {
    let mut block = vec![0; 8];
    values.for_each(|value| block.extend(value));
    let bytes = (block.len() - 8) as u64;
    block[..8].copy_from_slice(&bytes.to_le_bytes());
    let name = quick_xml::escape::escape(name);
    writeln!(
        w,
        "<DataArray type=\"{number}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"binary\">\n{}\n</DataArray>",
        STANDARD.encode(block)
    )
}
