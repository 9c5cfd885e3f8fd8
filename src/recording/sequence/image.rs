//! The images of a sequence.

use crate::{Error, Result};
use flate2::read::{MultiGzDecoder, ZlibDecoder};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Pixels of an image, at most.
const MAX_PIXELS: usize = 1 << 26;
/// Bytes of all images of a file that has the frames' axis first, which is read as a whole.
const MAX_WHOLE: usize = 1 << 31;

/// How the images of a file are stored.
#[derive(Debug, Clone)]
pub(super) struct Images {
    pub width: usize,
    pub height: usize,
    pub count: usize,
    pub channels: usize,
    /// Whether the frame varies fastest, as Slicer 5.8 and older write it.
    pub frames_first: bool,
    /// `None`: a type that is not known.
    pub pixel: Option<PixelType>,
    pub pixel_name: String,
    pub big_endian: bool,
    pub encoding: Encoding,
    /// What the file says about the directions of rows and columns, such as `MF`.
    pub orientation: String,
    /// The file with the data, and where they begin.
    pub data: PathBuf,
    pub offset: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Encoding {
    Raw,
    Zlib,
    Gzip,
    /// One that is not read, by its name.
    Other(String),
}

/// The numbers of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelType {
    /// 8 bits.
    U8,
    /// 8 bits, signed.
    I8,
    /// 16 bits.
    U16,
    /// 16 bits, signed.
    I16,
    /// 32 bits.
    U32,
    /// 32 bits, signed.
    I32,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl PixelType {
    pub(super) fn of_meta_image(name: &str) -> Option<Self> {
        Some(match name {
            "MET_UCHAR" => Self::U8,
            "MET_CHAR" => Self::I8,
            "MET_USHORT" => Self::U16,
            "MET_SHORT" => Self::I16,
            "MET_UINT" => Self::U32,
            "MET_INT" => Self::I32,
            "MET_FLOAT" => Self::F32,
            "MET_DOUBLE" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn of_nrrd(name: &str) -> Option<Self> {
        Some(match name.to_lowercase().as_str() {
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => Self::U8,
            "signed char" | "int8" | "int8_t" => Self::I8,
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Self::U16,
            "short" | "short int" | "signed short" | "int16" | "int16_t" => Self::I16,
            "uint" | "unsigned int" | "uint32" | "uint32_t" => Self::U32,
            "int" | "signed int" | "int32" | "int32_t" => Self::I32,
            "float" => Self::F32,
            "double" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The numbers that these bytes hold, in f32; bytes at the end that are none are left out.
    pub fn numbers(self, bytes: &[u8], big_endian: bool) -> Vec<f32> {
        bytes.chunks_exact(self.bytes()).map(|bytes| self.number(bytes, big_endian)).collect()
    }

    /// The number in so many bytes as [`bytes`](Self::bytes) says, in f32.
    fn number(self, bytes: &[u8], big_endian: bool) -> f32 {
        let mut b = [0_u8; 8];
        let size = bytes.len().min(8);
        b[..size].copy_from_slice(&bytes[..size]);
        if big_endian {
            b[..size].reverse();
        }
        match self {
            Self::U8 => f32::from(b[0]),
            Self::I8 => f32::from(b[0] as i8),
            Self::U16 => f32::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I16 => f32::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U32 => u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32,
            Self::I32 => i32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32,
            Self::F32 => f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            Self::F64 => f64::from_le_bytes(b) as f32,
        }
    }
}

/// An image of one channel, in the order of the file: rows one after the other.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Image {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The pixels, row by row; whole numbers above 2²⁴ are rounded.
    pub pixels: Vec<f32>,
}

impl Image {
    /// An image of so many pixels a row, which the pixels fill.
    ///
    /// # Errors
    /// [`Error::Recording`] where they do not, or are none.
    pub fn new(width: usize, height: usize, pixels: Vec<f32>) -> Result<Self> {
        if width.checked_mul(height) != Some(pixels.len()) || pixels.is_empty() {
            return Err(Error::Recording {
                field: "image",
                found: format!("{} pixels", pixels.len()),
                expected: format!("{width} × {height}, at least 1"),
            });
        }
        Ok(Self { width, height, pixels })
    }
}

impl Images {
    /// One image after the other.
    pub fn reader(&self, header: &Path) -> Result<impl Iterator<Item = Result<Image>> + use<>> {
        let refused =
            |field: &str, found: String, expected: &str| Err(Error::input(header, field, found, expected));
        let Some(pixel) = self.pixel else {
            return refused("type of pixels", self.pixel_name.clone(), "a number of 8 to 64 bits");
        };
        if let Encoding::Other(name) = &self.encoding {
            return refused("encoding", name.clone(), "raw, zlib or gzip");
        }
        if self.channels != 1 {
            return refused("channels of images", self.channels.to_string(), "1");
        }
        let pixels = self.width.checked_mul(self.height).filter(|&n| n <= MAX_PIXELS);
        let Some(pixels) = pixels else {
            let found = format!("{} × {} pixels", self.width, self.height);
            return refused("images", found, "at most 2^26 pixels");
        };
        let bytes = pixels * pixel.bytes();
        let failed = |source| Error::read(&self.data, source);
        let mut file = File::open(&self.data).map_err(failed)?;
        file.seek(SeekFrom::Start(self.offset)).map_err(failed)?;
        let file = BufReader::with_capacity(1 << 16, file);
        let mut stream: Box<dyn Read> = match self.encoding {
            Encoding::Zlib => Box::new(ZlibDecoder::new(file)),
            Encoding::Gzip => Box::new(MultiGzDecoder::new(file)),
            _ => Box::new(file),
        };
        let whole = match self.frames_first {
            false => None,
            true => {
                let all = bytes.checked_mul(self.count).filter(|&n| n <= MAX_WHOLE);
                let Some(all) = all else {
                    let found = format!("{} of {bytes} bytes, with the frames' axis first", self.count);
                    return refused("images", found, "at most 2^31 bytes in all");
                };
                Some(exactly(&mut stream, all)?)
            }
        };
        let (width, height, count, big_endian) = (self.width, self.height, self.count, self.big_endian);
        let mut stopped = false;
        Ok((0..count).map_while(move |k| {
            if stopped {
                return None;
            }
            let numbers = |bytes: &mut dyn Iterator<Item = &[u8]>| {
                let pixels = bytes.map(|bytes| pixel.number(bytes, big_endian)).collect();
                Image { width, height, pixels }
            };
            Some(match &whole {
                Some(whole) => Ok(numbers(&mut whole.chunks_exact(pixel.bytes()).skip(k).step_by(count))),
                None => {
                    let read = exactly(&mut stream, bytes);
                    stopped = read.is_err();
                    read.map(|bytes| numbers(&mut bytes.chunks_exact(pixel.bytes())))
                }
            })
        }))
    }
}

/// So many bytes. What is allocated grows with what is there, not with what the header promises.
fn exactly(stream: &mut dyn Read, count: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = stream.take(count as u64).read_to_end(&mut bytes);
    let found = match read {
        Ok(_) if bytes.len() == count => return Ok(bytes),
        Ok(read) => format!("{read} bytes"),
        Err(error) => format!("{} bytes, then: {error}", bytes.len()),
    };
    Err(Error::Recording { field: "pixels", found, expected: format!("{count} bytes") })
}
