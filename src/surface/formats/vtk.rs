//! VTK's legacy format, as text and binary (big endian): POLYDATA, and UNSTRUCTURED_GRID where its cells are those of a
//! surface. Cells come as lists (versions up to 4.2) or as offsets and nodes (5.0 and later). Only read.
//!
//! Layout: <https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html>

use super::cells::{Cells, Contents, require_triangles};
use super::number::Number;
use super::text::{self, HeaderLines};
use crate::surface::{NodeArray, Space, Surface};
use crate::{Error, Result};
use glam::DVec3;
use std::path::Path;

/// What follows the header, read word by word. A binary block begins after the line of the words that describe it.
struct Body<'a> {
    path: &'a Path,
    rest: &'a [u8],
    is_text: bool,
    /// As the title says.
    space: Option<Space>,
}

pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<(Surface, Option<Space>)> {
    let mut body = Body::new(path, bytes)?;
    let mut contents = Contents::default();
    // How many values the attributes that follow have, and whether they are of nodes.
    let mut attributes = (0, false);
    let mut cells = Cells::default();
    let mut types = Vec::new();
    while let Some(keyword) = body.next_word() {
        match keyword.to_ascii_uppercase().as_str() {
            "POINTS" => contents.nodes_mm = body.points()?,
            "POLYGONS" => body.cells("POLYGONS", &mut contents.polygons)?,
            "TRIANGLE_STRIPS" => body.cells("TRIANGLE_STRIPS", &mut contents.strips)?,
            "LINES" => {
                let mut lines = Cells::default();
                body.cells("LINES", &mut lines)?;
                contents.lines = lines.iter().count();
            }
            "VERTICES" => {
                let mut points = Cells::default();
                body.cells("VERTICES", &mut points)?;
                contents.points = points.iter().count();
            }
            "CELLS" => body.cells("CELLS", &mut cells)?,
            "CELL_TYPES" => {
                let count = body.count("CELL_TYPES")?;
                types = body.integers("CELL_TYPES", count, Number::I32)?;
            }
            "POINT_DATA" => attributes = (body.count("POINT_DATA")?, true),
            "CELL_DATA" => attributes = (body.count("CELL_DATA")?, false),
            "METADATA" => body.skip_metadata(),
            keyword => {
                let arrays = body.attribute(keyword, attributes.0)?;
                if attributes.1 {
                    keep(&mut contents, arrays);
                }
            }
        }
    }
    for (k, cell) in cells.iter().enumerate() {
        contents.push_of_vtk_type(path, k, types.get(k).copied().unwrap_or(-1), cell)?;
    }
    let instead = [("lines", contents.lines), ("points", contents.points)];
    Ok((require_triangles(contents.triangulate(path)?, path, &instead)?, body.space))
}

/// Keeps the first array of each name.
fn keep(contents: &mut Contents, arrays: Vec<NodeArray>) {
    for array in arrays {
        if !array.name.trim().is_empty() && contents.arrays.iter().all(|a| a.name != array.name) {
            contents.arrays.push(array);
        }
    }
}

