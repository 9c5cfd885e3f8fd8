//! Reader and writer of MAT-files of level 5 (MATLAB versions 5 to 7).
//!
//! Own code, because neither crate for it is safe on bad input: matrw 0.1.4 panics on damaged deflate streams
//! (and refuses SciPy's header), matfile 0.5.0 reads a truncated file as one with fewer variables and prints to
//! stdout. Layout: *MAT-File Format*, The MathWorks, chapter 1 ("MAT-File Level 5").

use super::{Array, Budget, ByteOrder, Fields, MAX_BYTES, MAX_DEPTH, Stored, Value, count, numbers, text};
use crate::{Error, Result};
use flate2::read::ZlibDecoder;
use std::io::{self, Read, Write};
use std::path::Path;

const EXPECTED: &str = "a whole MAT-file of version 5 to 7";
const HEADER_BYTES: usize = 128;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
const DOUBLE_CLASS: u8 = 6;
const OPAQUE_CLASS: u8 = 17;
const COMPLEX_FLAG: u32 = 0x0800;
const LOGICAL_FLAG: u32 = 0x0200;
/// Longest name of a variable or field that is read; MATLAB's have 63 characters at most.
const MAX_NAME_BYTES: usize = 1 << 12;
/// What a value takes beside its numbers, so that cells of nothing cost something.
const VALUE_BYTES: usize = 64;

/// Reads the variables of a file of level 5.
///
/// # Errors
/// Where the file is damaged or holds too much.
pub(super) fn read(path: &Path, bytes: &[u8], order: ByteOrder, wanted: &[&str]) -> Result<Fields> {
    let mut fields = Fields::new();
    let mut budget = Budget(MAX_BYTES);
    let mut rest = bytes.get(HEADER_BYTES..).unwrap_or_default();
    let mut position = 1;
    while !rest.is_empty() {
        let name = format!("variable {position}");
        let damaged = |name: &str, e: io::Error| Error::input(path, name, e, EXPECTED);
        let mut tag = Source::new(rest, order, &mut budget, wanted);
        let kind = tag.u32().map_err(|e| damaged(&name, e))?;
        let size = tag.u32().map_err(|e| damaged(&name, e))? as usize;
        let whole = tag.bytes.get(..size);
        let body = whole.unwrap_or(tag.bytes);
        rest = tag.bytes.get(size..).unwrap_or_default();
        let content: Box<dyn Read + '_> = match kind {
            MATRIX => Box::new(body),
            COMPRESSED => Box::new(ZlibDecoder::new(body)),
            _ => return Err(damaged(&name, fault(format!("an element of type {kind}")))),
        };
        let mut source = Source::new(content, order, &mut budget, wanted);
        let size = match kind {
            COMPRESSED => source.matrix_tag().map_err(|e| damaged(&name, e))?,
            _ => size,
        };
        let head = source.head().map_err(|e| damaged(&name, e))?;
        if whole.is_none() {
            let found = format!("{} of {size} bytes (the file is cut short)", body.len());
            return Err(Error::input(path, head.name, found, EXPECTED));
        }
        let is_wanted = wanted.contains(&head.name.as_str());
        let value = match is_wanted || head.class == STRUCT_CLASS {
            true => source.value(&head, is_wanted, 0).map_err(|e| damaged(&head.name, e))?,
            false => Value::Other(head.kind()),
        };
        if is_wanted {
            // Reading on to the end lets the decompression compare its checksum.
            source.skip_to_end(size).map_err(|e| damaged(&head.name, e))?;
        }
        fields.insert(head.name, value);
        position += 1;
    }
    Ok(fields)
}

fn fault(found: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, found.into())
}

const CELL_CLASS: u8 = 1;
const STRUCT_CLASS: u8 = 2;
const TEXT_CLASS: u8 = 4;
const SPARSE_CLASS: u8 = 5;

/// The header of a variable.
struct Head {
    class: u8,
    flags: u32,
    shape: Vec<usize>,
    name: String,
}

