//! Triangle surfaces with arrays over their nodes, and their file formats.

mod clip;
pub(crate) mod crossing;
mod cut;
mod formats;
mod locator;
pub(crate) mod marching;
pub(crate) mod remesh;
mod space;
mod topology;

pub use cut::{Cut, Cutter, OnEdge, SectionOutline};
pub(crate) use locator::RayCaster;
pub use locator::{Closest, Locator};
pub use space::Space;
pub(crate) use topology::Groups;
pub use topology::Topology;

pub(crate) use formats::vtp::PolyData;

use crate::{Error, Result, output};
#[cfg(feature = "mcap")]
use formats::mcap;
use formats::{mat, obj, ply, stl, vtk, vtp};
use glam::DVec3;
use std::path::Path;

/// The endings that [`Surface::write`] knows.
pub const ENDINGS: &str = ".vtp, .ply, .stl, .obj, .mat";

/// The endings that [`Surface::read`] knows.
pub const ENDINGS_READ: &str = ".vtp, .ply, .stl, .obj, .mat, .vtk, .vtu";

/// A value per node, as VTP, PLY, MAT-files and VTK carry them.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeArray {
    /// Its name, with the unit where it has one: `residual_mm`.
    pub name: String,
    /// One value per node; NaN where there is none.
    pub values: Vec<f64>,
}

/// A triangle surface.
///
/// Surfaces that were read have passed [`check`](Self::check), and those that are written or evaluated must pass it. Methods
/// that measure a surface made in memory rely on it too: they index by its triangles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Surface {
    /// Node positions, mm.
    pub nodes_mm: Vec<DVec3>,
    /// Node indices, counter-clockwise seen from outside the lumen.
    pub triangles: Vec<[u32; 3]>,
    /// Arrays over the nodes.
    pub arrays: Vec<NodeArray>,
}

/// The two triangles of a face between ring `lower` and the ring above it, as node indices, normals outward.
pub(crate) fn face_triangles(a: u32, b: u32, b_above: u32, a_above: u32) -> [[u32; 3]; 2] {
    [[a, b, b_above], [a, b_above, a_above]]
}

impl Surface {
    /// The array of that name.
    pub fn array(&self, name: &str) -> Option<&[f64]> {
        self.arrays.iter().find(|a| a.name == name).map(|a| a.values.as_slice())
    }

    /// Sets the array of that name, replacing one that is there.
    pub fn set_array(&mut self, name: &str, values: Vec<f64>) {
        match self.arrays.iter_mut().find(|a| a.name == name) {
            Some(array) => array.values = values,
            None => self.arrays.push(NodeArray { name: name.into(), values }),
        }
    }

    /// Adds the nodes and triangles of another surface. Both must have the same arrays in the same order, or this one no nodes.
    pub(crate) fn append(&mut self, other: Self) {
        if self.nodes_mm.is_empty() {
            *self = other;
            return;
        }
        let first = self.nodes_mm.len() as u32;
        self.nodes_mm.extend(other.nodes_mm);
        self.triangles.extend(other.triangles.iter().map(|triangle| triangle.map(|node| node + first)));
        for (array, more) in self.arrays.iter_mut().zip(other.arrays) {
            debug_assert_eq!(array.name, more.name, "the same arrays");
            array.values.extend(more.values);
        }
    }

    /// Reads a surface by its file's ending: `.vtp`, `.ply`, `.stl`, `.obj`, `.mat`, `.vtk` (legacy), `.vtu`. Numbers are
    /// taken as millimetres, and as given in [`Space::Ras`] unless the file names another space.
    ///
    /// Polygons become triangles that fill them, concave ones too; polygons and strips are both read where a file has
    /// both. VTP, PLY, MAT-files and VTK bring their node arrays of one number per node: the first of each name; pieces
    /// that lack an array have NaN there. All other arrays, lines and points are left out. An STL's corners become one node where their
    /// positions are equal, and triangles that this leaves with fewer than three different nodes are dropped.
    ///
    /// # Errors
    /// Where the file cannot be read or holds no usable triangle surface: no triangles, an index out of range, a
    /// position that is not finite, a polygon whose edges cross, cells of volumes, content cut short; and where arrays
    /// would take far more memory than the file does.
    pub fn read(path: &Path) -> Result<Self> {
        Ok(Self::read_with_space(path)?.0)
    }

