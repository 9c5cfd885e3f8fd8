//! From the cells of a file to triangles.

use crate::geometry::polygon;
use crate::surface::{NodeArray, Surface};
use crate::{Error, Result};
use glam::DVec3;
use std::path::Path;

/// Cells as the nodes of one after the other.
#[derive(Debug, Default)]
pub(super) struct Cells {
    corners: Vec<i64>,
    /// Where each cell ends among the corners.
    ends: Vec<usize>,
}

impl Cells {
    pub fn push(&mut self, corners: impl IntoIterator<Item = i64>) {
        self.corners.extend(corners);
        self.ends.push(self.corners.len());
    }

    pub fn iter(&self) -> impl Iterator<Item = &[i64]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.corners[start..end])
    }
}

/// What a file holds before its cells are triangles.
#[derive(Debug, Default)]
pub(super) struct Contents {
    pub nodes_mm: Vec<DVec3>,
    pub arrays: Vec<NodeArray>,
    pub polygons: Cells,
    pub strips: Cells,
    /// The numbers of cells that are no part of a surface.
    pub lines: usize,
    pub points: usize,
}

impl Contents {
    /// Adds a cell of one of VTK's types: part of a surface, a line or a point.
    ///
    /// Types: <https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html>
    pub fn push_of_vtk_type(&mut self, path: &Path, cell: usize, kind: i64, corners: &[i64]) -> Result<()> {
        match (kind, corners) {
            (0, _) => {}
            (1 | 2, _) => self.points += 1,
            (3 | 4, _) => self.lines += 1,
            (5 | 7 | 9, _) => self.polygons.push(corners.iter().copied()),
            (6, _) => self.strips.push(corners.iter().copied()),
            // A pixel's corners go from left to right in both of its rows.
            (8, &[a, b, c, d]) => self.polygons.push([a, b, d, c]),
            _ => {
                return Err(Error::input(
                    path,
                    format!("cell {cell}"),
                    format!("VTK's type {kind} with {} nodes", corners.len()),
                    "triangles, quads, polygons, pixels or strips (5 to 9), lines or points",
                ));
            }
        }
        Ok(())
    }

    /// The triangles of all polygons and strips.
    pub fn triangulate(self, path: &Path) -> Result<Surface> {
        let mut surface = Surface { nodes_mm: self.nodes_mm, arrays: self.arrays, ..Surface::default() };
        for (k, corners) in self.polygons.iter().enumerate() {
            push_polygon(path, k, corners, &mut surface)?;
        }
        for (k, corners) in self.strips.iter().enumerate() {
            push_strip(path, k, corners, &mut surface)?;
        }
        Ok(surface)
    }
}

/// Refuses a file without triangles and says what there was instead.
pub(super) fn require_triangles(surface: Surface, path: &Path, instead: &[(&str, usize)]) -> Result<Surface> {
    if !surface.triangles.is_empty() {
        return Ok(surface);
    }
    let there: Vec<String> = [("nodes", surface.nodes_mm.len())]
        .iter()
        .chain(instead)
        .filter(|(_, count)| *count > 0)
        .map(|(what, count)| format!("{what}: {count}"))
        .collect();
    let found = if there.is_empty() { "none".into() } else { format!("none ({})", there.join(", ")) };
    Err(Error::input(path, "triangles", found, "at least one"))
}

fn push_polygon(path: &Path, polygon: usize, corners: &[i64], surface: &mut Surface) -> Result<()> {
    let field = || format!("polygon {polygon}");
    if corners.len() < 3 {
        return Err(Error::input(path, field(), format!("{} corners", corners.len()), "3 or more"));
    }
    let nodes = nodes(path, &field, corners, surface)?;
    if let &[a, b, c] = nodes.as_slice() {
        surface.triangles.push([a, b, c]);
        return Ok(());
    }
    let corners_mm: Vec<DVec3> = nodes.iter().map(|&n| surface.nodes_mm[n as usize]).collect();
    let triangles = polygon::triangulate(&corners_mm).ok_or_else(|| {
        let found = format!("edges that cross, among {} corners", nodes.len());
        Error::input(path, field(), found, "a polygon that has one inside")
    })?;
    surface.triangles.extend(triangles.into_iter().map(|t| t.map(|corner| nodes[corner])));
    Ok(())
}

/// Triangles that name a node twice are left out: strips use them to go on elsewhere.
fn push_strip(path: &Path, strip: usize, corners: &[i64], surface: &mut Surface) -> Result<()> {
    let nodes = nodes(path, &|| format!("strip {strip}"), corners, surface)?;
    for (i, &[a, b, c]) in nodes.array_windows().enumerate() {
        if a != b && b != c && c != a {
            // Every second triangle of a strip runs the other way round.
            surface.triangles.push(if i % 2 == 0 { [a, b, c] } else { [a, c, b] });
        }
    }
    Ok(())
}

fn nodes(path: &Path, field: &dyn Fn() -> String, corners: &[i64], surface: &Surface) -> Result<Vec<u32>> {
    let count = surface.nodes_mm.len();
    let node = |&corner: &i64| match u32::try_from(corner) {
        Ok(index) if (index as usize) < count => Ok(index),
        _ => {
            let expected = format!("a node from 0 to below {count}");
            Err(Error::input(path, field(), format!("node {corner}"), expected))
        }
    };
    corners.iter().map(node).collect()
}
