//! PLY (Stanford): written as binary little endian, read in all three of its encodings.

use super::cells::{Contents, require_triangles};
use super::number::Number;
use super::text::{self, HeaderLines};
use crate::surface::{NodeArray, Space, Surface};
use crate::{Error, Result};
use glam::DVec3;
use std::io::Write;
use std::path::Path;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

/// The original names, those with sizes, and those of eight bytes that some programs add.
fn number_of_name(name: &str) -> Option<Number> {
    Some(match name {
        "char" | "int8" => Number::I8,
        "uchar" | "uint8" => Number::U8,
        "short" | "int16" => Number::I16,
        "ushort" | "uint16" => Number::U16,
        "int" | "int32" => Number::I32,
        "uint" | "uint32" => Number::U32,
        "long" | "longlong" | "int64" => Number::I64,
        "ulong" | "ulonglong" | "uint64" => Number::U64,
        "float" | "float32" => Number::F32,
        "double" | "float64" => Number::F64,
        _ => return None,
    })
}

struct Property {
    name: String,
    number: Number,
    /// The type of the count that precedes each list; none for a scalar.
    list: Option<Number>,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

impl Element {
    /// The smallest size of its rows in bytes, which the file must hold.
    fn min_bytes(&self, encoding: Encoding) -> usize {
        let row: usize = match encoding {
            Encoding::Text => 2 * self.properties.len(),
            _ => self.properties.iter().map(|p| p.list.unwrap_or(p.number).size()).sum(),
        };
        // The last number of a text needs no separator after it.
        self.count.saturating_mul(row).saturating_sub(1)
    }
}

/// The numbers after the header, one after the other.
struct Body<'a> {
    path: &'a Path,
    rest: &'a [u8],
    encoding: Encoding,
}

impl<'a> Body<'a> {
    /// The bytes of the next number, which are a word in a text.
    fn next_bytes(&mut self, number: Number, at: &dyn Fn() -> String) -> Result<&'a [u8]> {
        let split = if self.encoding == Encoding::Text {
            let rest = self.rest.trim_ascii_start();
            let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            rest.split_at_checked(end).filter(|(word, _)| !word.is_empty())
        } else {
            self.rest.split_at_checked(number.size())
        };
        let (bytes, rest) = split.ok_or_else(|| {
            Error::input(self.path, at(), "the end of the file", format!("a number of type {number:?}"))
        })?;
        self.rest = rest;
        Ok(bytes)
    }

    fn next(&mut self, number: Number, at: &dyn Fn() -> String) -> Result<f64> {
        let bytes = self.next_bytes(number, at)?;
        if self.encoding == Encoding::Text {
            let word = String::from_utf8_lossy(bytes);
            return text::number(&word).ok_or_else(|| Error::input(self.path, at(), word, "a number"));
        }
        Ok(number.read(bytes, self.encoding == Encoding::BigEndian))
    }

    fn next_integer(&mut self, number: Number, at: &dyn Fn() -> String) -> Result<i64> {
        let value = self.next(number, at)?;
        if value.fract() != 0.0 {
            return Err(Error::input(self.path, at(), value, "a whole number"));
        }
        Ok(value as i64)
    }

    /// The length of a list, which the rest of the file can hold.
    fn next_length(&mut self, count: Number, item: Number, at: &dyn Fn() -> String) -> Result<usize> {
        let length = self.next_integer(count, at)?;
        let least = if self.encoding == Encoding::Text { 1 } else { item.size() };
        usize::try_from(length).ok().filter(|n| n.saturating_mul(least) <= self.rest.len()).ok_or_else(|| {
            Error::input(self.path, at(), format!("a list of {length}"), "a list that the file holds")
        })
    }

    fn next_indices(&mut self, count: Number, item: Number, at: &dyn Fn() -> String) -> Result<Vec<i64>> {
        let length = self.next_length(count, item, at)?;
        (0..length).map(|_| self.next_integer(item, at)).collect()
    }

    fn skip(&mut self, property: &Property, at: &dyn Fn() -> String) -> Result<()> {
        let length = match property.list {
            Some(count) => self.next_length(count, property.number, at)?,
            None => 1,
        };
        for _ in 0..length {
            self.next_bytes(property.number, at)?;
        }
        Ok(())
    }
}

pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<(Surface, Option<Space>)> {
    let Header { encoding, elements, rest, space } = parse_header(path, bytes)?;
    let mut body = Body { path, rest, encoding };
    let mut contents = Contents::default();
    for element in &elements {
        if element.min_bytes(encoding) > body.rest.len() {
            return Err(Error::input(
                path,
                format!("element {}", element.name),
                format!("{} bytes", body.rest.len()),
                format!("the {} rows that the header promises", element.count),
            ));
        }
        match element.name.as_str() {
            "vertex" => read_vertices(&mut body, element, &mut contents)?,
            "face" | "tristrips" => read_cells(&mut body, element, &mut contents)?,
            _ => skip_rows(&mut body, element)?,
        }
    }
    // Some programs end a file with a line break.
    let left = body.rest.iter().filter(|b| !b.is_ascii_whitespace() && **b != 0).count();
    if left > 0 {
        let found = format!("{left} bytes after the rows that the header promises");
        return Err(Error::input(path, "end", found, "the end of the file"));
    }
    let edges = elements.iter().find(|e| e.name == "edge").map_or(0, |e| e.count);
    Ok((require_triangles(contents.triangulate(path)?, path, &[("edges", edges)])?, space))
}

/// The header, and what follows it.
struct Header<'a> {
    encoding: Encoding,
    elements: Vec<Element>,
    space: Option<Space>,
    rest: &'a [u8],
}

fn parse_header<'a>(path: &Path, bytes: &'a [u8]) -> Result<Header<'a>> {
    let mut lines = HeaderLines::new(bytes);
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut space = None;
    for number in 1.. {
        let Some(line) = lines.next() else {
            return Err(match number {
                1 => Error::input(path, "header line 1", "no line of text", "ply"),
                _ => Error::input(path, "header", "the end of the file", "end_header"),
            });
        };
        let wrong =
            |expected: &str| Error::input(path, format!("header line {number}"), line.as_ref(), expected);
        let words: Vec<&str> = line.split_whitespace().collect();
        match (number, words.as_slice()) {
            (1, ["ply"]) => {}
            (1, _) => return Err(wrong("ply")),
            (_, ["format", name, "1.0"]) => {
                encoding = Some(match *name {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::LittleEndian,
                    "binary_big_endian" => Encoding::BigEndian,
                    _ => return Err(wrong("ascii, binary_little_endian or binary_big_endian")),
                });
            }
            (_, ["element", name, count]) => {
                let count = count.parse().map_err(|_| wrong("a count of rows"))?;
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            (_, ["property", kind @ .., name]) => {
                let number = |name: &&str| number_of_name(name).ok_or_else(|| wrong("a number type of PLY"));
                let (list, number) = match kind {
                    ["list", count, item] => (Some(number(count)?), number(item)?),
                    [item] => (None, number(item)?),
                    _ => return Err(wrong("property TYPE NAME or property list TYPE TYPE NAME")),
                };
                let element = elements.last_mut().ok_or_else(|| wrong("an element before its properties"))?;
                element.properties.push(Property { name: (*name).into(), number, list });
            }
            (_, ["comment" | "obj_info", ..]) => space = space.or_else(|| Space::marked(&line)),
            (_, []) => {}
            (_, ["end_header"]) => break,
            _ => return Err(wrong("format, element, property, comment or end_header")),
        }
    }
    let encoding = encoding.ok_or_else(|| Error::input(path, "header", "no format line", "format"))?;
    Ok(Header { encoding, elements, space, rest: lines.rest })
}

