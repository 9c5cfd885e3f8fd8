//! Errors that a recording cannot show: those of its calibration.

use super::Locator;
use crate::Result;
use crate::geometry::Pose;
use crate::recording::Recording;
use crate::surface::Surface;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

/// How far errors of the calibration move a wall outward or inward, to first order: root mean squares over the
/// wall's nodes.
///
/// Echoes from all rolls and bends agree on a wall that a wrong calibration has moved as a whole, so residuals
/// hardly show it. Where a place of the wall was seen at several rolls, their shifts partly cancel: that is in
/// the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SystematicErrors {
    /// For a probe that lies 1 mm beside the calibrated place, along its x, y and z: mm.
    pub offset_mm_per_mm: [f64; 3],
    /// For a probe that is turned by 1° about its x, y and z: mm.
    pub rotation_mm_per_deg: [f64; 3],
    /// For a speed of sound that is wrong by 1 %: mm.
    pub sound_speed_mm_per_percent: f64,
}

impl SystematicErrors {
    /// Of a wall that was reconstructed from a recording; `None` where no echo lies near it.
    ///
    /// # Errors
    /// As [`Locator::new`].
    pub fn of(recording: &Recording, sensor_from_probe: Pose, wall: &Surface) -> Result<Option<Self>> {
        let locator = Locator::new(wall)?;
        let normals = wall.triangle_normals();
        let echoes: usize = recording.frames.iter().map(|f| f.contour_mm.len()).sum();
        let step = echoes.div_ceil(MAX_ECHOES).max(1);
        // Of every echo, the node that it speaks of and by how much a unit of each error moves it along the
        // normal.
        let moves: Vec<(u32, [f64; ERRORS])> = recording
            .frames
            .par_iter()
            .flat_map_iter(|frame| {
                let world_from_probe = frame.world_from_sensor * sensor_from_probe;
                let (locator, normals) = (&locator, &normals);
                let echoes = frame.echoes_mm().step_by(step).map(|p| p.extend(0.0));
                echoes.filter_map(move |p| {
                    let place = world_from_probe.transform_point(p);
                    let closest = locator.closest(place);
                    let triangle = closest.triangle as usize;
                    if !closest.distance_mm.is_finite() || closest.distance_mm > NEAR * p.length() {
                        return None;
                    }
                    let outward = world_from_probe.rotation.transpose() * normals[triangle];
                    let node = wall.triangles[triangle].into_iter().min_by(|&a, &b| {
                        let apart = |n: u32| wall.nodes_mm[n as usize].distance_squared(place);
                        apart(a).total_cmp(&apart(b))
                    })?;
                    let mut by = [0.0; ERRORS];
                    for (i, axis) in DVec3::AXES.into_iter().enumerate() {
                        by[i] = outward.dot(axis);
                        by[3 + i] = outward.dot(axis.cross(p)) * 1_f64.to_radians();
                    }
                    by[6] = outward.dot(p) * 0.01;
                    Some((node, by))
                })
            })
            .collect();
        let mut of_node = vec![(0_u32, [0.0; ERRORS]); wall.nodes_mm.len()];
        for (node, by) in moves {
            let (count, sums) = &mut of_node[node as usize];
            *count += 1;
            sums.iter_mut().zip(by).for_each(|(sum, by)| *sum += by);
        }
        let seen: Vec<_> = of_node.into_iter().filter(|&(count, _)| count > 0).collect();
        if seen.is_empty() {
            return Ok(None);
        }
        let rms = |error: usize| {
            let squares = seen.iter().map(|&(count, sums)| (sums[error] / f64::from(count)).powi(2));
            (squares.sum::<f64>() / seen.len() as f64).sqrt()
        };
        Ok(Some(Self {
            offset_mm_per_mm: [0, 1, 2].map(rms),
            rotation_mm_per_deg: [3, 4, 5].map(rms),
            sound_speed_mm_per_percent: rms(6),
        }))
    }
}

/// Offsets and turns about three axes, and the speed of sound.
const ERRORS: usize = 7;

/// Echoes that are enough for three digits.
const MAX_ECHOES: usize = 200_000;

/// Echoes farther from the wall than this share of their range are none of it.
const NEAR: f64 = 0.5;