impl<'a> Body<'a> {
    /// Reads the header: the version, a title, the encoding and the kind of data set.
    fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let mut lines = HeaderLines::new(bytes);
        let mut next = |field: &str, expected: &str, is_right: &dyn Fn(&str) -> bool| {
            let line = lines.next().unwrap_or("the end of the file".into());
            match is_right(&line) {
                true => Ok(line.to_ascii_uppercase()),
                false => Err(Error::input(path, field, line, expected)),
            }
        };
        let begins = |line: &str| line.to_ascii_lowercase().starts_with("# vtk datafile version");
        next("line 1", "# vtk DataFile Version", &begins)?;
        let space = Space::marked(&next("line 2", "a title", &|_| true)?);
        let encodings = ["ASCII", "BINARY"];
        let encoding = next("line 3", "ASCII or BINARY", &|line| {
            encodings.iter().any(|name| line.eq_ignore_ascii_case(name))
        })?;
        let mut body = Self { path, rest: lines.rest, is_text: encoding == encodings[0], space };
        let [keyword, kind] = [(); 2].map(|()| body.next_word().unwrap_or_default().to_ascii_uppercase());
        if keyword != "DATASET" || !["POLYDATA", "UNSTRUCTURED_GRID"].contains(&kind.as_str()) {
            let expected = "DATASET POLYDATA or DATASET UNSTRUCTURED_GRID";
            return Err(Error::input(path, "data set", format!("{keyword} {kind}"), expected));
        }
        Ok(body)
    }

    fn next_word(&mut self) -> Option<String> {
        let rest = self.rest.trim_ascii_start();
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(end);
        self.rest = rest;
        (!word.is_empty()).then(|| String::from_utf8_lossy(word).into_owned())
    }

    /// The next word, without taking it.
    fn peek(&self) -> Option<String> {
        Body { path: self.path, rest: self.rest, is_text: self.is_text, space: None }.next_word()
    }

    /// What is left of the line, and goes on to the next.
    fn rest_of_line(&mut self) -> String {
        let end = self.rest.iter().position(|&b| b == b'\n' || (b == b'\r' && self.is_text));
        let (line, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        let breaks: [&[u8]; 3] = [b"\r\n", b"\n", b"\r"];
        self.rest = breaks.iter().find_map(|b| rest.strip_prefix(*b)).unwrap_or(rest);
        String::from_utf8_lossy(line.trim_ascii()).into_owned()
    }

    fn word(&mut self, field: &str, expected: &str) -> Result<String> {
        self.next_word().ok_or_else(|| Error::input(self.path, field, "the end of the file", expected))
    }

    fn count(&mut self, field: &str) -> Result<usize> {
        let word = self.word(field, "a count")?;
        word.parse().map_err(|_| Error::input(self.path, field, word, "a count"))
    }

    /// A type of numbers: not text, bits or variants.
    fn number(&mut self, field: &str) -> Result<Number> {
        let word = self.word(field, "a type")?;
        number_of_type(&word)
            .ok_or_else(|| Error::input(self.path, field, word, "a type of numbers, such as float"))
    }

    /// So many numbers: words of a text, or a binary block after the end of this line.
    fn numbers(&mut self, field: &str, count: usize, number: Number) -> Result<Vec<f64>> {
        let bytes = self.block(field, count, number.size())?;
        if !self.is_text {
            return Ok(number.read_all(bytes, true));
        }
        (0..count)
            .map(|_| {
                let word = self.word(field, "a number")?;
                text::number(&word).ok_or_else(|| Error::input(self.path, field, word, "a number"))
            })
            .collect()
    }

    /// A binary block. Of a text it takes nothing, but checks that so many numbers fit into it.
    fn block(&mut self, field: &str, count: usize, size: usize) -> Result<&'a [u8]> {
        if !self.is_text {
            self.rest_of_line();
        }
        // A number of a text takes two bytes, but for the last one.
        let bytes = count.saturating_mul(if self.is_text { 2 } else { size });
        if bytes.saturating_sub(usize::from(self.is_text)) > self.rest.len() {
            let found = format!("the last {} bytes of the file", self.rest.len());
            return Err(Error::input(self.path, field, found, format!("{count} values")));
        }
        let (block, rest) = self.rest.split_at(if self.is_text { 0 } else { bytes });
        self.rest = rest;
        Ok(block)
    }

    fn integers(&mut self, field: &str, count: usize, number: Number) -> Result<Vec<i64>> {
        let whole = |x: f64| match x.fract() == 0.0 {
            true => Ok(x as i64),
            false => Err(Error::input(self.path, field, x, "a whole number")),
        };
        let numbers = self.numbers(field, count, number)?;
        numbers.into_iter().map(whole).collect()
    }

    fn points(&mut self) -> Result<Vec<DVec3>> {
        let count = self.count("POINTS")?;
        let number = self.number("POINTS")?;
        let coordinates = self.numbers("POINTS", count.saturating_mul(3), number)?;
        Ok(coordinates.as_chunks::<3>().0.iter().copied().map(DVec3::from_array).collect())
    }

    fn cells(&mut self, field: &str, cells: &mut Cells) -> Result<()> {
        let [rows, size] = [self.count(field)?, self.count(field)?];
        if self.peek().is_some_and(|word| word.eq_ignore_ascii_case("OFFSETS")) {
            return self.cells_by_offsets(field, [rows, size], cells);
        }
        let numbers = self.integers(field, size, Number::I32)?;
        let mut rest = numbers.as_slice();
        for row in 0..rows {
            let cell = rest
                .split_first()
                .and_then(|(&length, rest)| rest.split_at_checked(usize::try_from(length).ok()?));
            let Some((cell, after)) = cell else {
                let found = rest.first().map_or("nothing".into(), |length| format!("a list of {length}"));
                let expected = format!("a list within the {size} numbers of the cells");
                return Err(Error::input(self.path, format!("{field} {row}"), found, expected));
            };
            cells.push(cell.iter().copied());
            rest = after;
        }
        if !rest.is_empty() {
            let found = format!("{} numbers after the last of {rows} cells", rest.len());
            return Err(Error::input(self.path, field, found, format!("{size} numbers in all cells")));
        }
        Ok(())
    }

    fn cells_by_offsets(
        &mut self,
        field: &str,
        [offsets, size]: [usize; 2],
        cells: &mut Cells,
    ) -> Result<()> {
        let mut part = |keyword: &str, count: usize| {
            let word = self.word(field, keyword)?;
            if !word.eq_ignore_ascii_case(keyword) {
                return Err(Error::input(self.path, field, word, keyword));
            }
            let number = self.number(field)?;
            self.integers(field, count, number)
        };
        let (offsets, nodes) = (part("OFFSETS", offsets)?, part("CONNECTIVITY", size)?);
        for (k, pair) in offsets.windows(2).enumerate() {
            let range = usize::try_from(pair[0]).ok().zip(usize::try_from(pair[1]).ok());
            let cell = range.and_then(|(start, end)| nodes.get(start..end)).ok_or_else(|| {
                let found = format!("{} to {}", pair[0], pair[1]);
                Error::input(
                    self.path,
                    format!("{field} offset {k}"),
                    found,
                    format!("0 to {size}, ascending"),
                )
            })?;
            cells.push(cell.iter().copied());
        }
        if offsets.first().is_some_and(|&first| first != 0)
            || offsets.last().is_some_and(|&last| last != nodes.len() as i64)
        {
            let found = format!("{} to {}", offsets[0], offsets[offsets.len() - 1]);
            return Err(Error::input(self.path, format!("{field} offsets"), found, format!("0 to {size}")));
        }
        Ok(())
    }

    /// METADATA lasts up to an empty line.
    fn skip_metadata(&mut self) {
        self.rest_of_line();
        while !self.rest.is_empty() && !self.rest_of_line().is_empty() {}
    }

    /// The arrays of one number per node of an attribute that begins with `keyword`.
    fn attribute(&mut self, keyword: &str, count: usize) -> Result<Vec<NodeArray>> {
        let array = |name: &str, values: Option<Vec<f64>>| -> Vec<NodeArray> {
            values.into_iter().map(|values| NodeArray { name: decoded(name), values }).collect()
        };
        let components = match keyword {
            "FIELD" => return self.field(count),
            "SCALARS" => return self.scalars(count).map(|(name, values)| array(&name, values)),
            "LOOKUP_TABLE" => {
                self.word(keyword, "a name")?;
                let size = self.count(keyword)?;
                self.colours(keyword, size.saturating_mul(4))?;
                return Ok(Vec::new());
            }
            "COLOR_SCALARS" => {
                self.word(keyword, "a name")?;
                let values = self.count(keyword)?;
                self.colours(keyword, values.saturating_mul(count))?;
                return Ok(Vec::new());
            }
            "GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS" => 1,
            "NORMALS" | "VECTORS" => 3,
            "TENSORS" => 9,
            "TENSORS6" => 6,
            "TEXTURE_COORDINATES" => 0,
            _ => return Err(Error::input(self.path, "keyword", keyword, "one of VTK's legacy format")),
        };
        let name = self.word(keyword, "a name")?;
        let components = if components == 0 { self.count(keyword)? } else { components };
        let kind = self.word(keyword, "a type")?;
        let values = self.values(&name, &kind, components, count)?;
        Ok(array(&name, values))
    }

    /// Scalars have, after their name and type, the number of components where it is not 1, and a table of colours.
    fn scalars(&mut self, count: usize) -> Result<(String, Option<Vec<f64>>)> {
        let [name, kind] = [self.word("SCALARS", "a name")?, self.word("SCALARS", "a type")?];
        let line = self.rest_of_line();
        let components = match line.as_str() {
            "" => 1,
            text => {
                let wrong = |_| Error::input(self.path, format!("SCALARS {name}"), text, "a count");
                text.parse().map_err(wrong)?
            }
        };
        if self.peek().is_some_and(|word| word.eq_ignore_ascii_case("LOOKUP_TABLE")) {
            self.next_word();
            self.word("LOOKUP_TABLE", "a name")?;
        }
        let values = self.values(&name, &kind, components, count)?;
        Ok((name, values))
    }

    /// The arrays of a field, of as many values as there are nodes.
    fn field(&mut self, count: usize) -> Result<Vec<NodeArray>> {
        self.word("FIELD", "a name")?;
        let mut arrays = Vec::new();
        for _ in 0..self.count("FIELD")? {
            while self.peek().is_some_and(|word| word.eq_ignore_ascii_case("METADATA")) {
                self.next_word();
                self.skip_metadata();
            }
            let name = self.word("FIELD", "the name of an array")?;
            let [components, rows] = [self.count(&name)?, self.count(&name)?];
            let kind = self.word(&name, "a type")?;
            if let Some(values) = self.values(&name, &kind, components, rows)?.filter(|_| rows == count) {
                arrays.push(NodeArray { name: decoded(&name), values });
            }
        }
        Ok(arrays)
    }

    /// The values of an array of numbers with one component; passes over any other.
    fn values(&mut self, name: &str, kind: &str, components: usize, rows: usize) -> Result<Option<Vec<f64>>> {
        let count = components.saturating_mul(rows);
        match (number_of_type(kind), kind.to_ascii_lowercase().as_str()) {
            (Some(number), _) if components == 1 => return self.numbers(name, count, number).map(Some),
            (Some(number), _) => self.skip(name, count, number.size())?,
            (None, "bit") if self.is_text => self.skip(name, count, 1)?,
            (None, "bit") => self.skip(name, count.div_ceil(8), 1)?,
            (None, "string" | "utf8_string") => self.skip_strings(name, count)?,
            _ => return Err(Error::input(self.path, name, kind, "one of VTK's types")),
        }
        Ok(None)
    }

    fn skip(&mut self, field: &str, count: usize, size: usize) -> Result<()> {
        self.block(field, count, size)?;
        let words = if self.is_text { count } else { 0 };
        for _ in 0..words {
            self.word(field, "a number")?;
        }
        Ok(())
    }

    /// Colours are bytes in a binary file and numbers from 0 to 1 in a text.
    fn colours(&mut self, field: &str, count: usize) -> Result<()> {
        self.skip(field, count, 1)
    }

    /// A text has a line for each string. A binary string follows its length, whose first two bits tell how many bytes the
    /// length takes.
    fn skip_strings(&mut self, field: &str, count: usize) -> Result<()> {
        self.rest_of_line();
        for _ in 0..count {
            if self.rest.is_empty() {
                return Err(Error::input(
                    self.path,
                    field,
                    "the end of the file",
                    format!("{count} strings"),
                ));
            }
            if self.is_text {
                self.rest_of_line();
                continue;
            }
            let width = [8, 4, 2, 1][usize::from(self.rest[0] >> 6)];
            let after = self.rest.split_at_checked(width).and_then(|(head, rest)| {
                let length =
                    head.iter().fold(0_u64, |n, &b| n << 8 | u64::from(b)) & (u64::MAX >> (66 - 8 * width));
                rest.get(usize::try_from(length).ok()?..)
            });
            self.rest = after.ok_or_else(|| {
                Error::input(self.path, field, "a string longer than the file", format!("{count} strings"))
            })?;
        }
        Ok(())
    }
}

