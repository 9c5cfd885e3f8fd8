//! STL: triangles by their corners, in single precision; carries neither shared nodes nor arrays.

use super::cells::require_triangles;
use super::text;
use crate::surface::{Space, Surface};
use crate::text::decoded;
use crate::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

/// The title of a binary file, and its header with the count of triangles, in bytes.
const TITLE: usize = 80;
const HEADER: usize = TITLE + 4;
const RECORD: usize = 50;

/// So many bytes tell a binary file from a text: they have the count of triangles, whose last byte is 0 in files of less
/// than 800 MB, and the first of them.
const LOOKED_AT: usize = 1024;

pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<(Surface, Option<Space>)> {
    let corners = if is_text(bytes) { text_corners(path, bytes)? } else { binary_corners(path, bytes)? };
    let count = corners.len() / 3;
    let instead = [("triangles without three different corners", count)];
    Ok((require_triangles(weld(path, &corners)?, path, &instead)?, space(bytes)))
}

/// In the header, or on the first line of a text.
fn space(bytes: &[u8]) -> Option<Space> {
    let head = bytes.get(..TITLE).unwrap_or(bytes);
    let end = if is_text(bytes) { head.iter().position(|&b| b == b'\n') } else { None };
    Space::marked(&String::from_utf8_lossy(&head[..end.unwrap_or(head.len())]))
}

/// By its bytes, not by its first word: binary files may begin with "solid" too.
fn is_text(bytes: &[u8]) -> bool {
    let is_wide = bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff");
    let is_control = |b: &u8| b.is_ascii_control() && !b.is_ascii_whitespace();
    is_wide || !bytes.iter().take(LOOKED_AT).any(is_control)
}

/// The corners of a binary file. Fewer bytes after them than a triangle takes, such as a line break, are no loss; more
/// may be triangles that the count leaves out.
fn binary_corners(path: &Path, bytes: &[u8]) -> Result<Vec<[f32; 3]>> {
    let wrong = |expected: String| {
        Error::input(path, "length of the binary file", format!("{} bytes", bytes.len()), expected)
    };
    let (count, records) = bytes
        .split_at_checked(HEADER)
        .and_then(|(head, records)| Some((u32::from_le_bytes(*head.last_chunk()?), records)))
        .ok_or_else(|| wrong(format!("a header of {HEADER} bytes")))?;
    let (triangles, _) = records.as_chunks::<RECORD>();
    if triangles.len() as u64 != u64::from(count) {
        let length = HEADER as u64 + RECORD as u64 * u64::from(count);
        return Err(wrong(format!("{length} bytes for the {count} triangles of its header")));
    }
    let mut corners = Vec::with_capacity(3 * triangles.len());
    for record in triangles {
        let (words, _) = record.as_chunks::<4>();
        // The first three words are the normal: it follows from the corners.
        let (points, _) = words[3..].as_chunks::<3>();
        corners.extend(points.iter().map(|p| p.map(f32::from_le_bytes)));
    }
    Ok(corners)
}

/// The corners of a text, in which each solid must have its end. Case does not count, nor whether `end` stands apart.
fn text_corners(path: &Path, bytes: &[u8]) -> Result<Vec<[f32; 3]>> {
    let text = decoded(bytes);
    let mut corners = Vec::new();
    let mut loops = 0;
    let mut solids = 0;
    let mut is_open = false;
    for (number, line) in (1..).zip(text::lines(&text)) {
        let wrong =
            |found: &str, expected: &str| Error::input(path, format!("line {number}"), found, expected);
        let mut words = line.split_whitespace();
        let Some(word) = words.next() else { continue };
        let mut keyword = word.to_ascii_lowercase();
        if keyword == "end" {
            keyword.extend(words.next().map(str::to_ascii_lowercase));
        }
        match keyword.as_str() {
            "solid" if !is_open => {
                solids += 1;
                is_open = true;
            }
            "endsolid" if is_open => is_open = false,
            "vertex" if is_open => {
                let mut coordinate = || {
                    let word = words.next().unwrap_or("the end of the line");
                    text::number(word).map(|x| x as f32).ok_or_else(|| wrong(word, "three coordinates"))
                };
                corners.push([coordinate()?, coordinate()?, coordinate()?]);
            }
            "endloop" if is_open => {
                loops += 1;
                if corners.len() != 3 * loops {
                    return Err(wrong("a loop of another length", "three vertex lines per loop"));
                }
            }
            "facet" | "outer" | "endfacet" if is_open => {}
            _ if solids == 0 => return Err(wrong(word, "solid, which begins a text")),
            "solid" => return Err(wrong(word, "endsolid before the next solid")),
            _ => return Err(wrong(word, if is_open { "a keyword of STL" } else { "solid" })),
        }
    }
    if is_open || corners.len() != 3 * loops {
        let found = format!("a text cut short in solid {solids}");
        return Err(Error::input(path, "end", found, "endsolid"));
    }
    Ok(corners)
}

/// Nodes in the order in which the file first names them.
fn weld(path: &Path, corners: &[[f32; 3]]) -> Result<Surface> {
    let mut surface = Surface::default();
    let mut node_at: HashMap<[u32; 3], u32> = HashMap::new();
    let (triples, _) = corners.as_chunks::<3>();
    for triple in triples {
        let mut triangle = [0; 3];
        for (node, corner) in triangle.iter_mut().zip(triple) {
            // Adding zero makes -0 and 0 the same place.
            let bits = corner.map(|x| (x + 0.0).to_bits());
            let next = u32::try_from(node_at.len())
                .map_err(|_| Error::input(path, "nodes", "more than 2^32", "fewer than 2^32"))?;
            *node = *node_at.entry(bits).or_insert_with(|| {
                surface.nodes_mm.push(DVec3::from_array(corner.map(f64::from)));
                next
            });
        }
        let [a, b, c] = triangle;
        if a != b && b != c && c != a {
            surface.triangles.push(triangle);
        }
    }
    Ok(surface)
}

/// Binary.
pub(in crate::surface) fn write(surface: &Surface, space: Space, w: &mut dyn Write) -> std::io::Result<()> {
    let mut header = [0u8; TITLE];
    let title = format!("binary STL, mm, by lumenmesh, SPACE={space}");
    header[..title.len()].copy_from_slice(title.as_bytes());
    w.write_all(&header)?;
    let count = u32::try_from(surface.triangles.len()).map_err(std::io::Error::other)?;
    w.write_all(&count.to_le_bytes())?;
    for t in 0..surface.triangles.len() {
        let [a, b, c] = surface.corners_mm(t);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        for x in [normal, a, b, c].iter().flat_map(|v| v.to_array()) {
            w.write_all(&(x as f32).to_le_bytes())?;
        }
        w.write_all(&[0; 2])?;
    }
    Ok(())
}