fn read_vertices(body: &mut Body, element: &Element, contents: &mut Contents) -> Result<()> {
    let wrong = |found: String, expected: &str| Error::input(body.path, "element vertex", found, expected);
    if !contents.nodes_mm.is_empty() {
        return Err(wrong("a second one".into(), "one"));
    }
    let column = |name| {
        let found = element.properties.iter().position(|p| p.name == name && p.list.is_none());
        found.ok_or_else(|| wrong(format!("no {name}"), "x, y and z"))
    };
    let position = [column("x")?, column("y")?, column("z")?];
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); element.properties.len()];
    for row in 0..element.count {
        for (property, values) in element.properties.iter().zip(&mut columns) {
            let at = || format!("vertex {row}: {}", property.name);
            match property.list {
                Some(_) => body.skip(property, &at)?,
                None => values.push(body.next(property.number, &at)?),
            }
        }
    }
    let [x, y, z] = position.map(|k| columns[k].as_slice());
    contents.nodes_mm = x.iter().zip(y).zip(z).map(|((&x, &y), &z)| DVec3::new(x, y, z)).collect();
    let scalars = element.properties.iter().zip(columns).enumerate();
    for (_, (property, values)) in scalars.filter(|(k, (p, _))| p.list.is_none() && !position.contains(k)) {
        contents.arrays.push(NodeArray { name: property.name.clone(), values });
    }
    Ok(())
}

/// Reads the nodes of polygons, or of strips, among which -1 begins another strip.
fn read_cells(body: &mut Body, element: &Element, contents: &mut Contents) -> Result<()> {
    let names = ["vertex_indices", "vertex_index"];
    let is_nodes = |p: &Property| p.list.is_some() && names.contains(&p.name.as_str());
    if element.count > 0 && !element.properties.iter().any(is_nodes) {
        let expected = format!("a list {} or {}", names[0], names[1]);
        return Err(Error::input(body.path, format!("element {}", element.name), "none", expected));
    }
    for row in 0..element.count {
        for property in &element.properties {
            let at = || format!("{} {row}: {}", element.name, property.name);
            match property.list {
                Some(count) if is_nodes(property) => {
                    let nodes = body.next_indices(count, property.number, &at)?;
                    match element.name.as_str() {
                        "tristrips" => nodes.split(|&n| n == -1).for_each(|strip| {
                            contents.strips.push(strip.iter().copied());
                        }),
                        _ => contents.polygons.push(nodes),
                    }
                }
                _ => body.skip(property, &at)?,
            }
        }
    }
    Ok(())
}

fn skip_rows(body: &mut Body, element: &Element) -> Result<()> {
    // Rows without properties take no bytes, however many there are.
    let rows = if element.properties.is_empty() { 0 } else { element.count };
    for row in 0..rows {
        for property in &element.properties {
            body.skip(property, &|| format!("{} {row}: {}", element.name, property.name))?;
        }
    }
    Ok(())
}

/// Positions and arrays as `double`. White space in an array's name becomes `_`, as PLY's header cannot hold it.
pub(in crate::surface) fn write(surface: &Surface, space: Space, w: &mut dyn Write) -> std::io::Result<()> {
    writeln!(
        w,
        "ply\nformat binary_little_endian 1.0\ncomment lengths in mm, by lumenmesh\ncomment SPACE={space}"
    )?;
    writeln!(w, "element vertex {}", surface.nodes_mm.len())?;
    for name in ["x", "y", "z"] {
        writeln!(w, "property double {name}")?;
    }
    let mut taken: Vec<String> = ["x", "y", "z"].map(String::from).to_vec();
    for array in &surface.arrays {
        let name: String = array.name.split_whitespace().collect::<Vec<_>>().join("_");
        if taken.contains(&name) {
            return Err(std::io::Error::other(format!("two columns would be named {name:?}")));
        }
        writeln!(w, "property double {name}")?;
        taken.push(name);
    }
    // Most readers take only signed indices.
    let index = if i32::try_from(surface.nodes_mm.len()).is_ok() { "int" } else { "uint" };
    writeln!(w, "element face {}", surface.triangles.len())?;
    writeln!(w, "property list uchar {index} vertex_indices\nend_header")?;
    for (n, p) in surface.nodes_mm.iter().enumerate() {
        for x in p.to_array().into_iter().chain(surface.arrays.iter().map(|a| a.values[n])) {
            w.write_all(&x.to_le_bytes())?;
        }
    }
    for triangle in &surface.triangles {
        w.write_all(&[3])?;
        for corner in triangle {
            w.write_all(&corner.to_le_bytes())?;
        }
    }
    Ok(())
}
