//! Contours drawn in 3D Slicer.

use super::{Frame, Recording};
use crate::geometry::{Pose, polygon, rotation_minimising_frames};
use crate::{Error, Result};
use glam::{DMat3, DVec2, DVec3};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A recording made of closed curves that were drawn in space, such as 3D Slicer's markups: one frame for each, in their
/// order.
///
/// A frame's origin is the centre of the area inside its curve, its z axis is perpendicular to the plane that fits the
/// curve, along the way from curve to curve, and the roll about it is kept as constant as the curves allow.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Curves {
    /// The frames.
    pub recording: Recording,
    /// For each frame its curve's name.
    pub names: Vec<String>,
    /// For each frame, the largest distance of a point from its plane, mm.
    pub off_plane_mm: Vec<f64>,
}

/// A file of Slicer's markups.
#[derive(Deserialize)]
struct File {
    markups: Vec<Markup>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Markup {
    #[serde(rename = "type")]
    kind: String,
    #[serde(default)]
    coordinate_system: Option<String>,
    #[serde(default)]
    coordinate_units: Option<serde_json::Value>,
    #[serde(default)]
    control_points: Vec<ControlPoint>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ControlPoint {
    #[serde(default)]
    position: Option<[f64; 3]>,
    #[serde(default)]
    position_status: Option<String>,
}

/// Points between two control points.
const SUBDIVISION: usize = 8;

impl Curves {
    /// Reads the closed curves of Slicer's files `.mrk.json`, in the order of the files. Other markups are skipped. Control
    /// points are joined by Slicer's own curve, a cardinal spline.
    ///
    /// # Errors
    /// Where a file cannot be read, is no file of markups or has no closed curve, and where a curve has fewer than three
    /// different points, no area, or other units than mm.
    pub fn read(paths: &[PathBuf]) -> Result<Self> {
        let (mut names, mut curves) = (Vec::new(), Vec::new());
        for path in paths {
            let before = curves.len();
            read_file(path, &mut names, &mut curves)?;
            if curves.len() == before {
                return Err(Error::input(path, "markups", "no closed curve", "one of type ClosedCurve"));
            }
        }
        let centres: Vec<DVec3> = curves.iter().map(|curve| curve.centre_mm).collect();
        let mut normals: Vec<DVec3> = curves.iter().map(|curve| curve.normal).collect();
        // Along the way: against it, the frames would turn over from one curve to the next.
        for k in 0..normals.len() {
            let way = centres[(k + 1).min(centres.len() - 1)] - centres[k.saturating_sub(1)];
            let along = if way.length() > 0.0 { way } else { DVec3::Z };
            if normals[k].dot(along) < 0.0 {
                normals[k] = -normals[k];
            }
        }
        let rotations = rotation_minimising_frames(&centres, &normals);
        let frames = curves.iter().zip(rotations).map(|(curve, rotation)| curve.frame(rotation));
        let (frames, off_plane_mm) = frames.unzip();
        let recording = Recording { frames };
        if let Some(first) = paths.first() {
            recording.check().map_err(|e| e.in_file(first))?;
        }
        Ok(Self { recording, names, off_plane_mm })
    }
}

/// A curve and the plane that fits it.
struct Curve {
    points_mm: Vec<DVec3>,
    centre_mm: DVec3,
    normal: DVec3,
}

impl Curve {
    /// `None` where there is no area.
    fn of(points_mm: Vec<DVec3>) -> Option<Self> {
        let count = points_mm.len() as f64;
        let mean = points_mm.iter().copied().sum::<DVec3>() / count;
        let pairs = points_mm.iter().zip(points_mm.iter().cycle().skip(1));
        let twice_area: DVec3 = pairs.map(|(a, b)| (*a - mean).cross(*b - mean)).sum();
        let normal = twice_area.try_normalize().filter(|_| twice_area.length() > 1e-6)?;
        let curve = Self { points_mm, centre_mm: mean, normal };
        // The centre of the area rather than of the points, which may lie closer on one side.
        let (x, y) = normal.any_orthonormal_pair();
        let flat = curve.points_mm.iter().map(|p| DVec2::new((*p - mean).dot(x), (*p - mean).dot(y)));
        let (area, moment) = polygon::twice_area_and_moment(flat);
        let first = curve.points_mm[0] - mean;
        let centre = moment / (3.0 * area) + DVec2::new(first.dot(x), first.dot(y));
        Some(Self { centre_mm: mean + x * centre.x + y * centre.y, ..curve })
    }

    /// The frame in a plane with these axes, and the largest distance from it, mm.
    fn frame(&self, rotation: DMat3) -> (Frame, f64) {
        let pose = Pose { rotation, translation_mm: self.centre_mm };
        let inverse = pose.inverse();
        let points: Vec<DVec3> = self.points_mm.iter().map(|p| inverse.transform_point(*p)).collect();
        let off_plane_mm = points.iter().map(|p| p.z.abs()).fold(0.0, f64::max);
        let mut contour: Vec<DVec2> = points.iter().map(|p| p.truncate()).collect();
        if polygon::twice_area_and_moment(contour.iter().copied()).0 < 0.0 {
            contour.reverse();
        }
        (Frame::new(pose, contour), off_plane_mm)
    }
}

fn read_file(path: &Path, names: &mut Vec<String>, curves: &mut Vec<Curve>) -> Result<()> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    let text = crate::text::decoded(&bytes);
    let file: File = serde_json::from_str(&text)
        .map_err(|e| Error::input(path, "JSON", e, "a file of markups, as 3D Slicer writes it"))?;
    let stem = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = stem.split('.').next().unwrap_or_default();
    for (k, markup) in file.markups.iter().enumerate().filter(|(_, markup)| markup.kind == "ClosedCurve") {
        let refused = |field: &str, found: String, expected: &str| {
            Err(Error::input(path, format!("{field} of markup {k}"), found, expected))
        };
        // Slicer wrote them as RAS before it named them.
        let mirrored = match markup.coordinate_system.as_deref().unwrap_or("LPS") {
            "LPS" | "0" => true,
            "RAS" | "1" => false,
            other => return refused("coordinateSystem", format!("{other:?}"), "LPS or RAS"),
        };
        match &markup.coordinate_units {
            None => {}
            Some(serde_json::Value::String(unit)) if unit == "mm" => {}
            Some(serde_json::Value::Array(code)) if code.first().and_then(|c| c.as_str()) == Some("mm") => {}
            Some(other) => return refused("coordinateUnits", other.to_string(), "mm"),
        }
        let is_defined =
            |point: &&ControlPoint| point.position_status.as_deref().is_none_or(|status| status == "defined");
        let mut points: Vec<DVec3> = Vec::new();
        for position in markup.control_points.iter().filter(is_defined).filter_map(|point| point.position) {
            let [x, y, z] = position;
            let point = if mirrored { DVec3::new(-x, -y, z) } else { DVec3::new(x, y, z) };
            if !point.is_finite() || point.abs().max_element() > 1e6 {
                return refused("position", format!("{position:?}"), "three finite numbers in mm");
            }
            if points.last() != Some(&point) {
                points.push(point);
            }
        }
        if points.len() > 1 && points.first() == points.last() {
            points.pop();
        }
        if points.len() < 3 {
            let found = format!("{} different points", points.len());
            return refused("controlPoints", found, "at least 3");
        }
        let Some(curve) = Curve::of(cardinal_spline(&points)) else {
            return refused("controlPoints", "points on a line".into(), "a curve around an area");
        };
        curves.push(curve);
        names.push(if file.markups.len() == 1 { stem.to_owned() } else { format!("{stem} {k}") });
    }
    Ok(())
}

/// A closed cardinal spline of tension 0 (Catmull-Rom) through points.
fn cardinal_spline(points: &[DVec3]) -> Vec<DVec3> {
    let n = points.len();
    let at = |k: usize, step: usize| {
        let [p0, p1, p2, p3] = [k + n - 1, k, k + 1, k + 2].map(|k| points[k % n]);
        let t = step as f64 / SUBDIVISION as f64;
        let tangents = [(p2 - p0) / 2.0, (p3 - p1) / 2.0];
        let (t2, t3) = (t * t, t * t * t);
        p1 * (2.0 * t3 - 3.0 * t2 + 1.0)
            + tangents[0] * (t3 - 2.0 * t2 + t)
            + p2 * (3.0 * t2 - 2.0 * t3)
            + tangents[1] * (t3 - t2)
    };
    (0..n).flat_map(|k| (0..SUBDIVISION).map(move |step| at(k, step))).collect()
}