impl Head {
    fn kind(&self) -> &'static str {
        match self.class {
            _ if self.flags & COMPLEX_FLAG != 0 => "complex numbers",
            _ if self.flags & LOGICAL_FLAG != 0 => "logical values",
            CELL_CLASS => "a cell array",
            STRUCT_CLASS if self.shape.iter().all(|&size| size == 1) => "a struct",
            STRUCT_CLASS => "an array of structs",
            TEXT_CLASS => "text",
            SPARSE_CLASS => "a sparse array",
            DOUBLE_CLASS..=15 => "a full array of real numbers",
            _ => "an object",
        }
    }
}

struct Source<'a, R> {
    bytes: R,
    order: ByteOrder,
    /// Bytes read so far.
    read: usize,
    budget: &'a mut Budget,
    /// Names of the arrays and cells that are kept.
    wanted: &'a [&'a str],
}

impl<'a, R: Read> Source<'a, R> {
    fn new(bytes: R, order: ByteOrder, budget: &'a mut Budget, wanted: &'a [&'a str]) -> Self {
        Self { bytes, order, read: 0, budget, wanted }
    }

    fn u32(&mut self) -> io::Result<u32> {
        let mut bytes = [0; 4];
        match self.bytes.read_exact(&mut bytes) {
            Ok(()) => self.read += 4,
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Err(fault("an early end")),
            Err(e) => return Err(e),
        }
        Ok(self.order.u32(bytes))
    }

    /// Skips bytes; fewer may be there.
    fn skip(&mut self, bytes: usize) -> io::Result<()> {
        self.read += io::copy(&mut (&mut self.bytes).take(bytes as u64), &mut io::sink())? as usize;
        Ok(())
    }

    /// Skips what is left of an element of that size.
    fn skip_to_end(&mut self, size: usize) -> io::Result<()> {
        self.skip(size.saturating_sub(self.read))?;
        io::copy(&mut (&mut self.bytes).take(1), &mut io::sink())?;
        Ok(())
    }

    /// A data element: its type and its bytes, at most `limit` of them.
    fn element(&mut self, limit: usize) -> io::Result<(u32, Vec<u8>)> {
        let first = self.u32()?;
        // Up to four bytes can be stored inside the tag; the upper half of its first word then holds their
        // number.
        let packed = (first >> 16) as usize;
        let (kind, size, room) = if packed > 0 {
            (first & 0xffff, packed, 4)
        } else {
            let size = self.u32()? as usize;
            (first, size, size.saturating_add(7) / 8 * 8)
        };
        if size > limit.min(room) {
            return Err(fault(format!("an element of {size} bytes where {limit} fit")));
        }
        // An array grows as its bytes arrive, whatever the tag claims.
        let mut bytes = Vec::new();
        (&mut self.bytes).take(size as u64).read_to_end(&mut bytes)?;
        self.read += bytes.len();
        if bytes.len() < size {
            return Err(fault(format!("{} of {size} bytes", bytes.len())));
        }
        // The last element's padding may be missing; reading a next element would fail.
        self.skip(room - size)?;
        Ok((kind, bytes))
    }

    /// The tag of a matrix: the size of what follows.
    fn matrix_tag(&mut self) -> io::Result<usize> {
        let (kind, size) = (self.u32()?, self.u32()?);
        if kind != MATRIX {
            return Err(fault(format!("an element of type {kind} inside another one")));
        }
        Ok(size as usize)
    }

    fn head(&mut self) -> io::Result<Head> {
        let (_, bytes) = self.element(8)?;
        let flags = self.words(&bytes).next().ok_or_else(|| fault("no array flags"))?;
        let class = (flags & 0xff) as u8;
        let mut shape = Vec::new();
        if class != OPAQUE_CLASS {
            let (_, bytes) = self.element(4 * 64)?;
            shape = self.words(&bytes).map(|size| size as usize).collect();
            if shape.len() < 2 || shape.iter().any(|&size| size > i32::MAX as usize) {
                return Err(fault(format!("array sizes {shape:?}")));
            }
        }
        let (_, bytes) = self.element(MAX_NAME_BYTES)?;
        let name = String::from_utf8_lossy(&bytes).escape_debug().to_string();
        Ok(Head { class, flags, shape, name })
    }

    fn words<'b>(&self, bytes: &'b [u8]) -> impl Iterator<Item = u32> + use<'b, R> {
        let order = self.order;
        bytes.as_chunks().0.iter().map(move |&chunk| order.u32(chunk))
    }

    /// The value that follows a head. Arrays and cells that nobody asked for are not read.
    fn value(&mut self, head: &Head, is_wanted: bool, depth: usize) -> io::Result<Value> {
        let is_complex = head.flags & COMPLEX_FLAG != 0;
        match head.class {
            STRUCT_CLASS if head.shape.iter().all(|&size| size == 1) => self.fields(depth).map(Value::Struct),
            CELL_CLASS if is_wanted => {
                self.cells(count(&head.shape).map_err(fault)?, depth).map(Value::Cells)
            }
            TEXT_CLASS if is_wanted => Ok(Value::Text(text(&self.array(head)?.values))),
            DOUBLE_CLASS..=15 if is_wanted && !is_complex => {
                let array = self.array(head)?;
                let is_logical = head.flags & LOGICAL_FLAG != 0;
                Ok(if is_logical { Value::Logical(array) } else { Value::Real(array) })
            }
            _ => Ok(Value::Other(head.kind())),
        }
    }

    fn array(&mut self, head: &Head) -> io::Result<Array> {
        let count = count(&head.shape).map_err(fault)?;
        self.budget.take(count, 8).map_err(fault)?;
        let (kind, bytes) = self.element(count * 8)?;
        let values = stored(kind).and_then(|stored| numbers(stored, self.order, &bytes));
        let values = values.ok_or_else(|| fault(format!("values of type {kind}")))?;
        // Text in UTF-8 may have fewer characters than bytes; only what it says counts.
        if values.len() != count && head.class != TEXT_CLASS {
            return Err(fault(format!("{} values for an array of {count}", values.len())));
        }
        Ok(Array { shape: head.shape.clone(), values })
    }

    /// The values of a cell array.
    fn cells(&mut self, count: usize, depth: usize) -> io::Result<Vec<Value>> {
        let mut cells = Vec::new();
        for _ in 0..count {
            cells.push(self.nested(true, depth + 1)?);
        }
        Ok(cells)
    }

    /// The fields of a struct.
    fn fields(&mut self, depth: usize) -> io::Result<Fields> {
        let (_, bytes) = self.element(4)?;
        let width = self.words(&bytes).next().unwrap_or(0) as usize;
        let (_, names) = self.element(1 << 20)?;
        if width == 0 || width > MAX_NAME_BYTES {
            return Err(fault(format!("field names of {width} bytes")));
        }
        let mut fields = Fields::new();
        for name in names.chunks(width) {
            let name = name.split(|&b| b == 0).next().unwrap_or_default();
            let name = String::from_utf8_lossy(name).escape_debug().to_string();
            let is_wanted = self.wanted.contains(&name.as_str());
            let value = self.nested(is_wanted, depth + 1)?;
            fields.insert(name, value);
        }
        Ok(fields)
    }

    /// A matrix in a cell or field.
    fn nested(&mut self, is_wanted: bool, depth: usize) -> io::Result<Value> {
        if depth > MAX_DEPTH {
            return Err(fault(format!("structs and cells more than {MAX_DEPTH} deep")));
        }
        self.budget.take(1, VALUE_BYTES).map_err(fault)?;
        let size = self.matrix_tag()?;
        if size == 0 {
            return Ok(Value::Real(Array { shape: vec![0, 0], values: Vec::new() }));
        }
        let end = self.read.saturating_add(size);
        let head = self.head()?;
        let value = self.value(&head, is_wanted, depth)?;
        if self.read > end {
            return Err(fault(format!("a field or cell of {size} bytes that holds more")));
        }
        self.skip(end - self.read)?;
        match self.read == end {
            true => Ok(value),
            false => Err(fault("an early end")),
        }
    }
}

