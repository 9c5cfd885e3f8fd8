//! The binary numbers of mesh files.

/// The type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Number {
    /// Its size in bytes.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The number that these bytes hold, as many as its size. Whole numbers beyond 2^53 are rounded.
    pub fn read(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut b = [0; 8];
        bytes.iter().zip(&mut b).for_each(|(from, to)| *to = *from);
        if big_endian {
            b[..self.size()].reverse();
        }
        let [b0, b1, b2, b3, ..] = b;
        match self {
            Self::I8 => i8::from_le_bytes([b0]).into(),
            Self::U8 => b0.into(),
            Self::I16 => i16::from_le_bytes([b0, b1]).into(),
            Self::U16 => u16::from_le_bytes([b0, b1]).into(),
            Self::I32 => i32::from_le_bytes([b0, b1, b2, b3]).into(),
            Self::U32 => u32::from_le_bytes([b0, b1, b2, b3]).into(),
            Self::I64 => i64::from_le_bytes(b) as f64,
            Self::U64 => u64::from_le_bytes(b) as f64,
            Self::F32 => f32::from_le_bytes([b0, b1, b2, b3]).into(),
            Self::F64 => f64::from_le_bytes(b),
        }
    }

    /// The numbers that these bytes hold one after the other.
    pub fn read_all(self, bytes: &[u8], big_endian: bool) -> Vec<f64> {
        bytes.chunks_exact(self.size()).map(|word| self.read(word, big_endian)).collect()
    }
}
