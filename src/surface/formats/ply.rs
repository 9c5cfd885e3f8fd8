//! PLY (Stanford): written as binary little endian, read in all three of its encodings.

use crate::surface::{NodeArray, Surface, push_polygon};
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

#[derive(Debug, Clone, Copy, PartialEq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
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

impl Body<'_> {
    fn next(&mut self, number: Number, at: &dyn Fn() -> String) -> Result<f64> {
        let ended =
            || Error::input(self.path, at(), "the end of the file", format!("a number of type {number:?}"));
        if self.encoding == Encoding::Text {
            let rest = self.rest.trim_ascii_start();
            let (word, rest) =
                rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
            if word.is_empty() {
                return Err(ended());
            }
            self.rest = rest;
            let word = String::from_utf8_lossy(word);
            return word.parse().map_err(|_| Error::input(self.path, at(), word, "a number"));
        }
        let (word, rest) = self.rest.split_at_checked(number.size()).ok_or_else(ended)?;
        self.rest = rest;
        let mut b = [0; 8];
        match self.encoding {
            Encoding::BigEndian => word.iter().rev().zip(&mut b).for_each(|(from, to)| *to = *from),
            _ => word.iter().zip(&mut b).for_each(|(from, to)| *to = *from),
        }
        let [b0, b1, b2, b3, ..] = b;
        Ok(match number {
            Number::I8 => i8::from_le_bytes([b0]).into(),
            Number::U8 => b0.into(),
            Number::I16 => i16::from_le_bytes([b0, b1]).into(),
            Number::U16 => u16::from_le_bytes([b0, b1]).into(),
            Number::I32 => i32::from_le_bytes([b0, b1, b2, b3]).into(),
            Number::U32 => u32::from_le_bytes([b0, b1, b2, b3]).into(),
            Number::F32 => f32::from_le_bytes([b0, b1, b2, b3]).into(),
            Number::F64 => f64::from_le_bytes(b),
        })
    }

    fn next_integer(&mut self, number: Number, at: &dyn Fn() -> String) -> Result<i64> {
        let value = self.next(number, at)?;
        if value.fract() != 0.0 {
            return Err(Error::input(self.path, at(), value, "a whole number"));
        }
        Ok(value as i64)
    }

    fn next_list(&mut self, count: Number, number: Number, at: &dyn Fn() -> String) -> Result<Vec<i64>> {
        let length = self.next_integer(count, at)?;
        let least = if self.encoding == Encoding::Text { 1 } else { number.size() };
        match usize::try_from(length) {
            Ok(n) if n.saturating_mul(least) <= self.rest.len() => {
                (0..n).map(|_| self.next_integer(number, at)).collect()
            }
            _ => Err(Error::input(
                self.path,
                at(),
                format!("a list of {length}"),
                "a list that the file holds",
            )),
        }
    }
}

pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<Surface> {
    let (encoding, elements, rest) = parse_header(path, bytes)?;
    let mut body = Body { path, rest, encoding };
    let mut surface = Surface::default();
    let mut polygons = Vec::new();
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
            "vertex" => read_vertices(&mut body, element, &mut surface)?,
            _ => read_rows(&mut body, element, &mut polygons)?,
        }
    }
    for (k, corners) in polygons.iter().enumerate() {
        push_polygon(path, k, corners, surface.nodes_mm.len(), &mut surface.triangles)?;
    }
    Ok(surface)
}

fn parse_header<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Encoding, Vec<Element>, &'a [u8])> {
    let mut rest = bytes;
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    for number in 1.. {
        let Some(end) = rest.iter().position(|&b| b == b'\n') else {
            return Err(Error::input(path, "header", "the end of the file", "end_header"));
        };
        let line = String::from_utf8_lossy(&rest[..end]).into_owned();
        rest = &rest[end + 1..];
        let wrong =
            |expected: &str| Error::input(path, format!("header line {number}"), line.trim(), expected);
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
                let number = |name: &&str| Number::parse(name).ok_or_else(|| wrong("a number type of PLY"));
                let (list, number) = match kind {
                    ["list", count, item] => (Some(number(count)?), number(item)?),
                    [item] => (None, number(item)?),
                    _ => return Err(wrong("property TYPE NAME or property list TYPE TYPE NAME")),
                };
                let element = elements.last_mut().ok_or_else(|| wrong("an element before its properties"))?;
                element.properties.push(Property { name: (*name).into(), number, list });
            }
            (_, ["comment" | "obj_info", ..] | []) => {}
            (_, ["end_header"]) => break,
            _ => return Err(wrong("format, element, property, comment or end_header")),
        }
    }
    let encoding = encoding.ok_or_else(|| Error::input(path, "header", "no format line", "format"))?;
    Ok((encoding, elements, rest))
}

fn read_vertices(body: &mut Body, element: &Element, surface: &mut Surface) -> Result<()> {
    let column = |name| {
        let found = element.properties.iter().position(|p| p.name == name && p.list.is_none());
        found.ok_or_else(|| Error::input(body.path, "element vertex", format!("no {name}"), "x, y and z"))
    };
    let position = [column("x")?, column("y")?, column("z")?];
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); element.properties.len()];
    for row in 0..element.count {
        for (property, values) in element.properties.iter().zip(&mut columns) {
            let at = || format!("vertex {row}: {}", property.name);
            match property.list {
                Some(count) => drop(body.next_list(count, property.number, &at)?),
                None => values.push(body.next(property.number, &at)?),
            }
        }
    }
    let [x, y, z] = position.map(|k| columns[k].as_slice());
    surface.nodes_mm = x.iter().zip(y).zip(z).map(|((&x, &y), &z)| DVec3::new(x, y, z)).collect();
    let scalars = element.properties.iter().zip(columns).enumerate();
    for (_, (property, values)) in scalars.filter(|(k, (p, _))| p.list.is_none() && !position.contains(k)) {
        surface.arrays.push(NodeArray { name: property.name.clone(), values });
    }
    Ok(())
}

/// Reads the polygons of an element `face` and skips everything else.
fn read_rows(body: &mut Body, element: &Element, polygons: &mut Vec<Vec<i64>>) -> Result<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for row in 0..element.count {
        for property in &element.properties {
            let at = || format!("{} {row}: {}", element.name, property.name);
            match property.list {
                Some(count) => {
                    let corners = body.next_list(count, property.number, &at)?;
                    let polygon = ["vertex_indices", "vertex_index"].contains(&property.name.as_str());
                    if element.name == "face" && polygon {
                        polygons.push(corners);
                    }
                }
                None => drop(body.next(property.number, &at)?),
            }
        }
    }
    Ok(())
}

/// Positions and arrays as `double`. White space in an array's name becomes `_`, as PLY's header cannot hold it.
pub(in crate::surface) fn write(surface: &Surface, w: &mut dyn Write) -> std::io::Result<()> {
    writeln!(w, "ply\nformat binary_little_endian 1.0\ncomment lengths in mm, by lumenmesh")?;
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
