//! `POLYDATA`: points, cells and values at the points.

use super::strips::strips;
use super::wire::{Reader, cut, refused, text};
use crate::Result;
use crate::surface::Surface;

/// A mesh or lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PolyData {
    /// Points, mm.
    pub points_mm: Vec<[f32; 3]>,
    /// Lines, each as indices of its points.
    pub lines: Vec<Vec<u32>>,
    /// Polygons.
    pub polygons: Vec<Vec<u32>>,
    /// Triangle strips: cells of which a receiver has to make far fewer than polygons.
    pub strips: Vec<Vec<u32>>,
    /// One value for each point, by name; NaN where there is none.
    pub scalars: Vec<(String, Vec<f32>)>,
}

/// Bytes before the points: their count, and count and bytes of each kind of cells, and the count of
/// attributes.
const COUNTS: usize = 40;

/// The arrays of a surface that are sent, where it has them.
const ARRAYS: [&str; 3] = ["support", "standard_error_mm", "supported"];

impl PolyData {
    /// A vessel as triangle strips, with its arrays `support`, `standard_error_mm` and `supported`, as far as
    /// it has them. Positions are rounded to single precision.
    pub fn of_surface(surface: &Surface) -> Self {
        let array = |name: &&str| Some((String::from(*name), to_f32(surface.array(name)?.iter().copied())));
        Self {
            points_mm: surface.nodes_mm.iter().map(|p| p.as_vec3().to_array()).collect(),
            strips: strips(&surface.triangles, surface.nodes_mm.len()),
            scalars: ARRAYS.iter().filter_map(array).collect(),
            ..Self::default()
        }
    }

    pub(super) fn encode(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let kinds = [&Vec::new(), &self.lines, &self.polygons, &self.strips];
        let size = |cells: &Vec<Vec<u32>>| cells.iter().map(|cell| 4 + 4 * cell.len()).sum::<usize>();
        let sizes = kinds.map(size);
        // All counts are smaller than the bytes of what they count.
        let total = sizes.iter().sum::<usize>() + self.points_mm.len() * 12 * (1 + self.scalars.len());
        if u32::try_from(total).is_err() {
            return Err(refused("POLYDATA", format!("{total} bytes"), "fewer than 2^32"));
        }
        bytes.reserve(COUNTS + total);
        let word = |bytes: &mut Vec<u8>, value: usize| bytes.extend((value as u32).to_be_bytes());
        word(bytes, self.points_mm.len());
        for (cells, size) in kinds.iter().zip(sizes) {
            word(bytes, cells.len());
            word(bytes, size);
        }
        word(bytes, self.scalars.len());
        bytes.extend(self.points_mm.iter().flatten().flat_map(|x| x.to_be_bytes()));
        for cell in kinds.into_iter().flatten() {
            word(bytes, cell.len());
            bytes.extend(cell.iter().flat_map(|index| index.to_be_bytes()));
        }
        for (_, values) in &self.scalars {
            // Scalars of one component.
            bytes.extend([0, 1]);
            word(bytes, values.len());
        }
        let names = bytes.len();
        for (name, _) in &self.scalars {
            bytes.extend(name.bytes().filter(|&b| b != 0).chain([0]));
        }
        if (bytes.len() - names) % 2 == 1 {
            bytes.push(0);
        }
        bytes.extend(self.scalars.iter().flat_map(|(_, values)| values).flat_map(|x| x.to_be_bytes()));
        Ok(())
    }

    /// Reads points, lines, polygons, strips, and the scalars of one component that points have. Cells of
    /// single points and other attributes are passed over.
    pub(super) fn decode(bytes: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(bytes);
        let points = reader.u32()? as usize;
        let mut kinds = [(0, 0); 4];
        for kind in &mut kinds {
            *kind = (reader.u32()? as usize, reader.u32()? as usize);
        }
        let attributes = reader.u32()? as usize;
        let cell_bytes: u64 = kinds.iter().map(|&(_, bytes)| bytes as u64).sum();
        // Six bytes and a name's end are the least that an attribute takes.
        let least = COUNTS as u64 + points as u64 * 12 + cell_bytes + attributes as u64 * 7;
        if least > bytes.len() as u64 {
            let found = format!("{points} points, {cell_bytes} bytes of cells and {attributes} attributes");
            return Err(refused("POLYDATA", found, format!("what {} bytes hold", bytes.len())));
        }
        let mut data = Self::default();
        data.points_mm.reserve_exact(points);
        for _ in 0..points {
            data.points_mm.push(reader.point()?);
        }
        let [(_, vertices), lines, polygons, strips] = kinds;
        let _ = reader.take(vertices)?;
        let cells = [&mut data.lines, &mut data.polygons, &mut data.strips];
        for (cells, (count, bytes)) in cells.into_iter().zip([lines, polygons, strips]) {
            *cells = read_cells(reader.take(bytes)?, count, points)?;
        }
        let mut headers = Reader::new(reader.take(attributes * 6)?);
        let mut names = Reader::new(reader.rest());
        let mut ends = 0;
        for _ in 0..attributes {
            ends += 1 + names_end(&reader.rest()[ends..])?;
        }
        // The table of names has an even length.
        reader.take(ends + ends % 2)?;
        for _ in 0..attributes {
            let (kind, components, count) = (headers.u8()?, headers.u8()?, headers.u32()?);
            let end = names_end(names.rest())?;
            let name = names.take(end + 1)?;
            let size = usize::try_from(u64::from(components) * u64::from(count) * 4).unwrap_or(usize::MAX);
            let values = reader.take(size)?;
            if kind != 0 || components != 1 {
                continue;
            }
            let name = text(name);
            if count as usize != points {
                let found = format!("{count} values of {:?}", cut(&name, 64));
                return Err(refused("POLYDATA", found, format!("{points}, one for each point")));
            }
            let values = values.as_chunks().0.iter().map(|&b| f32::from_be_bytes(b)).collect();
            data.scalars.push((name, values));
        }
        match reader.rest().len() {
            0 => Ok(data),
            more => Err(refused("POLYDATA", format!("{more} bytes after its content"), "none")),
        }
    }
}

fn to_f32(values: impl Iterator<Item = f64>) -> Vec<f32> {
    values.map(|value| value as f32).collect()
}

fn names_end(bytes: &[u8]) -> Result<usize> {
    let end = bytes.iter().position(|&b| b == 0);
    end.ok_or_else(|| refused("POLYDATA", "a name without an end", "a zero after each name"))
}

/// So many cells, each the count of its points and their indices.
fn read_cells(bytes: &[u8], count: usize, points: usize) -> Result<Vec<Vec<u32>>> {
    if count as u64 * 4 > bytes.len() as u64 {
        return Err(refused(
            "POLYDATA",
            format!("{count} cells"),
            format!("what {} bytes hold", bytes.len()),
        ));
    }
    let mut reader = Reader::new(bytes);
    let mut cells = Vec::with_capacity(count);
    for _ in 0..count {
        let length = reader.u32()? as usize;
        let indices = reader.take(length.saturating_mul(4))?;
        let cell: Vec<u32> = indices.as_chunks().0.iter().map(|&b| u32::from_be_bytes(b)).collect();
        if let Some(index) = cell.iter().find(|&&index| index as usize >= points) {
            return Err(refused("POLYDATA", format!("point {index}"), format!("one below {points}")));
        }
        cells.push(cell);
    }
    match reader.rest().len() {
        0 => Ok(cells),
        more => Err(refused("POLYDATA", format!("{more} bytes after {count} cells"), "none")),
    }
}