/// How numbers of a type are stored, characters included. Writers store whole doubles as the smallest integer
/// type.
fn stored(kind: u32) -> Option<Stored> {
    Some(match kind {
        1 => Stored::I8,
        2 | 16 => Stored::U8,
        3 => Stored::I16,
        4 | 17 => Stored::U16,
        5 => Stored::I32,
        6 => Stored::U32,
        7 => Stored::F32,
        9 => Stored::F64,
        12 => Stored::I64,
        13 => Stored::U64,
        _ => return None,
    })
}

/// Writes arrays of doubles and texts, uncompressed and little-endian; equal values give equal bytes.
pub(crate) fn write(file: &mut dyn Write, variables: &[(&str, Value)]) -> io::Result<()> {
    let text = concat!("MATLAB 5.0 MAT-file, written by lumenmesh ", env!("CARGO_PKG_VERSION"));
    write!(file, "{text:<116}")?;
    file.write_all(&[0; 8])?;
    file.write_all(&[0, 1, b'I', b'M'])?;
    for (name, value) in variables {
        match value {
            Value::Real(Array { shape, values }) => {
                let values = values.iter().map(|value| value.to_le_bytes());
                write_variable(file, name, DOUBLE_CLASS, shape, (9, values))?;
            }
            Value::Text(text) => {
                let units: Vec<u16> = text.encode_utf16().collect();
                let values = units.iter().map(|unit| unit.to_le_bytes());
                write_variable(file, name, TEXT_CLASS, &[1, units.len()], (4, values))?;
            }
            other => return Err(fault(format!("{name} is {}, which is not written", other.kind()))),
        }
    }
    Ok(())
}

