//! VTK XML PolyData, which ParaView and VMTK open: written as inline base64, read in all of VTK's own encodings (text,
//! base64, appended base64 or raw; plain or compressed with zlib, LZ4 or LZMA; 32- or 64-bit block headers; either byte
//! order; one piece or several). UnstructuredGrid (.vtu) is read where its cells are those of a surface.
//!
//! Layout: <https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html>

use super::cells::{Contents, require_triangles};
use super::number::Number;
use super::text;
use crate::surface::{NodeArray, Space, Surface};
use crate::text::decoded;
use crate::{Error, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::cell::Cell;
use std::io::{Read as _, Write};
use std::path::Path;
use xz4rust::{XzDecoder, XzNextBlockResult};

/// All numbers of a file may take so many times its size in memory: a compressor can make much of little, but a mesh has
/// positions, which hardly shrink, beside arrays that may be one number throughout.
const LARGEST_EXPANSION: usize = 200;
/// So many bytes may be taken even by the smallest file.
const SMALLEST_LIMIT: usize = 64 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compressor {
    Zlib,
    Lz4,
    Lzma,
}

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

/// A `Piece`: a part of the surface with nodes of its own.
struct Piece {
    nodes: usize,
    /// Its number of cells by their element: `Polys`, `Strips`, `Lines`, `Verts`, `Cells`; none where it says none.
    cells: Vec<(&'static str, usize)>,
    arrays: Vec<DataArray>,
}

struct Document<'a> {
    path: &'a Path,
    big_endian: bool,
    /// Bytes of one number in the headers of binary blocks: 4 or 8.
    header_width: usize,
    compressor: Option<Compressor>,
    pieces: Vec<Piece>,
    /// The field `SPACE` of the whole file.
    space: Option<DataArray>,
    appended_raw: bool,
    /// What follows the `_` of `AppendedData`.
    appended: &'a [u8],
    /// The most that its numbers may take in memory, in bytes, and what they have taken so far.
    limit: usize,
    taken: Cell<usize>,
}

pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<(Surface, Option<Space>)> {
    let document = Document::parse(path, bytes)?;
    let mut surface = Surface::default();
    let (mut lines, mut points) = (0, 0);
    for piece in &document.pieces {
        let contents = document.contents(piece)?;
        lines += contents.lines;
        points += contents.points;
        append(&mut surface, contents.triangulate(path)?, path)?;
    }
    let instead = [("lines", lines), ("points", points), ("pieces", document.pieces.len())];
    Ok((require_triangles(surface, path, &instead)?, document.space()?))
}

/// Appends a piece. An array that some pieces lack has no value, NaN, at their nodes.
fn append(surface: &mut Surface, piece: Surface, path: &Path) -> Result<()> {
    let before = surface.nodes_mm.len();
    surface.nodes_mm.extend(piece.nodes_mm);
    let offset = u32::try_from(before)
        .ok()
        .filter(|_| u32::try_from(surface.nodes_mm.len()).is_ok())
        .ok_or_else(|| Error::input(path, "nodes", "more than 2^32", "fewer than 2^32"))?;
    surface.triangles.extend(piece.triangles.into_iter().map(|t| t.map(|node| node + offset)));
    for array in piece.arrays {
        match surface.arrays.iter_mut().find(|a| a.name == array.name) {
            Some(whole) => whole.values.extend(array.values),
            None => {
                let mut values = vec![f64::NAN; before];
                values.extend(array.values);
                surface.arrays.push(NodeArray { name: array.name, values });
            }
        }
    }
    surface.arrays.iter_mut().for_each(|a| a.values.resize(surface.nodes_mm.len(), f64::NAN));
    Ok(())
}

impl<'a> Document<'a> {
    fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        // Raw appended bytes are not XML: the text ends with the tag that opens them.
        let mark = b"<AppendedData";
        let end = bytes.windows(mark.len()).position(|w| w == mark).unwrap_or(bytes.len());
        let (text, tail) = bytes.split_at(end);
        let mut document = Self {
            path,
            big_endian: false,
            header_width: 4,
            compressor: None,
            pieces: Vec::new(),
            space: None,
            appended_raw: false,
            appended: &[],
            limit: bytes.len().saturating_mul(LARGEST_EXPANSION).max(SMALLEST_LIMIT),
            taken: Cell::new(0),
        };
        document.read_appended(tail)?;
        document.read_elements(&decoded(text))?;
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
        let mut is_space = false;
        loop {
            let event = reader.read_event().map_err(xml)?;
            match &event {
                Event::Start(tag) | Event::Empty(tag) => {
                    let name = String::from_utf8_lossy(tag.name().as_ref().as_ref()).into_owned();
                    match name.as_str() {
                        "VTKFile" => self.read_file_tag(tag)?,
                        "Piece" => {
                            let piece = self.piece(tag)?;
                            self.pieces.push(piece);
                        }
                        // VTK's name of an array of texts, and of no other that is used here.
                        "DataArray" | "Array" => {
                            let parent = open.last().cloned().unwrap_or_default();
                            let array = self.data_array(tag, parent)?;
                            // Before the first piece are those of the whole file, such as its time.
                            is_space = array.parent == "FieldData" && array.name == "SPACE";
                            match self.pieces.last_mut() {
                                _ if is_space => self.space = Some(array),
                                Some(piece) if name == "DataArray" => piece.arrays.push(array),
                                _ => {}
                            }
                        }
                        _ => {}
                    }
                    if matches!(event, Event::Start(_)) {
                        open.push(name);
                    }
                }
                // VTK nests information keys in an array: only text right below the array is data.
                Event::Text(content)
                    if open
                        .last()
                        .is_some_and(|name| name == "DataArray" || (is_space && name == "Array")) =>
                {
                    let array = match is_space {
                        true => self.space.as_mut(),
                        false => self.pieces.last_mut().and_then(|p| p.arrays.last_mut()),
                    };
                    if let Some(array) = array {
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
        if self.pieces.is_empty() {
            return Err(Error::input(path, "Piece", "none", "at least one"));
        }
        Ok(())
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

    fn count(&self, tag: &BytesStart, name: &str) -> Result<Option<usize>> {
        let number = |text: String| {
            text.trim().parse().map_err(|_| Error::input(self.path, name, text, "a whole number"))
        };
        self.attribute(tag, name)?.map(number).transpose()
    }

    fn read_file_tag(&mut self, tag: &BytesStart) -> Result<()> {
        let wrong =
            |name: &str, found: String, expected: &str| Err(Error::input(self.path, name, found, expected));
        match self.attribute(tag, "type")? {
            Some(kind) if kind == "PolyData" || kind == "UnstructuredGrid" => {}
            kind => {
                return wrong("VTKFile type", kind.unwrap_or_default(), "PolyData or UnstructuredGrid");
            }
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
        let compressor = match self.attribute(tag, "compressor")?.as_deref() {
            Some("") | None => None,
            Some("vtkZLibDataCompressor") => Some(Compressor::Zlib),
            Some("vtkLZ4DataCompressor") => Some(Compressor::Lz4),
            Some("vtkLZMADataCompressor") => Some(Compressor::Lzma),
            Some(other) => {
                let expected = "none, vtkZLibDataCompressor, vtkLZ4DataCompressor or vtkLZMADataCompressor";
                return wrong("compressor", other.into(), expected);
            }
        };
        (self.big_endian, self.header_width, self.compressor) = (big_endian, header_width, compressor);
        Ok(())
    }

    fn piece(&self, tag: &BytesStart) -> Result<Piece> {
        let mut cells = Vec::new();
        for (parent, name) in [
            ("Polys", "NumberOfPolys"),
            ("Strips", "NumberOfStrips"),
            ("Lines", "NumberOfLines"),
            ("Verts", "NumberOfVerts"),
            ("Cells", "NumberOfCells"),
        ] {
            cells.extend(self.count(tag, name)?.map(|count| (parent, count)));
        }
        let nodes = self.count(tag, "NumberOfPoints")?.unwrap_or(0);
        Ok(Piece { nodes, cells, arrays: Vec::new() })
    }

    fn data_array(&self, tag: &BytesStart, parent: String) -> Result<DataArray> {
        Ok(DataArray {
            parent,
            name: self.attribute(tag, "Name")?.unwrap_or_default(),
            number: self.attribute(tag, "type")?.unwrap_or_default(),
            components: self.count(tag, "NumberOfComponents")?.unwrap_or(1),
            format: self.attribute(tag, "format")?.unwrap_or_else(|| "ascii".into()),
            offset: self.count(tag, "offset")?.unwrap_or(0),
            text: String::new(),
        })
    }

    /// The space that the file names: text, whose characters are numbers that end with zero.
    fn space(&self) -> Result<Option<Space>> {
        let Some(array) = self.space.as_ref().filter(|array| array.number == "String") else {
            return Ok(None);
        };
        let characters = self.numbers_of_type(array, Number::U8)?;
        let name: String =
            characters.iter().take_while(|&&c| c != 0.0).map(|&c| char::from(c as u8)).collect();
        match Space::named(&name) {
            Some(space) => Ok(Some(space)),
            None => Err(Error::input(self.path, "SPACE", format!("{name:?}"), "RAS or LPS")),
        }
    }

    fn contents(&self, piece: &Piece) -> Result<Contents> {
        let mut contents = Contents { nodes_mm: self.nodes(piece)?, ..Contents::default() };
        for array in piece.arrays.iter().filter(|a| a.parent == "PointData" && a.components == 1) {
            let is_new = contents.arrays.iter().all(|a| a.name != array.name);
            // What cannot be an array here, such as text or bits, is nobody's loss.
            if number_of_type(&array.number).is_none() || array.name.trim().is_empty() || !is_new {
                continue;
            }
            let values = self.numbers(array)?;
            if values.len() != piece.nodes {
                let found = format!("{} values", values.len());
                return Err(Error::input(
                    self.path,
                    format!("node array {:?}", array.name),
                    found,
                    piece.nodes,
                ));
            }
            contents.arrays.push(NodeArray { name: array.name.clone(), values });
        }
        self.cells(piece, "Polys", |_, cell| {
            contents.polygons.push(cell.iter().copied());
            Ok(())
        })?;
        self.cells(piece, "Strips", |_, cell| {
            contents.strips.push(cell.iter().copied());
            Ok(())
        })?;
        let named = |parent| piece.cells.iter().find(|c| c.0 == parent).map_or(0, |c| c.1);
        (contents.lines, contents.points) = (named("Lines"), named("Verts"));
        if piece.arrays.iter().any(|a| a.parent == "Cells" && a.name == "types") {
            let types = self.integers(piece.array(self.path, "Cells", Some("types"))?)?;
            self.cells(piece, "Cells", |k, cell| {
                let kind = types.get(k).copied().unwrap_or(-1);
                contents.push_of_vtk_type(self.path, k, kind, cell)
            })?;
        }
        Ok(contents)
    }

    fn nodes(&self, piece: &Piece) -> Result<Vec<DVec3>> {
        if piece.nodes == 0 {
            return Ok(Vec::new());
        }
        let points = piece.array(self.path, "Points", None)?;
        if points.components != 3 {
            return Err(Error::input(self.path, "Points", format!("{} components", points.components), "3"));
        }
        let coordinates = self.numbers(points)?;
        if coordinates.len() != piece.nodes.saturating_mul(3) {
            let found = format!("{} coordinates", coordinates.len());
            let expected = format!("3 for each of {} points", piece.nodes);
            return Err(Error::input(self.path, "Points", found, expected));
        }
        Ok(coordinates.as_chunks::<3>().0.iter().copied().map(DVec3::from_array).collect())
    }

    /// Hands over each cell of `Polys`, `Strips` or `Cells` by its number and its nodes.
    fn cells(
        &self,
        piece: &Piece,
        parent: &str,
        mut push: impl FnMut(usize, &[i64]) -> Result<()>,
    ) -> Result<()> {
        let promised = piece.cells.iter().find(|c| c.0 == parent).map(|c| c.1);
        if promised.unwrap_or(0) == 0 && !piece.arrays.iter().any(|a| a.parent == parent) {
            return Ok(());
        }
        let connectivity = self.integers(piece.array(self.path, parent, Some("connectivity"))?)?;
        let offsets = self.integers(piece.array(self.path, parent, Some("offsets"))?)?;
        let wrong = |what: String, found: String, expected: String| {
            Err(Error::input(self.path, format!("{parent} {what}"), found, expected))
        };
        if promised.is_some_and(|count| count != offsets.len()) {
            let expected = promised.unwrap_or(0).to_string();
            return wrong("offsets".into(), offsets.len().to_string(), expected);
        }
        let mut start = 0;
        for (k, &end) in offsets.iter().enumerate() {
            let Some(cell) = usize::try_from(end).ok().and_then(|end| connectivity.get(start..end)) else {
                let expected = format!("{start} to {}", connectivity.len());
                return wrong(format!("offset {k}"), end.to_string(), expected);
            };
            start += cell.len();
            push(k, cell)?;
        }
        if start != connectivity.len() {
            let expected = format!("{start}, where the last cell ends");
            return wrong("connectivity".into(), connectivity.len().to_string(), expected);
        }
        Ok(())
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
        let number = number_of_type(&array.number).ok_or_else(|| {
            Error::input(self.path, field(array), format!("type {:?}", array.number), "Int8 to Float64")
        })?;
        self.numbers_of_type(array, number)
    }

    fn numbers_of_type(&self, array: &DataArray, number: Number) -> Result<Vec<f64>> {
        let bytes = match array.format.as_str() {
            "ascii" => return self.numbers_of_text(array),
            "binary" => {
                let inline: Vec<u8> = array.text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
                self.block(array, number, &inline, false)?
            }
            "appended" => {
                let data = self.appended.get(array.offset..).ok_or_else(|| {
                    let expected = format!("an offset up to {}", self.appended.len());
                    Error::input(self.path, field(array), format!("offset {}", array.offset), expected)
                })?;
                self.block(array, number, data, self.appended_raw)?
            }
            other => return Err(Error::input(self.path, field(array), other, "ascii, binary or appended")),
        };
        Ok(number.read_all(&bytes, self.big_endian))
    }

    fn numbers_of_text(&self, array: &DataArray) -> Result<Vec<f64>> {
        let number = |word: &str| {
            text::number(word).ok_or_else(|| Error::input(self.path, field(array), word, "a number"))
        };
        array.text.split_ascii_whitespace().map(number).collect()
    }

    /// Counts the bytes of a block before they are taken, as the numbers of eight bytes that they become.
    fn take(&self, array: &DataArray, number: Number, bytes: usize) -> Result<()> {
        let taken = self.taken.get().saturating_add(bytes.saturating_mul(8 / number.size()));
        if taken > self.limit {
            let found = format!("arrays of {taken} bytes or more in memory");
            let expected =
                format!("at most {}: {LARGEST_EXPANSION} times the file's size, or 64 MB", self.limit);
            return Err(Error::input(self.path, field(array), found, expected));
        }
        self.taken.set(taken);
        Ok(())
    }

    /// The content of the block that starts `data`.
    ///
    /// Plain: one number, the bytes to follow. Compressed: number of blocks, size of a block, size of the last one
    /// where it is smaller, and each block's compressed size; then the blocks.
    fn block(&self, array: &DataArray, number: Number, data: &[u8], raw: bool) -> Result<Vec<u8>> {
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
        let Some(compressor) = self.compressor else {
            let bytes = header_number(&head(width)?, 0)?;
            if bytes > data.len() {
                return Err(short());
            }
            self.take(array, number, bytes)?;
            if raw {
                return plain(width, bytes);
            }
            // VTK encodes header and content as one; some writers encode them one after the other.
            let apart = base64_length(width).ok_or_else(short)?;
            if data.get(apart - 1) == Some(&b'=') {
                return decoded(apart, bytes);
            }
            return Ok(decoded(0, width.checked_add(bytes).ok_or_else(short)?)?.split_off(width));
        };
        let blocks = header_number(&head(width)?, 0)?;
        if blocks == 0 {
            return Ok(Vec::new());
        }
        let header_bytes = blocks.checked_add(3).and_then(|n| n.checked_mul(width)).ok_or_else(short)?;
        let header = head(header_bytes)?;
        let [full, last] = [header_number(&header, 1)?, header_number(&header, 2)?];
        let last = if last > 0 { last } else { full };
        self.take(array, number, full.saturating_mul(blocks - 1).saturating_add(last))?;
        let sizes: Vec<usize> = (0..blocks).map(|k| header_number(&header, 3 + k)).collect::<Result<_>>()?;
        let total = sizes.iter().try_fold(0usize, |sum, &n| sum.checked_add(n)).ok_or_else(short)?;
        let packed = if raw {
            plain(header_bytes, total)?
        } else {
            decoded(base64_length(header_bytes).ok_or_else(short)?, total)?
        };
        let mut rest = packed.as_slice();
        let mut content = Vec::new();
        let mut xz = XzDecoder::default();
        for (k, &size) in sizes.iter().enumerate() {
            let (block, after) = rest.split_at_checked(size).ok_or_else(short)?;
            rest = after;
            let length = if k + 1 == blocks { last } else { full };
            compressor.expand(block, length, &mut content, &mut xz).ok_or_else(short)?;
        }
        Ok(content)
    }
}

impl Piece {
    fn array(&self, path: &Path, parent: &str, name: Option<&str>) -> Result<&DataArray> {
        let wanted = |a: &&DataArray| a.parent == parent && name.is_none_or(|name| a.name == name);
        self.arrays.iter().find(wanted).ok_or_else(|| {
            Error::input(path, parent, "no such array", format!("a DataArray {}", name.unwrap_or_default()))
        })
    }
}

impl Compressor {
    /// Appends a block's content, which must be that long.
    fn expand(self, block: &[u8], length: usize, content: &mut Vec<u8>, xz: &mut XzDecoder) -> Option<()> {
        let before = content.len();
        match self {
            Self::Zlib => {
                let mut inflated = flate2::read::ZlibDecoder::new(block).take(length as u64);
                inflated.read_to_end(content).ok()?;
            }
            Self::Lz4 => {
                content.resize(before + length, 0);
                let written = lz4_flex::block::decompress_into(block, &mut content[before..]).ok()?;
                content.truncate(before + written);
            }
            Self::Lzma => {
                content.resize(before + length, 0);
                let written = expand_xz(block, &mut content[before..], xz)?;
                content.truncate(before + written);
            }
        }
        (content.len() - before == length).then_some(())
    }
}

/// LZMA blocks are .xz streams. How many bytes were written. The decoder's dictionary takes up to 64 MB, as much as that of
/// the strongest preset.
fn expand_xz(mut block: &[u8], content: &mut [u8], decoder: &mut XzDecoder) -> Option<usize> {
    decoder.reset();
    let mut written = 0;
    loop {
        match decoder.decode(block, &mut content[written..]).ok()? {
            XzNextBlockResult::EndOfStream(_, out) => return Some(written + out),
            XzNextBlockResult::NeedMoreData(0, 0) => return None,
            XzNextBlockResult::NeedMoreData(read, out) => {
                block = block.get(read..)?;
                written += out;
            }
        }
    }
}

fn number_of_type(name: &str) -> Option<Number> {
    Some(match name {
        "Int8" => Number::I8,
        "UInt8" => Number::U8,
        "Int16" => Number::I16,
        "UInt16" => Number::U16,
        "Int32" => Number::I32,
        "UInt32" => Number::U32,
        "Int64" => Number::I64,
        "UInt64" => Number::U64,
        "Float32" => Number::F32,
        "Float64" => Number::F64,
        _ => return None,
    })
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

/// What a file of VTK's PolyData can hold beside a [`Surface`]: lines, arrays of vectors, and numbers of triangles.
#[derive(Default)]
pub(crate) struct PolyData<'a> {
    pub nodes_mm: &'a [DVec3],
    pub triangles: &'a [[u32; 3]],
    /// Polylines, as nodes.
    pub lines: &'a [Vec<u32>],
    /// Name, numbers per node, and numbers.
    pub node_arrays: Vec<(&'a str, usize, &'a [f64])>,
    /// Name and a whole number for each line and then for each triangle.
    pub cell_arrays: Vec<(&'a str, &'a [i32])>,
}

pub(in crate::surface) fn write(surface: &Surface, space: Space, w: &mut dyn Write) -> std::io::Result<()> {
    let Surface { nodes_mm, triangles, arrays } = surface;
    let node_arrays = arrays.iter().map(|a| (a.name.as_str(), 1, a.values.as_slice())).collect();
    PolyData { nodes_mm, triangles, node_arrays, ..PolyData::default() }.write(space, w)
}

impl PolyData<'_> {
    /// Writes nodes that are in a space. Float64 throughout, so that nothing is lost.
    pub(crate) fn write(&self, space: Space, w: &mut dyn Write) -> std::io::Result<()> {
        let (nodes, triangles, lines) = (self.nodes_mm.len(), self.triangles.len(), self.lines.len());
        writeln!(w, "<?xml version=\"1.0\"?>")?;
        writeln!(
            w,
            "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<PolyData>"
        )?;
        let characters: Vec<String> = space.name().bytes().chain([0]).map(|c| c.to_string()).collect();
        writeln!(
            w,
            "<FieldData>\n<Array type=\"String\" Name=\"SPACE\" NumberOfTuples=\"1\" format=\"ascii\">\n{}\n</Array>\n\
             </FieldData>",
            characters.join(" ")
        )?;
        writeln!(
            w,
            "<Piece NumberOfPoints=\"{nodes}\" NumberOfVerts=\"0\" NumberOfLines=\"{lines}\" NumberOfStrips=\"0\" \
             NumberOfPolys=\"{triangles}\">"
        )?;
        writeln!(w, "<PointData>")?;
        for (name, components, values) in &self.node_arrays {
            write_array(w, "Float64", name, *components, values.iter().map(|x| x.to_le_bytes()))?;
        }
        writeln!(w, "</PointData>")?;
        if !self.cell_arrays.is_empty() {
            writeln!(w, "<CellData>")?;
            for (name, values) in &self.cell_arrays {
                write_array(w, "Int32", name, 1, values.iter().map(|x| x.to_le_bytes()))?;
            }
            writeln!(w, "</CellData>")?;
        }
        writeln!(w, "<Points>")?;
        let coordinates = self.nodes_mm.iter().flat_map(|p| p.to_array());
        write_array(w, "Float64", "Points", 3, coordinates.map(f64::to_le_bytes))?;
        writeln!(w, "</Points>")?;
        if lines > 0 {
            writeln!(w, "<Lines>")?;
            let ends = self.lines.iter().scan(0, |end, line| {
                *end += line.len() as i64;
                Some(*end)
            });
            let nodes = self.lines.iter().flatten().map(|&n| i64::from(n).to_le_bytes());
            write_array(w, "Int64", "connectivity", 1, nodes)?;
            write_array(w, "Int64", "offsets", 1, ends.map(i64::to_le_bytes))?;
            writeln!(w, "</Lines>")?;
        }
        writeln!(w, "<Polys>")?;
        let corners = self.triangles.iter().flatten();
        write_array(w, "Int64", "connectivity", 1, corners.map(|&n| i64::from(n).to_le_bytes()))?;
        write_array(w, "Int64", "offsets", 1, (1..=triangles as i64).map(|k| (3 * k).to_le_bytes()))?;
        writeln!(w, "</Polys>\n</Piece>\n</PolyData>\n</VTKFile>")
    }
}

/// The polylines of a file, mm in [`Space::Ras`].
pub(in crate::surface) fn parse_lines(path: &Path, bytes: &[u8]) -> Result<Vec<Vec<DVec3>>> {
    let document = Document::parse(path, bytes)?;
    let space = document.space()?.unwrap_or_default();
    let mut lines = Vec::new();
    for piece in &document.pieces {
        let nodes_mm = document.nodes(piece)?;
        document.cells(piece, "Lines", |_, cell| {
            let point = |&node: &i64| {
                let known = usize::try_from(node).ok().and_then(|node| nodes_mm.get(node));
                let p = known
                    .ok_or_else(|| Error::input(path, "Lines", format!("point {node}"), nodes_mm.len()))?;
                match p.is_finite() {
                    true => Ok(space.swapped(*p)),
                    false => Err(Error::input(path, format!("point {node}"), p, "finite coordinates")),
                }
            };
            lines.push(cell.iter().map(point).collect::<Result<Vec<_>>>()?);
            Ok(())
        })?;
    }
    if lines.iter().all(|line| line.len() < 2) {
        return Err(Error::input(path, "Lines", "none", "at least one polyline of two points"));
    }
    Ok(lines)
}

fn write_array<const SIZE: usize>(
    w: &mut dyn Write,
    number: &str,
    name: &str,
    components: usize,
    values: impl Iterator<Item = [u8; SIZE]>,
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
