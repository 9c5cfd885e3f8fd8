//! STL: triangles by their corners, in single precision; carries neither shared nodes nor arrays.

use crate::surface::Surface;
use crate::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

const HEADER: usize = 84;
const RECORD: usize = 50;

pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<Surface> {
    let corners = match binary_corners(bytes) {
        Some(corners) => corners,
        // Binary files may start with "solid" too, so their length decides first.
        None if bytes.trim_ascii_start().starts_with(b"solid") => text_corners(path, bytes)?,
        None => {
            let count =
                bytes.get(80..HEADER).map(|b| b.iter().rev().fold(0u64, |n, &b| n << 8 | u64::from(b)));
            let expected = match count {
                Some(n) => {
                    format!("{} bytes for the {n} triangles of its header", HEADER as u64 + RECORD as u64 * n)
                }
                None => format!("text that starts with \"solid\" or a binary header of {HEADER} bytes"),
            };
            return Err(Error::input(path, "length", format!("{} bytes", bytes.len()), expected));
        }
    };
    weld(path, &corners)
}

/// The corners of a binary file; `None` where its length does not agree with its header.
fn binary_corners(bytes: &[u8]) -> Option<Vec<[f32; 3]>> {
    let (head, records) = bytes.split_at_checked(HEADER)?;
    let count = u32::from_le_bytes(head.get(80..)?.try_into().ok()?);
    if records.len() as u64 != RECORD as u64 * u64::from(count) {
        return None;
    }
    let (numbers, _) = records.as_chunks::<RECORD>();
    let mut corners = Vec::with_capacity(3 * numbers.len());
    for record in numbers {
        let (words, _) = record.as_chunks::<4>();
        // The first three words are the normal: it follows from the corners.
        let (points, _) = words[3..].as_chunks::<3>();
        corners.extend(points.iter().map(|p| p.map(f32::from_le_bytes)));
    }
    Some(corners)
}

fn text_corners(path: &Path, bytes: &[u8]) -> Result<Vec<[f32; 3]>> {
    let text = String::from_utf8_lossy(bytes);
    let mut corners = Vec::new();
    let mut loops = 0;
    let mut ended = false;
    for (number, line) in text.lines().enumerate() {
        let field = || format!("line {}", number + 1);
        let mut words = line.split_whitespace();
        match words.next() {
            Some("vertex") => {
                let mut coordinate = || {
                    let word = words.next().unwrap_or("the end of the line");
                    word.parse::<f32>().map_err(|_| Error::input(path, field(), word, "three coordinates"))
                };
                corners.push([coordinate()?, coordinate()?, coordinate()?]);
            }
            Some("endloop") => {
                loops += 1;
                if corners.len() != 3 * loops {
                    return Err(Error::input(
                        path,
                        field(),
                        "a loop of another length",
                        "three vertex lines per loop",
                    ));
                }
            }
            Some("endsolid") => ended = true,
            Some("solid" | "facet" | "outer" | "endfacet") | None => {}
            Some(word) => return Err(Error::input(path, field(), word, "a keyword of STL")),
        }
    }
    if !ended || corners.len() != 3 * loops {
        return Err(Error::input(path, "end", "a file cut short", "endsolid"));
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
pub(in crate::surface) fn write(surface: &Surface, w: &mut dyn Write) -> std::io::Result<()> {
    let mut header = [0u8; 80];
    let title = b"binary STL, mm, by lumenmesh";
    header[..title.len()].copy_from_slice(title);
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
