//! Wavefront OBJ: text, one `v` line per node and one `f` line per polygon; carries no arrays.

use crate::surface::{Surface, push_polygon};
use crate::{Error, Result};
use glam::DVec3;
use std::io::Write;
use std::path::Path;

/// Reads `v` and `f` lines without texture and normal indices, and skips all others.
pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<Surface> {
    let text = std::str::from_utf8(bytes).map_err(|e| {
        Error::input(path, "text", format!("bytes that are not UTF-8 at {}", e.valid_up_to()), "text")
    })?;
    let mut surface = Surface::default();
    let mut polygons = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let field = || format!("line {}", number + 1);
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let mut coordinate = || {
                    let word = words.next().unwrap_or("the end of the line");
                    word.parse::<f64>().map_err(|_| Error::input(path, field(), word, "three coordinates"))
                };
                surface.nodes_mm.push(DVec3::new(coordinate()?, coordinate()?, coordinate()?));
            }
            Some("f") => {
                // Negative indices count back from the last node so far.
                let nodes = surface.nodes_mm.len() as i64;
                let corners: Vec<i64> = words
                    .map(|word| match word.split('/').next().unwrap_or(word).parse::<i64>() {
                        Ok(index) if index > 0 => Ok(index - 1),
                        Ok(index) if index < 0 && index >= -nodes => Ok(nodes + index),
                        _ => Err(Error::input(
                            path,
                            field(),
                            word,
                            format!("an index, 1 or more, or -{nodes} to -1"),
                        )),
                    })
                    .collect::<Result<_>>()?;
                polygons.push(corners);
            }
            _ => {}
        }
    }
    for (k, corners) in polygons.iter().enumerate() {
        push_polygon(path, k, corners, surface.nodes_mm.len(), &mut surface.triangles)?;
    }
    Ok(surface)
}

/// Rust prints the shortest digits that read back as the same number.
pub(in crate::surface) fn write(surface: &Surface, w: &mut dyn Write) -> std::io::Result<()> {
    for p in &surface.nodes_mm {
        writeln!(w, "v {} {} {}", p.x, p.y, p.z)?;
    }
    for [a, b, c] in surface.triangles.iter().map(|t| t.map(|n| u64::from(n) + 1)) {
        writeln!(w, "f {a} {b} {c}")?;
    }
    Ok(())
}
