//! Numbers and texts as they are sent.

use super::refused;
use crate::Result;

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
            refused("OpenIGTLink message", format!("{} bytes left", self.bytes.len()), &count.to_string())
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

/// A text in a field of fixed length, cut between characters and filled with zeros.
pub(super) fn put_name(bytes: &mut Vec<u8>, name: &str, length: usize) {
    let end = (0..=length.min(name.len())).rev().find(|&end| name.is_char_boundary(end)).unwrap_or(0);
    bytes.extend(name[..end].bytes());
    bytes.resize(bytes.len() + length - end, 0);
}

/// A transform's rows and columns, column by column.
pub(super) fn put_matrix(bytes: &mut Vec<u8>, matrix: &[[f32; 4]; 3]) {
    for column in 0..4 {
        for row in matrix {
            bytes.extend(row[column].to_be_bytes());
        }
    }
}
