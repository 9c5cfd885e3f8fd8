//! What the probe saw: frames with their poses and contours, and the files that hold them.

mod csv;
mod mat;

use crate::cylinder::CylinderModel;
use crate::geometry::Pose;
use crate::{Error, Result};
use glam::DVec2;
use std::path::Path;

/// One IVUS frame: a contour and the pose of the tracker sensor when it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// `wTe`: the tracker sensor in the world, mm.
    pub world_from_sensor: Pose,
    /// When the frame was taken, in seconds; the origin is the recording's own.
    pub time_s: Option<f64>,
    /// Wall points (x, y) in mm in the xy-plane of the probe `{i}`, one per ray. NaN: no echo on that ray.
    pub contour_mm: Vec<DVec2>,
    /// The local cylinder, where the recording carries one.
    pub cylinder: Option<CylinderModel>,
}

impl Frame {
    /// The wall points that are there: the contour without its missing echoes.
    pub fn echoes_mm(&self) -> impl Iterator<Item = DVec2> + '_ {
        self.contour_mm.iter().copied().filter(|p| !p.is_nan())
    }

    /// Rays without an echo.
    pub fn missing_echoes(&self) -> usize {
        self.contour_mm.iter().filter(|p| p.is_nan()).count()
    }
}

/// A tracked IVUS recording, frames in the order in which they were taken.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recording {
    /// The frames.
    pub frames: Vec<Frame>,
}

impl Recording {
    /// Reads a recording: a MATLAB `.mat` file (v5, v7) or a folder of CSV files.
    ///
    /// # Errors
    /// Where a file cannot be read, lacks a variable, or holds a frame that fails [`Recording::check`].
    pub fn read(path: &Path) -> Result<Self> {
        let recording = if path.is_dir() { csv::read(path)? } else { mat::read_by_ending(path)? };
        recording.check().map_err(|e| e.in_file(path))?;
        Ok(recording)
    }

    /// Writes a recording: `.mat` by that ending, else a folder of CSV files.
    ///
    /// # Errors
    /// Where the file or folder cannot be written; no partial file is left behind.
    pub fn write(&self, path: &Path) -> Result<()> {
        if crate::output::ending(path) == "mat" { mat::write(self, path) } else { csv::write(self, path) }
    }

    /// Refuses what no reconstruction can use: no frames, a pose that is not finite or no rotation, a contour
    /// point that is half there, a cylinder that is not finite or has no positive radius.
    ///
    /// # Errors
    /// [`Error::Frame`] with the first frame to blame.
    pub fn check(&self) -> Result<()> {
        if self.frames.is_empty() {
            return Err(Error::Frame {
                frame: 0,
                field: "frames",
                found: "0 frames".into(),
                expected: "at least 1".into(),
            });
        }
        self.frames.iter().enumerate().try_for_each(|(k, frame)| frame.check(k))
    }
}

impl Frame {
    /// See [`Recording::check`]; `index` is the frame's number for the message.
    ///
    /// # Errors
    /// [`Error::Frame`].
    pub fn check(&self, index: usize) -> Result<()> {
        let fail = |field, found: String, expected: &str| {
            Err(Error::Frame { frame: index, field, found, expected: expected.into() })
        };
        let pose = &self.world_from_sensor;
        if !pose.translation_mm.is_finite() {
            return fail("position", format!("{}", pose.translation_mm), "three finite numbers in mm");
        }
        if !pose.rotation.is_finite() {
            return fail("rotation", "a number that is not finite".into(), "nine finite numbers");
        }
        let determinant = pose.rotation.determinant();
        if determinant <= 0.0 {
            return fail("rotation", format!("determinant {determinant:.3}"), "1 (right-handed axes)");
        }
        let error = pose.orthogonality_error();
        if error > 1e-3 {
            return fail(
                "rotation",
                format!("|RᵀR - I| = {error:.3e}"),
                "at most 1e-3 (orthogonal unit axes)",
            );
        }
        if let Some(t) = self.time_s
            && !t.is_finite()
        {
            return fail("time", t.to_string(), "a finite number of seconds");
        }
        for (i, p) in self.contour_mm.iter().enumerate() {
            if p.x.is_nan() != p.y.is_nan() || p.x.is_infinite() || p.y.is_infinite() {
                return fail(
                    "contour",
                    format!("({}, {}) at point {i}", p.x, p.y),
                    "two finite numbers in mm, or NaN in both for a missing echo",
                );
            }
        }
        if let Some(c) = &self.cylinder {
            if !c.is_finite() {
                return fail("cylinder", format!("{c:?}"), "five finite numbers");
            }
            if c.radius_mm <= 0.0 {
                return fail("cylinder radius", format!("{} mm", c.radius_mm), "more than 0 mm");
            }
        }
        Ok(())
    }
}