/// Writes a variable whose values are stored as a type of numbers.
fn write_variable<const BYTES: usize>(
    file: &mut dyn Write,
    name: &str,
    class: u8,
    shape: &[usize],
    (kind, values): (u32, impl ExactSizeIterator<Item = [u8; BYTES]>),
) -> io::Result<()> {
    let mut head = Vec::new();
    push_element(&mut head, 6, &[u32::from(class).to_le_bytes(), [0; 4]].concat())?;
    let shape: Vec<u8> = shape.iter().flat_map(|&size| (size as u32).to_le_bytes()).collect();
    push_element(&mut head, 5, &shape)?;
    push_element(&mut head, 1, name.as_bytes())?;
    let size = |bytes: usize| {
        let too_large = || fault(format!("{name} is larger than a MAT-file of version 5 can hold"));
        u32::try_from(bytes).ok().filter(|&n| n <= i32::MAX as u32).ok_or_else(too_large)
    };
    let bytes = values.len() * BYTES;
    let padding = bytes.next_multiple_of(8) - bytes;
    file.write_all(&MATRIX.to_le_bytes())?;
    file.write_all(&size(head.len() + 8 + bytes + padding)?.to_le_bytes())?;
    file.write_all(&head)?;
    file.write_all(&kind.to_le_bytes())?;
    file.write_all(&size(bytes)?.to_le_bytes())?;
    for value in values {
        file.write_all(&value)?;
    }
    file.write_all(&[0; 8][..padding])
}

