//! MAT-files: named arrays, cells and structs, whatever the version of the file.

mod v4;
mod v5;
mod v73;

pub(crate) use v5::write;

use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// A real array, its values in column-major order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

impl Array {
    /// The shape as MATLAB prints it: `3x3x1000`.
    pub fn shape_text(&self) -> String {
        let sizes: Vec<String> = self.shape.iter().map(usize::to_string).collect();
        sizes.join("x")
    }
}

/// Variables, or the fields of a struct, by their names.
pub(crate) type Fields = BTreeMap<String, Value>;

/// The value of a variable or of a field.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Real(Array),
    Logical(Array),
    Text(String),
    /// A cell array, in column-major order.
    Cells(Vec<Value>),
    /// One struct.
    Struct(Fields),
    /// Anything else, and what nobody asked for, described in words.
    Other(&'static str),
}

impl Value {
    /// What it is, for messages.
    pub fn kind(&self) -> &'static str {
        match self {
            Value::Real(_) => "a full array of real numbers",
            Value::Logical(_) => "logical values",
            Value::Text(_) => "text",
            Value::Cells(_) => "a cell array",
            Value::Struct(_) => "a struct",
            Value::Other(kind) => kind,
        }
    }
}

/// Most bytes that the wanted values of a file may take in memory. Compressed data expand up to a thousandfold
/// and numbers of one byte become doubles: a file of 4 MB could ask for 32 GB. The contours of 65,536 frames of
/// 1000 rays need this much.
const MAX_BYTES: usize = 1 << 30;
/// Structs and cells within each other: more is no data, and would end the stack.
const MAX_DEPTH: usize = 16;

/// What of [`MAX_BYTES`] is left.
struct Budget(usize);

impl Budget {
    /// Takes the bytes of this many values.
    ///
    /// # Errors
    /// What was asked for and how much there may be, where it is too much.
    fn take(&mut self, values: usize, bytes_each: usize) -> Result<(), String> {
        match values.checked_mul(bytes_each).and_then(|bytes| self.0.checked_sub(bytes)) {
            Some(left) => {
                self.0 = left;
                Ok(())
            }
            None => Err(format!(
                "{values} more values of {bytes_each} bytes, where {} of {MAX_BYTES} bytes are left",
                self.0
            )),
        }
    }
}

/// Number of values in an array of that shape.
fn count(shape: &[usize]) -> Result<usize, String> {
    let count = shape.iter().try_fold(1_usize, |n, &size| n.checked_mul(size));
    count.ok_or_else(|| format!("array sizes {shape:?}"))
}

const FORMATS: &str = "a MAT-file (in MATLAB and Octave: save with -v7)";

/// Reads a file's variables. Arrays and cells whose names nobody asked for are there as [`Value::Other`].
///
/// # Errors
/// Where the file cannot be read, is no MAT-file, is damaged, or holds more than fits into memory.
pub(crate) fn read(path: &Path, wanted: &[&str]) -> Result<Fields> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    match format(&bytes) {
        Ok(Format::V4(order)) => v4::read(path, &bytes, order, wanted),
        Ok(Format::V5(order)) => v5::read(path, &bytes, order, wanted),
        Ok(Format::V73) => v73::read(path, bytes, wanted),
        Err(found) => Err(Error::input(path, "format", found, FORMATS)),
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    V4(ByteOrder),
    V5(ByteOrder),
    V73,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum ByteOrder {
    Little,
    Big,
}

impl ByteOrder {
    fn u32(self, bytes: [u8; 4]) -> u32 {
        match self {
            ByteOrder::Little => u32::from_le_bytes(bytes),
            ByteOrder::Big => u32::from_be_bytes(bytes),
        }
    }
}

/// The file's format, or what it is instead of a MAT-file.
fn format(bytes: &[u8]) -> Result<Format, &'static str> {
    const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";
    if bytes.is_empty() {
        return Err("an empty file");
    }
    // The signature of HDF5 lies behind a block of the user's, whose size is 512 or twice, four times, … that.
    let is_hdf5 = |at: usize| bytes.get(at..).is_some_and(|rest| rest.starts_with(HDF5));
    if is_hdf5(0) || (bytes.starts_with(b"MATLAB 7.3") && (9..32).any(|power| is_hdf5(1 << power))) {
        return Ok(Format::V73);
    }
    if bytes.starts_with(b"MATLAB 7.3") {
        return Err("a file of version 7.3 that is cut short");
    }
    if bytes.starts_with(b"# Created by Octave") || bytes.starts_with(b"# name:") {
        return Err("a file of Octave's own text format");
    }
    if bytes.starts_with(b"Octave-1") {
        return Err("a file of Octave's own binary format");
    }
    if bytes.starts_with(&[0x1f, 0x8b]) {
        return Err("a file compressed by gzip (unpack it first)");
    }
    if bytes.starts_with(b"PK\x03\x04") {
        return Err("a zip archive (unpack it first)");
    }
    match bytes.get(124..128) {
        Some([0, 1, b'I', b'M']) => return Ok(Format::V5(ByteOrder::Little)),
        Some([1, 0, b'M', b'I']) => return Ok(Format::V5(ByteOrder::Big)),
        _ => {}
    }
    match v4::byte_order(bytes) {
        Some(order) => Ok(Format::V4(order)),
        None => Err("a file without the header of one"),
    }
}

/// Numbers of any type of this size in bytes, sign and kind.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stored {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    I64,
    U64,
    F64,
}

/// The numbers in some bytes; `None` where these end within one.
fn numbers(stored: Stored, order: ByteOrder, bytes: &[u8]) -> Option<Vec<f64>> {
    macro_rules! convert {
        ($type:ty) => {{
            let (chunks, odd) = bytes.as_chunks();
            let value = |&chunk| match order {
                ByteOrder::Little => <$type>::from_le_bytes(chunk) as f64,
                ByteOrder::Big => <$type>::from_be_bytes(chunk) as f64,
            };
            odd.is_empty().then(|| chunks.iter().map(value).collect())
        }};
    }
    match stored {
        Stored::I8 => convert!(i8),
        Stored::U8 => convert!(u8),
        Stored::I16 => convert!(i16),
        Stored::U16 => convert!(u16),
        Stored::I32 => convert!(i32),
        Stored::U32 => convert!(u32),
        Stored::F32 => convert!(f32),
        Stored::F64 => convert!(f64),
        Stored::I64 => convert!(i64),
        Stored::U64 => convert!(u64),
    }
}

/// Text from the numbers of its characters.
fn text(characters: &[f64]) -> String {
    let units: Vec<u16> = characters.iter().map(|&c| c as u16).collect();
    String::from_utf16_lossy(&units)
}
