//! MAT-files of MATLAB and Octave: `vertices` V×3, `faces` T×3 counted from 1, and an array V×1 per node array.

use crate::matfile::{self, Array, Value};
use crate::surface::{NodeArray, Space, Surface};
use crate::{Error, Result};
use glam::DVec3;
use std::io::Write;
use std::path::Path;

const VERTICES: &str = "vertices";
const FACES: &str = "faces";
const SPACE: &str = "space";

/// Reads the variables again from the path: all versions of MAT-files have one reader.
pub(in crate::surface) fn parse(path: &Path, _bytes: &[u8]) -> Result<(Surface, Option<Space>)> {
    let names: Vec<String> = matfile::read(path, &[])?.into_keys().collect();
    let mut fields = matfile::read(path, &names.iter().map(String::as_str).collect::<Vec<_>>())?;
    let mut table = |name: &str| match fields.remove(name) {
        Some(Value::Real(array)) if array.shape.len() == 2 && array.shape[1] == 3 => Ok(array),
        Some(Value::Real(array)) => Err(Error::input(path, name, array.shape_text(), "three columns")),
        Some(other) => Err(Error::input(path, name, other.kind(), "a full array of real numbers")),
        None => {
            let there = format!("variables {}", names.join(", "));
            Err(Error::input(path, name, there, "vertices (V×3) and faces (T×3, counted from 1)"))
        }
    };
    let (vertices, faces) = (table(VERTICES)?, table(FACES)?);
    let nodes = vertices.shape[0];
    let row = |array: &Array, k: usize| [0, 1, 2].map(|c| array.values[c * array.shape[0] + k]);
    let nodes_mm = (0..nodes).map(|k| DVec3::from_array(row(&vertices, k))).collect();
    let triangle = |t: usize| -> Result<[u32; 3]> {
        let [a, b, c] = row(&faces, t).map(|corner| {
            let is_node = corner.fract() == 0.0 && (1.0..=nodes as f64).contains(&corner);
            let expected = || format!("a node from 1 to {nodes}");
            is_node
                .then_some(corner as u64 as u32)
                .ok_or_else(|| Error::input(path, format!("faces, row {}", t + 1), corner, expected()))
        });
        Ok([a? - 1, b? - 1, c? - 1])
    };
    let triangles: Vec<[u32; 3]> = (0..faces.shape[0]).map(triangle).collect::<Result<_>>()?;
    if triangles.is_empty() {
        return Err(Error::input(path, FACES, "none", "at least one triangle"));
    }
    let space = match fields.remove(SPACE) {
        None => None,
        Some(Value::Text(text)) => Some(
            Space::named(&text)
                .ok_or_else(|| Error::input(path, SPACE, format!("{text:?}"), "ras or lps"))?,
        ),
        Some(other) => return Err(Error::input(path, SPACE, other.kind(), "ras or lps")),
    };
    let is_per_node = |array: &Array| array.shape == [nodes, 1] || array.shape == [1, nodes];
    let arrays = fields
        .into_iter()
        .filter_map(|(name, value)| match value {
            Value::Real(array) if is_per_node(&array) => Some(NodeArray { name, values: array.values }),
            _ => None,
        })
        .collect();
    Ok((Surface { nodes_mm, triangles, arrays }, space))
}

pub(in crate::surface) fn write(surface: &Surface, space: Space, w: &mut dyn Write) -> std::io::Result<()> {
    let (nodes, triangles) = (&surface.nodes_mm, &surface.triangles);
    let vertices = (0..3).flat_map(|c| nodes.iter().map(move |p| p[c])).collect();
    let faces = (0..3).flat_map(|c| triangles.iter().map(move |t| f64::from(t[c]) + 1.0)).collect();
    let mut variables = vec![
        (VERTICES.to_owned(), Value::Real(Array { shape: vec![nodes.len(), 3], values: vertices })),
        (FACES.to_owned(), Value::Real(Array { shape: vec![triangles.len(), 3], values: faces })),
        (SPACE.to_owned(), Value::Text(space.name().to_lowercase())),
    ];
    for array in &surface.arrays {
        let name = variable_name(&array.name);
        if variables.iter().any(|(taken, _)| *taken == name) {
            return Err(std::io::Error::other(format!("two variables would be named {name:?}")));
        }
        let shape = vec![nodes.len(), 1];
        variables.push((name, Value::Real(Array { shape, values: array.values.clone() })));
    }
    let variables: Vec<(&str, Value)> =
        variables.iter().map(|(name, value)| (name.as_str(), value.clone())).collect();
    matfile::write(w, &variables)
}

/// An array's name as MATLAB takes it for a variable: letters, digits and `_`, a letter first, at most 63.
fn variable_name(name: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric();
    let mut plain: String = name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    if !plain.starts_with(|c: char| c.is_ascii_alphabetic()) {
        plain.insert_str(0, "array_");
    }
    plain.truncate(63);
    plain
}