    /// Reads a surface as [`read`](Self::read) does, and says in which space its file gives it; `None` where the file does
    /// not say. Nodes are in [`Space::Ras`] in any case.
    ///
    /// # Errors
    /// As [`read`](Self::read), and where the file names a space that is none.
    pub fn read_with_space(path: &Path) -> Result<(Self, Option<Space>)> {
        let parse = match output::ending(path).as_str() {
            "vtp" | "vtu" => vtp::parse,
            "ply" => ply::parse,
            "stl" => stl::parse,
            "obj" => obj::parse,
            "mat" => mat::parse,
            "vtk" => vtk::parse,
            ending => return Err(unknown_ending(path, ending, ENDINGS_READ)),
        };
        let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.into(), source })?;
        if bytes.is_empty() {
            return Err(Error::input(path, "content", "an empty file", "a surface"));
        }
        let (mut surface, space) = parse(path, &bytes)?;
        surface.check().map_err(|e| e.in_file(path))?;
        if let Some(space) = space {
            surface.nodes_mm.iter_mut().for_each(|p| *p = space.swapped(*p));
        }
        Ok((surface, space))
    }

    /// Writes a surface by its file's ending: `.vtp`, `.ply`, `.stl`, `.obj`, `.mat` (MATLAB: `vertices`,
    /// `faces` counted from 1, and the arrays). VTP, PLY and MAT-files carry the arrays, all but STL (single
    /// precision, triangles only) keep positions to the last bit. The file says that it is in [`Space::Ras`].
    /// With the feature `mcap` also `.mcap`, a scene for Foxglove, in metres and without arrays.
    ///
    /// # Errors
    /// [`Error::UnknownEnding`]; [`Error::Surface`] where there are no triangles or [`check`](Self::check) finds fault;
    /// [`Error::Write`], and no partial file is left behind.
    pub fn write(&self, path: &Path) -> Result<()> {
        self.write_in(path, Space::Ras)
    }

    /// Writes a surface as [`write`](Self::write) does, with its nodes in a space, which the file names.
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn write_in(&self, path: &Path, space: Space) -> Result<()> {
        let write = match output::ending(path).as_str() {
            "vtp" => vtp::write,
            "ply" => ply::write,
            "stl" => stl::write,
            "obj" => obj::write,
            "mat" => mat::write,
            #[cfg(feature = "mcap")]
            "mcap" => mcap::write,
            ending => return Err(unknown_ending(path, ending, ENDINGS)),
        };
        self.check()?;
        if self.triangles.is_empty() {
            return Err(Error::Surface {
                what: "triangles".into(),
                found: "none".into(),
                expected: "at least one".into(),
            });
        }
        let mut swapped = None;
        if space != Space::Ras {
            let nodes_mm = self.nodes_mm.iter().map(|p| space.swapped(*p)).collect();
            swapped = Some(Self { nodes_mm, ..self.clone() });
        }
        output::write_atomically(path, |w| write(swapped.as_ref().unwrap_or(self), space, w))
    }

    /// Checks that positions are finite, that the indices of every triangle name nodes, and that every array has a unique
    /// name and one value per node.
    ///
    /// # Errors
    /// [`Error::Surface`] with the first violation.
    pub fn check(&self) -> Result<()> {
        if let Some(node) = self.nodes_mm.iter().position(|p| !p.is_finite()) {
            return Err(Error::Surface {
                what: format!("position of node {node}"),
                found: self.nodes_mm[node].to_string(),
                expected: "finite coordinates".into(),
            });
        }
        let nodes = self.nodes_mm.len();
        for (t, corners) in self.triangles.iter().enumerate() {
            if let Some(corner) = corners.iter().find(|&&c| c as usize >= nodes) {
                return Err(Error::Surface {
                    what: format!("triangle {t}"),
                    found: format!("node {corner}"),
                    expected: format!("a node below {nodes}"),
                });
            }
        }
        for (k, array) in self.arrays.iter().enumerate() {
            let what = format!("node array {:?}", array.name);
            if array.values.len() != nodes {
                return Err(Error::Surface {
                    what,
                    found: format!("{} values", array.values.len()),
                    expected: format!("{nodes}, one per node"),
                });
            }
            if array.name.trim().is_empty() || self.arrays[..k].iter().any(|a| a.name == array.name) {
                return Err(Error::Surface {
                    what,
                    found: "an empty or repeated name".into(),
                    expected: "a name of its own".into(),
                });
            }
        }
        Ok(())
    }

    /// The corners of triangle `t`, mm.
    pub(crate) fn corners_mm(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|n| self.nodes_mm[n as usize])
    }

    /// The smallest and largest coordinates, mm; `None` without nodes.
    pub fn bounding_box_mm(&self) -> Option<[DVec3; 2]> {
        let first = *self.nodes_mm.first()?;
        Some(self.nodes_mm.iter().fold([first, first], |[low, high], &p| [low.min(p), high.max(p)]))
    }
}

/// The polylines of a .vtp file, mm in [`Space::Ras`].
pub(crate) fn read_polylines(path: &Path) -> Result<Vec<Vec<DVec3>>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.into(), source })?;
    vtp::parse_lines(path, &bytes)
}

/// Refuses a file name whose ending names no surface format, before any work is spent on it.
///
/// # Errors
/// [`Error::UnknownEnding`].
pub fn check_ending(path: &Path) -> Result<()> {
    match output::ending(path).as_str() {
        "vtp" | "ply" | "stl" | "obj" | "mat" => Ok(()),
        "mcap" if cfg!(feature = "mcap") => Ok(()),
        ending => Err(unknown_ending(path, ending, ENDINGS)),
    }
}

fn unknown_ending(path: &Path, ending: &str, expected: &'static str) -> Error {
    Error::UnknownEnding { path: path.into(), ending: ending.into(), expected }
}
