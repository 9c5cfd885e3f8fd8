//! `POLYDATA`: points, cells and values at the points.

use super::refused;
use super::wire::{Reader, text};
use crate::Result;

/// A mesh or lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PolyData {
    /// Points, mm.
    pub points_mm: Vec<[f32; 3]>,
    /// Points that are cells of their own, by index.
    pub vertices: Vec<Vec<u32>>,
    /// Lines, each as indices of its points.
    pub lines: Vec<Vec<u32>>,
    /// Polygons.
    pub polygons: Vec<Vec<u32>>,
    /// Triangle strips: cells of which a receiver has to make far fewer than polygons.
    pub strips: Vec<Vec<u32>>,
    /// One value for each point, by name.
    pub scalars: Vec<(String, Vec<f32>)>,
}

/// Bytes before the points: their count, and count and bytes of each kind of cells, and the count of attributes.
const COUNTS: usize = 40;

impl PolyData {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let word = |bytes: &mut Vec<u8>, value: usize| bytes.extend((value as u32).to_be_bytes());
        word(&mut bytes, self.points_mm.len());
        let kinds = [&self.vertices, &self.lines, &self.polygons, &self.strips];
        for cells in kinds {
            word(&mut bytes, cells.len());
            word(&mut bytes, cells.iter().map(|cell| 4 + 4 * cell.len()).sum());
        }
        word(&mut bytes, self.scalars.len());
        bytes.extend(self.points_mm.iter().flatten().flat_map(|x| x.to_be_bytes()));
        for cell in kinds.into_iter().flatten() {
            word(&mut bytes, cell.len());
            bytes.extend(cell.iter().flat_map(|index| index.to_be_bytes()));
        }
        for (_, values) in &self.scalars {
            // Scalars of one component.
            bytes.extend([0, 1]);
            word(&mut bytes, values.len());
        }
        let names = bytes.len();
        for (name, _) in &self.scalars {
            bytes.extend(name.bytes().chain([0]));
        }
        if (bytes.len() - names) % 2 == 1 {
            bytes.push(0);
        }
        bytes.extend(self.scalars.iter().flat_map(|(_, values)| values).flat_map(|x| x.to_be_bytes()));
        bytes
    }

    /// Reads points, cells and the scalars of one component that points have. Other attributes are passed over.
    pub(super) fn decode(bytes: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(bytes);
        let points = reader.u32()? as usize;
        let mut kinds = [(0, 0); 4];
        for kind in &mut kinds {
            *kind = (reader.u32()? as usize, reader.u32()? as usize);
        }
        let attributes = reader.u32()? as usize;
        let cell_bytes: usize = kinds.iter().map(|(_, bytes)| bytes).sum();
        // Six bytes and a name's end are the least that an attribute takes.
        let least = (|| {
            COUNTS
                .checked_add(points.checked_mul(12)?)?
                .checked_add(cell_bytes)?
                .checked_add(attributes.checked_mul(7)?)
        })();
        if least.is_none_or(|least| least > bytes.len()) {
            let found = format!("{points} points, {cell_bytes} bytes of cells and {attributes} attributes");
            return Err(refused("POLYDATA", found, &format!("what {} bytes hold", bytes.len())));
        }
        let mut data = Self::default();
        data.points_mm.reserve_exact(points);
        for _ in 0..points {
            data.points_mm.push([reader.f32()?, reader.f32()?, reader.f32()?]);
        }
        let cells = [&mut data.vertices, &mut data.lines, &mut data.polygons, &mut data.strips];
        for (cells, (count, bytes)) in cells.into_iter().zip(kinds) {
            *cells = read_cells(reader.take(bytes)?, count, points)?;
        }
        let mut headers = Vec::with_capacity(attributes);
        for _ in 0..attributes {
            let (kind, components, count) = (reader.u8()?, reader.u8()?, reader.u32()? as usize);
            headers.push((kind, usize::from(components), count));
        }
        let mut names = Vec::with_capacity(attributes);
        let mut length = 0;
        for _ in 0..attributes {
            let Some(end) = reader.rest().iter().position(|&b| b == 0) else {
                return Err(refused("POLYDATA", "a name without an end", "a zero after each name"));
            };
            names.push(text(reader.take(end + 1)?));
            length += end + 1;
        }
        reader.take(length % 2)?;
        for ((kind, components, count), name) in headers.into_iter().zip(names) {
            let size = components.checked_mul(count).and_then(|n| n.checked_mul(4));
            let values = match size {
                Some(size) => reader.take(size)?,
                None => return Err(refused("POLYDATA", format!("{count} values of {name:?}"), "fewer")),
            };
            if kind != 0 || components != 1 {
                continue;
            }
            if count != points {
                let found = format!("{count} values of {name:?}");
                return Err(refused("POLYDATA", found, &format!("{points}, one for each point")));
            }
            let mut values = Reader::new(values);
            let values = (0..count).map(|_| values.f32()).collect::<Result<_>>()?;
            data.scalars.push((name, values));
        }
        Ok(data)
    }
}

/// So many cells, each the count of its points and their indices.
fn read_cells(bytes: &[u8], count: usize, points: usize) -> Result<Vec<Vec<u32>>> {
    if count.checked_mul(4).is_none_or(|least| least > bytes.len()) {
        return Err(refused(
            "POLYDATA",
            format!("{count} cells"),
            &format!("what {} bytes hold", bytes.len()),
        ));
    }
    let mut reader = Reader::new(bytes);
    let mut cells = Vec::with_capacity(count);
    for _ in 0..count {
        let length = reader.u32()? as usize;
        let size = length.saturating_mul(4);
        let mut indices = Reader::new(reader.take(size)?);
        let cell = (0..length).map(|_| indices.u32()).collect::<Result<Vec<u32>>>()?;
        if let Some(index) = cell.iter().find(|&&index| index as usize >= points) {
            return Err(refused("POLYDATA", format!("point {index}"), &format!("one below {points}")));
        }
        cells.push(cell);
    }
    match reader.rest().len() {
        0 => Ok(cells),
        more => Err(refused("POLYDATA", format!("{more} bytes after {count} cells"), "none")),
    }
}
