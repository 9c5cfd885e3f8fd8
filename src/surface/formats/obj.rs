//! Wavefront OBJ: text, one `v` line per node and one `f` line per polygon; carries no arrays.

use super::cells::{Contents, require_triangles};
use super::text;
use crate::surface::{Space, Surface};
use crate::text::decoded;
use crate::{Error, Result};
use glam::DVec3;
use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

/// Reads `v` and `f` lines without texture and normal indices, counts lines and points, and skips all others.
pub(in crate::surface) fn parse(path: &Path, bytes: &[u8]) -> Result<(Surface, Option<Space>)> {
    let text = decoded(bytes);
    let mut contents = Contents::default();
    let mut space = None;
    for (number, line) in logical_lines(&text) {
        if line.starts_with('#') {
            space = space.or_else(|| Space::marked(&line));
        }
        let field = || format!("line {number}");
        let mut words = line.split('#').next().unwrap_or_default().split_whitespace();
        match words.next() {
            Some("v") => {
                let mut coordinate = || {
                    let word = words.next().unwrap_or("the end of the line");
                    text::number(word).ok_or_else(|| Error::input(path, field(), word, "three coordinates"))
                };
                contents.nodes_mm.push(DVec3::new(coordinate()?, coordinate()?, coordinate()?));
            }
            Some("f") => {
                let nodes = contents.nodes_mm.len() as i64;
                let corners: Vec<i64> = words
                    .map(|word| {
                        corner(word, nodes).ok_or_else(|| {
                            let expected = format!("an index, 1 or more, or -{nodes} to -1");
                            Error::input(path, field(), word, expected)
                        })
                    })
                    .collect::<Result<_>>()?;
                contents.polygons.push(corners);
            }
            Some("l") => contents.lines += 1,
            Some("p") => contents.points += 1,
            Some("surf") => return Err(Error::input(path, field(), "a free-form surface", "polygons")),
            _ => {}
        }
    }
    let instead = [("lines", contents.lines), ("points", contents.points)];
    Ok((require_triangles(contents.triangulate(path)?, path, &instead)?, space))
}

/// The node of a corner such as `7`, `7/1`, `7//3` or `-1`: negative indices count back from the last node so far.
fn corner(word: &str, nodes: i64) -> Option<i64> {
    match word.split('/').next()?.parse::<i64>().ok()? {
        index if index > 0 => Some(index - 1),
        index if index < 0 && index >= -nodes => Some(nodes + index),
        _ => None,
    }
}

/// Each line with its number, 1-based; a `v` or `f` line that ends in `\` with those that continue it. In other lines a
/// `\` may end the name of a folder.
fn logical_lines(text: &str) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut lines = (1..).zip(text::lines(text));
    std::iter::from_fn(move || {
        let (number, first) = lines.next()?;
        let mut line = Cow::Borrowed(first);
        let may_go_on = matches!(first.split_whitespace().next(), Some("v" | "f"));
        while may_go_on && line.trim_end().ends_with('\\') {
            let line = line.to_mut();
            line.truncate(line.trim_end().len() - 1);
            line.push(' ');
            line.push_str(lines.next().map_or("", |(_, next)| next));
        }
        Some((number, line))
    })
}

/// Rust prints the shortest digits that read back as the same number.
pub(in crate::surface) fn write(surface: &Surface, space: Space, w: &mut dyn Write) -> std::io::Result<()> {
    writeln!(w, "# lengths in mm, by lumenmesh, SPACE={space}")?;
    for p in &surface.nodes_mm {
        writeln!(w, "v {} {} {}", p.x, p.y, p.z)?;
    }
    for [a, b, c] in surface.triangles.iter().map(|t| t.map(|n| u64::from(n) + 1)) {
        writeln!(w, "f {a} {b} {c}")?;
    }
    Ok(())
}
