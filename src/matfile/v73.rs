//! Reader of MAT-files of version 7.3, which are HDF5 files.
//!
//! Each variable is a dataset or, if it is a struct, a group; the attribute `MATLAB_class` says what it is.
//! Dimensions stand in reverse order, because MATLAB stores columns and HDF5 rows. The elements of cells are
//! references.

use super::{Array, Budget, FORMATS, Fields, MAX_BYTES, MAX_DEPTH, Value, count, text};
use crate::text::shown;
use crate::{Error, Result};
use hdf5_pure::{Dataset, File, Group, Object};
use std::path::Path;

const EXPECTED: &str = "a whole MAT-file of version 7.3";
/// Characters of the decoder's own words that a message shows.
const SHOWN: usize = 200;
/// Deflate expands no further: a dataset that claims more has no values in the file.
const MAX_EXPANSION: usize = 1032;

/// Reads the variables of a file of version 7.3.
///
/// # Errors
/// Where the file is damaged, was not written by MATLAB, or holds too much.
pub(super) fn read(path: &Path, bytes: Vec<u8>, wanted: &[&str]) -> Result<Fields> {
    let most_stored = bytes.len().saturating_mul(MAX_EXPANSION);
    let file = File::from_bytes(bytes)
        .map_err(|e| Error::input(path, "format", format!("version 7.3 (HDF5) and {}", said(e)), FORMATS))?;
    let mut reader = Reader { budget: Budget(MAX_BYTES), most_stored, wanted };
    let root = file.root();
    let names = root.groups().map_err(|e| Error::input(path, "variables", said(e), EXPECTED))?;
    let is_octaves = names
        .iter()
        .filter_map(|name| root.group(name).ok())
        .any(|group| group.attrs().is_ok_and(|attributes| attributes.contains_key("OCTAVE_NEW_FORMAT")));
    if is_octaves {
        return Err(Error::input(path, "format", "a file of Octave's own HDF5 format", FORMATS));
    }
    reader.fields(&root, 0).map_err(|Fault { name, found }| Error::input(path, name, found, EXPECTED))
}

/// What is wrong, and with which variable.
struct Fault {
    name: String,
    found: String,
}

fn said(error: impl ToString) -> String {
    shown(&error.to_string(), SHOWN)
}

struct Reader<'a> {
    budget: Budget,
    /// Bytes that the file's datasets can hold at most.
    most_stored: usize,
    /// Names of the datasets that are read.
    wanted: &'a [&'a str],
}

impl Reader<'_> {
    /// The variables of the file, or the fields of a struct.
    fn fields(&mut self, group: &Group, depth: usize) -> Result<Fields, Fault> {
        if depth > MAX_DEPTH {
            let found = format!("structs and cells more than {MAX_DEPTH} deep");
            return Err(Fault { name: "variables".into(), found });
        }
        let listed = |e| Fault { name: "variables".into(), found: said(e) };
        let mut fields = Fields::new();
        // What begins with # is MATLAB's own: what cells refer to, and objects.
        let is_variable = |name: &String| !name.starts_with('#');
        for name in group.datasets().map_err(listed)?.into_iter().filter(is_variable) {
            let value = match self.wanted.contains(&name.as_str()) {
                true => group
                    .dataset(&name)
                    .map_err(said)
                    .and_then(|dataset| self.value(&dataset, depth))
                    .map_err(|found| Fault { name: name.clone(), found })?,
                false => Value::Other("a dataset"),
            };
            fields.insert(shown(&name, SHOWN), value);
        }
        for name in group.groups().map_err(listed)?.into_iter().filter(is_variable) {
            let inner = group.group(&name).map_err(|e| Fault { name: name.clone(), found: said(e) })?;
            let is_sparse = inner.attrs().is_ok_and(|attributes| attributes.contains_key("MATLAB_sparse"));
            let value = match is_sparse {
                true => Value::Other("a sparse array"),
                false => Value::Struct(self.fields(&inner, depth + 1)?),
            };
            fields.insert(shown(&name, SHOWN), value);
        }
        Ok(fields)
    }

    fn value(&mut self, dataset: &Dataset, depth: usize) -> Result<Value, String> {
        let attributes = dataset.attrs().map_err(said)?;
        let class = attributes.get("MATLAB_class").and_then(|class| class.as_str()).unwrap_or_default();
        let mut shape = Vec::new();
        for size in dataset.shape().map_err(said)?.into_iter().rev() {
            shape.push(usize::try_from(size).map_err(|_| format!("a dimension of {size}"))?);
        }
        self.budget.take(count(&shape)?, 8)?;
        let stored = dataset.element_size().map_err(said)?.saturating_mul(count(&shape)? as u64);
        if stored > self.most_stored as u64 {
            let (shape, most) = (Array { shape, values: Vec::new() }.shape_text(), self.most_stored);
            return Err(format!("{shape} numbers of {stored} bytes in a file that can hold {most}"));
        }
        // An empty array's dataset holds its sizes.
        if attributes.get("MATLAB_empty").and_then(|empty| empty.as_i64()).is_some_and(|empty| empty != 0) {
            let sizes = dataset.read_u64().map_err(said)?;
            shape = sizes.into_iter().map(|size| usize::try_from(size).unwrap_or(usize::MAX)).collect();
            if !shape.contains(&0) {
                return Err(format!("an empty array of the sizes {shape:?}"));
            }
            return Ok(match class {
                "cell" => Value::Cells(Vec::new()),
                _ => Value::Real(Array { shape, values: Vec::new() }),
            });
        }
        match class {
            "double" | "single" | "int8" | "uint8" | "int16" | "uint16" | "int32" | "uint32" | "int64"
            | "uint64" | "logical" | "char" => {
                if dataset.dtype().is_ok_and(|kind| matches!(kind, hdf5_pure::DType::Compound(_))) {
                    return Ok(Value::Other("complex numbers"));
                }
                let array = Array { values: dataset.read_f64().map_err(said)?, shape };
                if count(&array.shape)? != array.values.len() {
                    return Err(format!("{} values for {}", array.values.len(), array.shape_text()));
                }
                Ok(match class {
                    "logical" => Value::Logical(array),
                    "char" => Value::Text(text(&array.values)),
                    _ => Value::Real(array),
                })
            }
            "cell" if depth < MAX_DEPTH => {
                let element = |object: Object| match object {
                    Object::Dataset(dataset) => self.value(&dataset, depth + 1),
                    _ => Ok(Value::Other("a struct in a cell")),
                };
                dataset
                    .dereference()
                    .map_err(said)?
                    .into_iter()
                    .map(element)
                    .collect::<Result<_, _>>()
                    .map(Value::Cells)
            }
            "cell" => Err(format!("cells more than {MAX_DEPTH} deep")),
            "" => Ok(Value::Other("a dataset that MATLAB has not written (it has no MATLAB_class)")),
            _ => Ok(Value::Other("an object")),
        }
    }
}
