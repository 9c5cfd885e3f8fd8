//! Triangle surfaces with arrays over their nodes, and the files that hold them.

use crate::{Error, Result};
use glam::DVec3;
use std::path::Path;

/// A value per node, as VTP and PLY carry them.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeArray {
    /// Its name, with the unit where it has one: `residual_mm`.
    pub name: String,
    /// One value per node; NaN where there is none.
    pub values: Vec<f64>,
}

/// A triangle surface.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Surface {
    /// Node positions, mm.
    pub nodes_mm: Vec<DVec3>,
    /// Node indices, counter-clockwise seen from outside the lumen.
    pub triangles: Vec<[u32; 3]>,
    /// Arrays over the nodes.
    pub arrays: Vec<NodeArray>,
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

    /// Reads a surface by its file's ending: `.vtp`, `.ply`, `.stl` (welded), `.obj`.
    ///
    /// # Errors
    /// Where the file cannot be read or holds no usable triangle surface.
    pub fn read(path: &Path) -> Result<Self> {
        let _ = path;
        todo!()
    }

    /// Writes a surface by its file's ending: `.vtp`, `.ply`, `.stl`, `.obj`. The first two carry the arrays.
    ///
    /// # Errors
    /// Where the file cannot be written or its ending is unknown; no partial file is left behind.
    pub fn write(&self, path: &Path) -> Result<()> {
        Err(Error::UnknownEnding { path: path.into(), ending: String::new(), expected: "" })
    }
}

/// Refuses a file name whose ending names no surface format, before any work is spent on it.
///
/// # Errors
/// [`Error::UnknownEnding`].
pub fn check_ending(path: &Path) -> Result<()> {
    let _ = path;
    Ok(())
}
