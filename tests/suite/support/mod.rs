//! What the tests share: shapes, recorded data and outside tools.

#[path = "../../support/required.rs"]
mod required;

pub use required::{shared, skipped};

pub mod vessel;

use glam::DVec3;
use lumenmesh::surface::Surface;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A tube about z, open at both ends, normals outwards.
pub fn tube(nodes: u32, levels: u32, radius_mm: f64, height_mm: f64) -> Surface {
    let mut surface = Surface::default();
    for level in 0..=levels {
        let z = height_mm * (f64::from(level) / f64::from(levels) - 0.5);
        for j in 0..nodes {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(j) / f64::from(nodes)).sin_cos();
            surface.nodes_mm.push(DVec3::new(radius_mm * cos, radius_mm * sin, z));
        }
    }
    for level in 0..levels {
        for j in 0..nodes {
            let (a, b) = (level * nodes + j, level * nodes + (j + 1) % nodes);
            surface.triangles.extend([[a, b, b + nodes], [a, b + nodes, a + nodes]]);
        }
    }
    surface
}

/// A closed surface of four triangles, normals outwards.
pub fn tetrahedron() -> Surface {
    Surface {
        nodes_mm: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        arrays: Vec::new(),
    }
}

/// Runs the command in a folder: exit status, stdout and stderr.
#[cfg(feature = "cli")]
pub fn lumenmesh(arguments: &[&str], folder: &Path) -> (i32, String, String) {
    let command = env!("CARGO_BIN_EXE_lumenmesh");
    let output = Command::new(command).args(arguments).current_dir(folder).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

/// The names of a folder's files, sorted.
#[cfg(feature = "cli")]
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A Python that can import VTK.
pub struct Python(PathBuf);

impl Python {
    /// Runs a script and returns what it prints.
    pub fn run(&self, script: &str, arguments: &[&Path]) -> String {
        let output = Command::new(&self.0).args(["-c", script]).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }
}

/// `LUMENMESH_PYTHON` or `python3`; `None`, with a line on stderr, where it cannot import VTK.
pub fn python_with_vtk() -> Option<Python> {
    python_with("vtk, numpy")
}

/// `LUMENMESH_PYTHON` or `python3`; `None`, with a line on stderr, where it cannot import these modules.
pub fn python_with(modules: &str) -> Option<Python> {
    let python = std::env::var_os("LUMENMESH_PYTHON").unwrap_or_else(|| "python3".into());
    let imported = Command::new(&python).args(["-c", &format!("import {modules}")]).output();
    if imported.is_ok_and(|output| output.status.success()) {
        return Some(Python(python.into()));
    }
    let what = format!("no Python with {modules} (LUMENMESH_PYTHON names one)");
    skipped(&what, "LUMENMESH_REQUIRE_TOOLS");
    None
}