/// `vtkIdType` is written in four bytes, `long` in eight.
fn number_of_type(name: &str) -> Option<Number> {
    Some(match name.to_ascii_lowercase().as_str() {
        "char" | "signed_char" | "vtktypeint8" => Number::I8,
        "unsigned_char" | "vtktypeuint8" => Number::U8,
        "short" | "vtktypeint16" => Number::I16,
        "unsigned_short" | "vtktypeuint16" => Number::U16,
        "int" | "vtkidtype" | "vtktypeint32" => Number::I32,
        "unsigned_int" | "vtktypeuint32" => Number::U32,
        "long" | "long_long" | "__int64" | "vtktypeint64" => Number::I64,
        "unsigned_long" | "unsigned_long_long" | "unsigned___int64" | "vtktypeuint64" => Number::U64,
        "float" | "vtktypefloat32" => Number::F32,
        "double" | "vtktypefloat64" => Number::F64,
        _ => return None,
    })
}

/// A name without %-codes. VTK writes them for white space and for what is not ASCII.
fn decoded(name: &str) -> String {
    let mut bytes = Vec::with_capacity(name.len());
    let mut rest = name.as_bytes();
    while let [first, after @ ..] = rest {
        let code = after.get(..2).and_then(|c| std::str::from_utf8(c).ok());
        match code.filter(|_| *first == b'%').and_then(|c| u8::from_str_radix(c, 16).ok()) {
            Some(byte) => {
                bytes.push(byte);
                rest = &after[2..];
            }
            None => {
                bytes.push(*first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
