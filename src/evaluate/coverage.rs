//! The part of a truth that a recording covers.

use crate::geometry::Pose;
use crate::recording::Recording;
use crate::surface::Surface;
use crate::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;

/// The nodes of a truth surface near which a recording has a contour point.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Coverage {
    /// Largest distance to a contour point, mm.
    pub within_mm: f64,
    /// Whether each node of the truth is covered.
    pub nodes: Vec<bool>,
}

/// Positions of up to a kilometre are counted in units of the distance.
const MIN_WITHIN_MM: f64 = 1e-6;

impl Coverage {
    /// Within this distance by default, mm: twice the thesis's contour noise.
    pub const WITHIN_MM: f64 = 2.0;

    /// Finds the nodes of `truth` with a contour point within `within_mm`. `sensor_from_probe` is the calibration `eTi`.
    ///
    /// # Errors
    /// [`Error::Setting`] for a distance that is not positive; [`Error::Frame`] for a frame that cannot be used;
    /// [`Error::Surface`] where no node is covered: truth and recording are then hardly in the same frame of reference.
    pub fn of(
        recording: &Recording,
        sensor_from_probe: Pose,
        truth: &Surface,
        within_mm: f64,
    ) -> Result<Self> {
        if !(within_mm.is_finite() && within_mm >= MIN_WITHIN_MM) {
            return Err(Error::Setting {
                name: "covered_within".into(),
                found: within_mm.to_string(),
                expected: "at least 1e-6 mm".into(),
            });
        }
        recording.check()?;
        // Boxes of that size: nodes near enough to a point lie in its box or in one of the 26 around it.
        let place = |p: DVec3| (p / within_mm).floor().as_i64vec3();
        let mut boxes: HashMap<_, Vec<usize>> = HashMap::new();
        for (node, &p) in truth.nodes_mm.iter().enumerate() {
            boxes.entry(place(p)).or_default().push(node);
        }
        let mut nodes = vec![false; truth.nodes_mm.len()];
        let around = || (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z])));
        for frame in &recording.frames {
            let world_from_probe = frame.world_from_sensor * sensor_from_probe;
            for echo in frame.echoes_mm() {
                let point = world_from_probe.transform_point(echo.extend(0.0));
                let home = place(point);
                for step in around() {
                    if let Some(open) = boxes.get_mut(&(home + glam::I64Vec3::from_array(step))) {
                        // A covered node need not be found again.
                        open.retain(|&node| {
                            let covered =
                                truth.nodes_mm[node].distance_squared(point) <= within_mm * within_mm;
                            nodes[node] |= covered;
                            !covered
                        });
                    }
                }
            }
        }
        if nodes.iter().any(|&covered| covered) {
            Ok(Self { within_mm, nodes })
        } else {
            Err(Error::Surface {
                what: "truth".into(),
                found: format!("no node within {within_mm} mm of any contour point"),
                expected: "the vessel that the recording shows, in the same frame of reference".into(),
            })
        }
    }
}
