//! Cross-sections of the lumen in the planes of the frames.

use crate::geometry::Pose;
use crate::recording::{Recording, Table};
use crate::surface::{Cutter, SectionOutline, Surface};
use crate::{Error, Result};
use glam::DVec2;
use serde::Serialize;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

/// The lumen in the plane of one frame. Numbers are NaN (`null` in JSON) where the mesh has no closed outline there.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LumenSection {
    /// The frame (0-based).
    pub frame: usize,
    /// Area inside the outline, mm².
    pub area_mm2: f64,
    /// Length of the outline, mm.
    pub perimeter_mm: f64,
    /// Shortest chord through the area's centroid, mm; NaN where the centroid lies outside the outline.
    pub least_diameter_mm: f64,
    /// Longest chord through the area's centroid, mm; NaN where the centroid lies outside the outline.
    pub greatest_diameter_mm: f64,
    /// Diameter of the circle of that area, mm.
    pub equivalent_diameter_mm: f64,
    /// Why numbers are missing or doubtful.
    pub remark: Option<String>,
}

impl LumenSection {
    /// A section without numbers.
    pub fn without(frame: usize, remark: String) -> Self {
        Self {
            frame,
            area_mm2: f64::NAN,
            perimeter_mm: f64::NAN,
            least_diameter_mm: f64::NAN,
            greatest_diameter_mm: f64::NAN,
            equivalent_diameter_mm: f64::NAN,
            remark: Some(remark),
        }
    }
}

/// Cuts a mesh by every frame's plane, the xy-plane of the probe `{i}`, and measures the outline about the probe, or
/// the one nearest to it where none is about it. `sensor_from_probe` is the calibration `eTi`.
///
/// # Errors
/// As [`Surface::check`].
pub fn sections(mesh: &Surface, recording: &Recording, sensor_from_probe: Pose) -> Result<Vec<LumenSection>> {
    let cutter = Cutter::new(mesh)?;
    let measure = |(frame, pose): (usize, Pose)| {
        let cut = cutter.cut(&pose);
        let away = |outline: &SectionOutline| match outline.contains(DVec2::ZERO) {
            true => 0.0,
            false => outline.distance_mm(DVec2::ZERO),
        };
        let nearest = cut.outlines.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        let remark = match (nearest, cut.open) {
            (None, 0) => Some("the plane misses the mesh".to_owned()),
            (None, _) => Some("the outline is open".to_owned()),
            (Some(outline), _) if away(outline) > 0.0 => {
                Some(format!("the outline is {:.2} mm from the probe", away(outline)))
            }
            _ => None,
        };
        let [least, greatest] = nearest.and_then(SectionOutline::diameters_mm).unwrap_or([f64::NAN; 2]);
        let area_mm2 = nearest.map_or(f64::NAN, SectionOutline::area_mm2);
        LumenSection {
            frame,
            area_mm2,
            perimeter_mm: nearest.map_or(f64::NAN, SectionOutline::perimeter_mm),
            least_diameter_mm: least,
            greatest_diameter_mm: greatest,
            equivalent_diameter_mm: 2.0 * (area_mm2 / PI).sqrt(),
            remark,
        }
    };
    let poses = recording.frames.iter().map(|frame| frame.world_from_sensor * sensor_from_probe);
    Ok(poses.enumerate().map(measure).collect())
}

/// Reads a value per frame, such as areas measured by hand: a table with a column `frame` and another of any name.
/// Frames without a value are left out.
///
/// # Errors
/// Where the file cannot be read, lacks a column, holds something else than numbers or names a frame twice.
pub fn read_values(path: &Path, column: &str) -> Result<BTreeMap<u64, f64>> {
    let mut table = Table::open(path)?;
    let (frame, value) = (table.column("frame")?, table.column_headed(column)?);
    let mut values = BTreeMap::new();
    while let Some(row) = table.next_row()? {
        let number = table.count(&row, frame)? as u64;
        if let Some(value) = table.optional_number(&row, value)?
            && values.insert(number, value).is_some()
        {
            return Err(table.fault(&row, frame, number, "each frame once"));
        }
    }
    if values.is_empty() {
        return Err(Error::input(path, column, "no values", "at least one"));
    }
    Ok(values)
}