fn push_element(to: &mut Vec<u8>, kind: u32, bytes: &[u8]) -> io::Result<()> {
    to.write_all(&kind.to_le_bytes())?;
    to.write_all(&(bytes.len() as u32).to_le_bytes())?;
    to.write_all(bytes)?;
    to.resize(to.len().next_multiple_of(8), 0);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn written() -> Vec<u8> {
        let counted = |shape: &[usize]| {
            let n: usize = shape.iter().product();
            Value::Real(Array { shape: shape.to_vec(), values: (0..n).map(|i| i as f64 / 7.0).collect() })
        };
        let mut bytes = Vec::new();
        write(&mut bytes, &[("a", counted(&[3, 3, 4])), ("longer_name", counted(&[5, 2]))]).unwrap();
        bytes
    }

    /// The same variables, each one inside a deflate stream as `-v7` stores them.
    fn compressed() -> Vec<u8> {
        let plain = written();
        let (header, mut rest) = plain.split_at(HEADER_BYTES);
        let mut bytes = header.to_vec();
        while !rest.is_empty() {
            let size = 8 + u32::from_le_bytes(rest[4..8].try_into().unwrap()) as usize;
            let mut stream = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
            stream.write_all(&rest[..size]).unwrap();
            let stream = stream.finish().unwrap();
            bytes.extend(COMPRESSED.to_le_bytes());
            bytes.extend((stream.len() as u32).to_le_bytes());
            bytes.extend(stream);
            rest = &rest[size..];
        }
        bytes
    }

    fn read_bytes(bytes: &[u8]) -> Result<Fields> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        super::super::read(file.path(), &["a", "longer_name"])
    }

    #[test]
    fn plain_and_compressed_files_hold_the_same() {
        let plain = read_bytes(&written()).unwrap();
        assert_eq!(plain.len(), 2);
        assert_eq!(plain, read_bytes(&compressed()).unwrap());
        let Value::Real(a) = &plain["a"] else { panic!("a is real") };
        assert_eq!((a.shape_text().as_str(), a.values[35]), ("3x3x4", 5.0));
    }

    #[test]
    fn a_file_cut_anywhere_is_an_error_or_lacks_whole_variables() {
        for bytes in [written(), compressed()] {
            for length in 0..bytes.len() {
                if let Ok(variables) = read_bytes(&bytes[..length]) {
                    assert!(variables.len() < 2, "cut at {length}");
                }
            }
        }
    }

    #[test]
    fn changed_bytes_never_panic() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut refused = 0;
        for bytes in [written(), compressed()] {
            for _ in 0..3000 {
                let mut bytes = bytes.clone();
                for _ in 0..random.random_range(1..4) {
                    let at = random.random_range(0..bytes.len());
                    bytes[at] = random.random();
                }
                refused += usize::from(read_bytes(&bytes).is_err());
            }
        }
        assert!(refused > 2000, "{refused}");
    }

    #[test]
    fn big_endian_files_hold_the_same() {
        let array = Array { shape: vec![2, 2, 2], values: (0..8).map(|i| f64::from(i) / 7.0).collect() };
        let mut bytes = Vec::new();
        write(&mut bytes, &[("a", Value::Real(array.clone()))]).unwrap();
        bytes[124..HEADER_BYTES].copy_from_slice(&[1, 0, b'M', b'I']);
        // Tags, flags and sizes are words of 4 bytes, the values of 8; the name between them has no order.
        let (head, values) = bytes[HEADER_BYTES..].split_at_mut(72);
        let (before_name, rest) = head.split_at_mut(56);
        before_name.chunks_mut(4).chain(rest[8..].chunks_mut(4)).for_each(<[u8]>::reverse);
        values.chunks_mut(8).for_each(<[u8]>::reverse);
        assert_eq!(read_bytes(&bytes).unwrap()["a"], Value::Real(array));
    }

    #[test]
    fn a_claim_of_endless_data_costs_nothing() {
        let mut bytes = written();
        let tag = HEADER_BYTES + 4;
        // The variable, its sizes and its values all claim as much as they can.
        bytes[tag..tag + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(read_bytes(&bytes).unwrap_err().to_string().contains("the file is cut short"));
        let mut bytes = written();
        for size in 0..3 {
            let at = HEADER_BYTES + 8 + 16 + 8 + 4 * size;
            bytes[at..at + 4].copy_from_slice(&(i32::MAX as u32).to_le_bytes());
        }
        assert!(read_bytes(&bytes).unwrap_err().to_string().contains("a: found array sizes [2147483647,"));
    }

    #[test]
    fn a_damaged_deflate_stream_is_noticed_by_its_checksum() {
        let mut bytes = compressed();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        let message = read_bytes(&bytes).unwrap_err().to_string();
        assert!(message.contains("found corrupt deflate stream"), "{message}");
    }
}
