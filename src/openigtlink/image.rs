//! `IMAGE`: pixels, and where they lie.

use super::wire::{Reader, put_matrix, refused};
use crate::Result;
use crate::recording::{Image, PixelType};
use glam::{DMat4, DVec3};

/// An image or a volume of one number or more in each pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageContent {
    /// Pixels along i, j and k; i varies fastest.
    pub size: [u16; 3],
    /// Numbers in each pixel.
    pub components: u8,
    /// What the numbers are.
    pub kind: PixelType,
    /// Whether their bytes begin with the highest.
    pub big_endian: bool,
    /// Columns: the steps along i, j and k, mm, and the middle of the image, mm.
    pub matrix: [[f32; 4]; 3],
    /// The bytes of the pixels.
    pub pixels: Vec<u8>,
}

/// The protocol's numbers of the types of pixels.
const TYPES: [(u8, PixelType); 8] = [
    (2, PixelType::I8),
    (3, PixelType::U8),
    (4, PixelType::I16),
    (5, PixelType::U16),
    (6, PixelType::I32),
    (7, PixelType::U32),
    (10, PixelType::F32),
    (11, PixelType::F64),
];

impl ImageContent {
    /// Bytes that the pixels should have.
    fn stated_bytes(&self) -> usize {
        // 48 bits of pixels, 8 of components and 3 of bytes fit.
        let bytes = self.size.iter().map(|&n| u64::from(n)).product::<u64>()
            * u64::from(self.components)
            * self.kind.bytes() as u64;
        usize::try_from(bytes).unwrap_or(usize::MAX)
    }

    fn check(&self) -> Result<()> {
        if self.components == 0 || self.size.contains(&0) || self.stated_bytes() != self.pixels.len() {
            let [i, j, k] = self.size;
            let found = format!("{} bytes of pixels", self.pixels.len());
            let expected = format!(
                "{i} × {j} × {k} pixels of {} × {} bytes, each at least 1",
                self.components,
                self.kind.bytes()
            );
            return Err(refused("IMAGE", found, expected));
        }
        Ok(())
    }

    pub(super) fn decode(bytes: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(bytes);
        let _version = reader.u16()?;
        let components = reader.u8()?;
        let kind = reader.u8()?;
        let kind = TYPES
            .iter()
            .find(|(number, _)| *number == kind)
            .map(|(_, kind)| *kind)
            .ok_or_else(|| refused("type of the pixels of an IMAGE", kind, "2 to 7, 10 or 11"))?;
        let big_endian = match reader.u8()? {
            1 => true,
            2 => false,
            other => return Err(refused("byte order of an IMAGE", other, "1 or 2")),
        };
        let _coordinates = reader.u8()?;
        let mut three = || -> Result<[u16; 3]> { Ok([reader.u16()?, reader.u16()?, reader.u16()?]) };
        let size = three()?;
        let matrix = reader.matrix()?;
        let mut three = || -> Result<[u16; 3]> { Ok([reader.u16()?, reader.u16()?, reader.u16()?]) };
        let (part_start, part_size) = (three()?, three()?);
        if part_start != [0; 3] || part_size != size {
            let found = format!("pixels from {part_start:?}, {part_size:?} of {size:?}");
            return Err(refused("IMAGE", found, "all of the image"));
        }
        let mut image = Self { size, components, kind, big_endian, matrix, pixels: Vec::new() };
        if image.stated_bytes() == reader.rest().len() {
            image.pixels = reader.rest().to_vec();
        }
        image.check()?;
        Ok(image)
    }

    pub(super) fn encode(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.check()?;
        bytes.extend(1_u16.to_be_bytes());
        let order = if self.big_endian { 1 } else { 2 };
        // Coordinates as they come, which is what the protocol calls RAS.
        let kind = TYPES.iter().find(|(_, kind)| *kind == self.kind).map_or(0, |(number, _)| *number);
        bytes.extend([self.components, kind, order, 1]);
        bytes.extend(self.size.iter().flat_map(|n| n.to_be_bytes()));
        put_matrix(bytes, &self.matrix);
        bytes.extend([0; 6]);
        bytes.extend(self.size.iter().flat_map(|n| n.to_be_bytes()));
        bytes.extend(&self.pixels);
        Ok(())
    }

    /// The image as a plane, and where its pixels lie: the transform from pixels to the coordinates of the
    /// matrix, mm. The plane leaves out an axis along which there is one pixel, the last such.
    ///
    /// # Errors
    /// [`Error::Recording`](crate::Error::Recording) where it is a volume, or has more than one number in a
    /// pixel.
    pub fn plane(&self) -> Result<(Image, DMat4)> {
        self.check()?;
        let flat = (0..3).rev().find(|&axis| self.size[axis] == 1);
        let (Some(flat), 1) = (flat, self.components) else {
            let [i, j, k] = self.size;
            let found = format!("{i} × {j} × {k} pixels of {} numbers", self.components);
            return Err(refused("IMAGE", found, "one plane of one number in each pixel"));
        };
        let axes: Vec<usize> = (0..3).filter(|&axis| axis != flat).collect();
        let [width, height] = [0, 1].map(|k| usize::from(self.size[axes[k]]));
        let column = |c: usize| DVec3::from_array(std::array::from_fn(|row| f64::from(self.matrix[row][c])));
        let (x, y) = (column(axes[0]), column(axes[1]));
        let origin = column(3) - x * ((width - 1) as f64 / 2.0) - y * ((height - 1) as f64 / 2.0);
        let pixels = self.kind.numbers(&self.pixels, self.big_endian);
        let matrix =
            DMat4::from_cols(x.extend(0.0), y.extend(0.0), column(flat).extend(0.0), origin.extend(1.0));
        Ok((Image::new(width, height, pixels)?, matrix))
    }
}
