//! Numbers and texts as they are sent.

use crate::{Error, Result};

/// The number of UTF-8 in the registry of character sets.
pub(super) const UTF_8: u16 = 106;

/// An error about a message.
pub(super) fn refused(field: &'static str, found: impl ToString, expected: impl ToString) -> Error {
    Error::Recording { field, found: found.to_string(), expected: expected.to_string() }
}

/// Reads from the front of some bytes.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// So many bytes.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or_else(|| {
            refused(
                "OpenIGTLink message",
                format!("{} bytes left", self.bytes.len()),
                format!("{count} bytes"),
            )
        })?;
        self.bytes = rest;
        Ok(taken)
    }

    /// What is left.
    pub fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    pub fn u8(&mut self) -> Result<u8> {
        self.array().map(u8::from_be_bytes)
    }

    pub fn u16(&mut self) -> Result<u16> {
        self.array().map(u16::from_be_bytes)
    }

    pub fn u32(&mut self) -> Result<u32> {
        self.array().map(u32::from_be_bytes)
    }

    pub fn u64(&mut self) -> Result<u64> {
        self.array().map(u64::from_be_bytes)
    }

    pub fn f32(&mut self) -> Result<f32> {
        self.array().map(f32::from_be_bytes)
    }

    pub fn point(&mut self) -> Result<[f32; 3]> {
        Ok([self.f32()?, self.f32()?, self.f32()?])
    }

    /// Rows and columns of a transform, sent column by column.
    pub fn matrix(&mut self) -> Result<[[f32; 4]; 3]> {
        let mut matrix = [[0.0; 4]; 3];
        for column in 0..4 {
            for row in &mut matrix {
                row[column] = self.f32()?;
            }
        }
        Ok(matrix)
    }

    /// A text in a field of fixed length, up to the first zero.
    pub fn name(&mut self, length: usize) -> Result<String> {
        self.take(length).map(text)
    }
}

/// A text up to the first zero. What is no UTF-8 is replaced.
pub(super) fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// The start of a text that has at most so many bytes, cut between characters.
pub(super) fn cut(text: &str, bytes: usize) -> &str {
    let end = (0..=bytes.min(text.len())).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
    &text[..end]
}

/// A text in a field of fixed length, cut between characters and filled with zeros.
pub(super) fn put_name(bytes: &mut Vec<u8>, name: &str, length: usize) {
    let name = cut(name, length);
    bytes.extend(name.bytes());
    bytes.resize(bytes.len() + length - name.len(), 0);
}

/// A transform's rows and columns, column by column.
pub(super) fn put_matrix(bytes: &mut Vec<u8>, matrix: &[[f32; 4]; 3]) {
    for column in 0..4 {
        for row in matrix {
            bytes.extend(row[column].to_be_bytes());
        }
    }
}
