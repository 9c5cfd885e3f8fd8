//! Reader and writer of MAT-files of level 5 (MATLAB versions 5 to 7) with named arrays of real numbers.
//!
//! Own code, because neither crate for it is safe on bad input: matrw 0.1.4 panics on damaged deflate streams
//! (and refuses SciPy's header), matfile 0.5.0 reads a truncated file as one with fewer variables and prints to stdout.
//! Layout: *MAT-File Format*, The MathWorks, chapter 1 ("MAT-File Level 5"). Memory stays in proportion to the file: an
//! array is allocated only as its bytes arrive, and deflate expands at most 1032 times.

use crate::{Error, Result};
use flate2::read::ZlibDecoder;
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::path::Path;

/// A real array, its values in column-major order.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Array {
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

/// The value of a variable.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Variable {
    Real(Array),
    /// Anything but a full array of real numbers, described in words.
    Other(&'static str),
}

const EXPECTED: &str = "a whole MAT-file of version 5 to 7";
const HEADER_BYTES: usize = 128;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
const DOUBLE_CLASS: u8 = 6;
const OPAQUE_CLASS: u8 = 17;
const COMPLEX_FLAG: u32 = 0x0800;
const LOGICAL_FLAG: u32 = 0x0200;

/// Reads the variables with the given names, as far as the file has them.
///
/// # Errors
/// Where the file cannot be read, is no MAT-file of level 5, or is damaged.
pub(super) fn read(path: &Path, wanted: &[&str]) -> Result<BTreeMap<String, Variable>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    let order = byte_order(&bytes).map_err(|found| Error::input(path, "format", found, FORMATS))?;
    let mut variables = BTreeMap::new();
    let mut rest = bytes.get(HEADER_BYTES..).unwrap_or_default();
    let mut position = 1;
    while !rest.is_empty() {
        let name = format!("variable {position}");
        let damaged = |name: &str, e: io::Error| Error::input(path, name, e, EXPECTED);
        let mut tag = Source { bytes: rest, order };
        let kind = tag.u32().map_err(|e| damaged(&name, e))?;
        let size = tag.u32().map_err(|e| damaged(&name, e))? as usize;
        let whole = tag.bytes.get(..size);
        let body = whole.unwrap_or(tag.bytes);
        let content: Box<dyn Read + '_> = match kind {
            MATRIX => Box::new(body),
            COMPRESSED => Box::new(ZlibDecoder::new(body)),
            _ => return Err(damaged(&name, fault(format!("an element of type {kind}")))),
        };
        let mut source = Source { bytes: content, order };
        let head = source.head(kind == COMPRESSED).map_err(|e| damaged(&name, e))?;
        if whole.is_none() {
            let found = format!("{} of {size} bytes (the file is cut short)", body.len());
            return Err(Error::input(path, head.name, found, EXPECTED));
        }
        if wanted.contains(&head.name.as_str()) {
            let variable = source.variable(&head).map_err(|e| damaged(&head.name, e))?;
            variables.insert(head.name, variable);
        }
        rest = tag.bytes.get(size..).unwrap_or_default();
        position += 1;
    }
    Ok(variables)
}

const FORMATS: &str = "a MAT-file of version 5 to 7 (in MATLAB and Octave: save with -v7)";

#[derive(Debug, Clone, Copy)]
enum ByteOrder {
    Little,
    Big,
}

/// The file's byte order, or what the file is instead of a MAT-file of level 5.
fn byte_order(bytes: &[u8]) -> Result<ByteOrder, &'static str> {
    let hdf5 = b"\x89HDF\r\n\x1a\n";
    if bytes.starts_with(b"MATLAB 7.3") || bytes.starts_with(hdf5) {
        return Err("version 7.3 (HDF5)");
    }
    if bytes.starts_with(b"# Created by Octave") || bytes.starts_with(b"Octave-1") {
        return Err("a file of Octave's own format");
    }
    match bytes.get(124..HEADER_BYTES) {
        _ if bytes.is_empty() => Err("an empty file"),
        Some([0, 1, b'I', b'M']) => Ok(ByteOrder::Little),
        Some([1, 0, b'M', b'I']) => Ok(ByteOrder::Big),
        _ => Err("a file without the header of one"),
    }
}

fn fault(found: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, found.into())
}

/// The header of a variable.
struct Head {
    class: u8,
    flags: u32,
    shape: Vec<usize>,
    name: String,
}

struct Source<R> {
    bytes: R,
    order: ByteOrder,
}

impl<R: Read> Source<R> {
    fn array<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        match self.bytes.read_exact(&mut bytes) {
            Ok(()) => Ok(bytes),
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => Err(fault("an early end")),
            Err(e) => Err(e),
        }
    }

    fn u32(&mut self) -> io::Result<u32> {
        let bytes = self.array()?;
        Ok(match self.order {
            ByteOrder::Little => u32::from_le_bytes(bytes),
            ByteOrder::Big => u32::from_be_bytes(bytes),
        })
    }

    /// A data element: its type and its bytes, at most `limit` of them.
    fn element(&mut self, limit: usize) -> io::Result<(u32, Vec<u8>)> {
        let first = self.u32()?;
        // Up to four bytes can be stored inside the tag; the upper half of its first word then holds their number.
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
        let mut bytes = Vec::new();
        (&mut self.bytes).take(size as u64).read_to_end(&mut bytes)?;
        if bytes.len() < size {
            return Err(fault(format!("{} of {size} bytes", bytes.len())));
        }
        // The last element's padding may be missing; reading a next element would fail.
        io::copy(&mut (&mut self.bytes).take((room - size) as u64), &mut io::sink())?;
        Ok((kind, bytes))
    }

    fn head(&mut self, tagged: bool) -> io::Result<Head> {
        if tagged {
            let (kind, _size) = (self.u32()?, self.u32()?);
            if kind != MATRIX {
                return Err(fault(format!("a compressed element of type {kind}")));
            }
        }
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
        let (_, bytes) = self.element(1 << 12)?;
        let name = String::from_utf8_lossy(&bytes).into_owned();
        Ok(Head { class, flags, shape, name })
    }

    fn words<'a>(&self, bytes: &'a [u8]) -> impl Iterator<Item = u32> + use<'a, R> {
        let order = self.order;
        bytes.as_chunks().0.iter().map(move |&chunk| match order {
            ByteOrder::Little => u32::from_le_bytes(chunk),
            ByteOrder::Big => u32::from_be_bytes(chunk),
        })
    }

    fn variable(&mut self, head: &Head) -> io::Result<Variable> {
        let other = match head.class {
            _ if head.flags & COMPLEX_FLAG != 0 => "complex numbers",
            _ if head.flags & LOGICAL_FLAG != 0 => "logical values",
            1 => "a cell array",
            2 => "a struct",
            4 => "text",
            5 => "a sparse array",
            DOUBLE_CLASS..=15 => "",
            _ => "an object",
        };
        if !other.is_empty() {
            return Ok(Variable::Other(other));
        }
        let count = head.shape.iter().try_fold(1_usize, |n, &size| n.checked_mul(size));
        let count = count.filter(|n| n.checked_mul(8).is_some());
        let count = count.ok_or_else(|| fault(format!("array sizes {:?}", head.shape)))?;
        let (kind, bytes) = self.element(count * 8)?;
        let values =
            numbers(kind, self.order, &bytes).ok_or_else(|| fault(format!("values of type {kind}")))?;
        if values.len() != count {
            return Err(fault(format!("{} values for an array of {count}", values.len())));
        }
        // Reading on to the end lets the decompression compare its checksum.
        io::copy(&mut self.bytes, &mut io::sink())?;
        Ok(Variable::Real(Array { shape: head.shape.clone(), values }))
    }
}

/// Numbers of any stored type: writers store whole doubles as the smallest integer type.
fn numbers(kind: u32, order: ByteOrder, bytes: &[u8]) -> Option<Vec<f64>> {
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
    match kind {
        1 => convert!(i8),
        2 => convert!(u8),
        3 => convert!(i16),
        4 => convert!(u16),
        5 => convert!(i32),
        6 => convert!(u32),
        7 => convert!(f32),
        9 => convert!(f64),
        12 => convert!(i64),
        13 => convert!(u64),
        _ => None,
    }
}

/// Writes arrays of doubles, uncompressed and little-endian; equal arrays give equal bytes.
pub(super) fn write(file: &mut dyn Write, variables: &[(&str, Array)]) -> io::Result<()> {
    let text = concat!("MATLAB 5.0 MAT-file, written by lumenmesh ", env!("CARGO_PKG_VERSION"));
    write!(file, "{text:<116}")?;
    file.write_all(&[0; 8])?;
    file.write_all(&[0, 1, b'I', b'M'])?;
    for (name, array) in variables {
        let mut head = Vec::new();
        push_element(&mut head, 6, &[u32::from(DOUBLE_CLASS).to_le_bytes(), [0; 4]].concat())?;
        let shape: Vec<u8> = array.shape.iter().flat_map(|&size| (size as u32).to_le_bytes()).collect();
        push_element(&mut head, 5, &shape)?;
        push_element(&mut head, 1, name.as_bytes())?;
        let size = |bytes: usize| {
            let too_large = || fault(format!("{name} is larger than a MAT-file of version 5 can hold"));
            u32::try_from(bytes).ok().filter(|&n| n <= i32::MAX as u32).ok_or_else(too_large)
        };
        let value_bytes = array.values.len() * 8;
        file.write_all(&MATRIX.to_le_bytes())?;
        file.write_all(&size(head.len() + 8 + value_bytes)?.to_le_bytes())?;
        file.write_all(&head)?;
        file.write_all(&9_u32.to_le_bytes())?;
        file.write_all(&size(value_bytes)?.to_le_bytes())?;
        for value in &array.values {
            file.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
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
            Array { shape: shape.to_vec(), values: (0..n).map(|i| i as f64 / 7.0).collect() }
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

    fn read_bytes(bytes: &[u8]) -> Result<BTreeMap<String, Variable>> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read(file.path(), &["a", "longer_name"])
    }

    #[test]
    fn plain_and_compressed_files_hold_the_same() {
        let plain = read_bytes(&written()).unwrap();
        assert_eq!(plain.len(), 2);
        assert_eq!(plain, read_bytes(&compressed()).unwrap());
        let Variable::Real(a) = &plain["a"] else { panic!("a is real") };
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
        write(&mut bytes, &[("a", array.clone())]).unwrap();
        bytes[124..HEADER_BYTES].copy_from_slice(&[1, 0, b'M', b'I']);
        // Tags, flags and sizes are words of 4 bytes, the values of 8; the name between them has no order.
        let (head, values) = bytes[HEADER_BYTES..].split_at_mut(72);
        let (before_name, rest) = head.split_at_mut(56);
        before_name.chunks_mut(4).chain(rest[8..].chunks_mut(4)).for_each(<[u8]>::reverse);
        values.chunks_mut(8).for_each(<[u8]>::reverse);
        assert_eq!(read_bytes(&bytes).unwrap()["a"], Variable::Real(array));
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
