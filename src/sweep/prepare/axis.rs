//! The swept axis: a smooth curve with rotation-minimising frames, and the coordinates about it.

use crate::geometry::polyline::lengths;
use crate::geometry::{NaturalSpline, rotation_minimising_frames};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// The curve that a section is swept along: ring k lies in the plane through `points_mm[k]` normal to `frames[k].z_axis`.
///
/// Between two rings, plane, origin and axes are interpolated linearly. Coordinates about the axis are therefore one-to-one
/// and continuous wherever the wall is nearer to the axis than the axis's centre of curvature.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Axis {
    /// Origins of the rings, mm.
    pub points_mm: Vec<DVec3>,
    /// Axes of the rings: x and y across the vessel, z along it.
    pub frames: Vec<DMat3>,
    /// Mean distance of two rings, mm.
    pub step_mm: f64,
}

/// The coordinates of a point about the axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    /// Along the axis, in rings.
    pub ring: f64,
    /// About the axis, rad, 0 to 2π, from x towards y.
    pub theta_rad: f64,
    /// Away from the axis, mm.
    pub radius_mm: f64,
    /// Unit vectors there: away from the axis, about it, along it.
    pub directions: DMat3,
    /// Length there of a millimetre of the axis: less than one on the inside of a bend.
    pub stretch: f64,
}

impl Axis {
    /// An axis along `centreline_mm`, a ring about every `step_mm`, extended straight at both ends by `beyond_mm`.
    pub(in crate::sweep) fn along(centreline_mm: &[DVec3], step_mm: f64, beyond_mm: f64) -> Self {
        let curve = NaturalSpline::through(centreline_mm, lengths(centreline_mm));
        let length = curve.length();
        let count = (((length + 2.0 * beyond_mm) / step_mm).round() as usize).max(4);
        let step = (length + 2.0 * beyond_mm) / count as f64;
        let (points_mm, tangents): (Vec<_>, Vec<_>) =
            (0..=count).map(|k| curve.at(k as f64 * step - beyond_mm)).unzip();
        let frames = rotation_minimising_frames(&points_mm, &tangents);
        Self { points_mm, frames, step_mm: step }
    }

    /// Number of rings.
    pub fn rings(&self) -> usize {
        self.points_mm.len()
    }

    /// The ring nearest to a point.
    pub(in crate::sweep) fn nearest_ring(&self, point_mm: DVec3) -> usize {
        (0..self.rings()).fold(0, |best, k| {
            let distance = |k: usize| self.points_mm[k].distance_squared(point_mm);
            if distance(k) < distance(best) { k } else { best }
        })
    }

    /// Coordinates of a point; the search starts at ring `near`. `None` before the first and behind the last ring.
    pub(crate) fn place(&self, point_mm: DVec3, near: usize) -> Option<Place> {
        let ahead = |k: usize| (point_mm - self.points_mm[k]).dot(self.frames[k].z_axis);
        let last = self.rings() - 2;
        let mut k = near.min(last);
        // It moves in one direction only, so it ends.
        if ahead(k) < 0.0 {
            while ahead(k) < 0.0 {
                k = k.checked_sub(1)?;
            }
        } else {
            while ahead(k + 1) >= 0.0 {
                k += 1;
                if k > last {
                    return None;
                }
            }
        }
        let (a, b) = (&self.frames[k], &self.frames[k + 1]);
        let along = self.points_mm[k + 1] - self.points_mm[k];
        let q = point_mm - self.points_mm[k];
        // (q - u·along)·(z + u·turn) = 0 for u in 0..1.
        let turn = b.z_axis - a.z_axis;
        let (square, linear, constant) =
            (-along.dot(turn), q.dot(turn) - along.dot(a.z_axis), q.dot(a.z_axis));
        let root = (linear * linear - 4.0 * square * constant).max(0.0).sqrt();
        let u = (2.0 * constant / (-linear + if linear < 0.0 { root } else { -root })).clamp(0.0, 1.0);
        let v = q - along * u;
        let [x, y, z] = [0, 1, 2].map(|i| a.col(i).lerp(b.col(i), u));
        let (x_mm, y_mm) = (v.dot(x), v.dot(y));
        let radius_mm = v.length();
        let theta = y_mm.atan2(x_mm);
        let away_mm = (x_mm * x_mm + y_mm * y_mm).sqrt();
        let (sin, cos) = if away_mm > 0.0 { (y_mm / away_mm, x_mm / away_mm) } else { (0.0, 1.0) };
        let outwards = x * cos + y * sin;
        let theta_rad = if theta < 0.0 { theta + TAU } else { theta };
        Some(Place {
            ring: k as f64 + u,
            theta_rad: if theta_rad < TAU { theta_rad } else { 0.0 },
            radius_mm,
            directions: DMat3::from_cols(outwards, y * cos - x * sin, z),
            // Behind a centre of curvature the coordinates fold over; no wall can lie there.
            stretch: (1.0 - turn.dot(outwards) / self.step_mm * radius_mm).max(0.3),
        })
    }

    /// The point at coordinates about the axis, mm, and the [directions](Place::directions) there.
    pub(in crate::sweep) fn at(&self, ring: f64, theta_rad: f64, radius_mm: f64) -> (DVec3, DMat3) {
        let k = (ring.max(0.0) as usize).min(self.rings() - 2);
        let u = ring - k as f64;
        let (a, b) = (&self.frames[k], &self.frames[k + 1]);
        let [x, y, z] = [0, 1, 2].map(|i| a.col(i).lerp(b.col(i), u));
        let (sin, cos) = theta_rad.sin_cos();
        let outwards = x * cos + y * sin;
        let origin = self.points_mm[k].lerp(self.points_mm[k + 1], u);
        (origin + outwards * radius_mm, DMat3::from_cols(outwards, y * cos - x * sin, z))
    }

    /// The point at angle `theta_rad` and distance `radius_mm` from ring `ring`'s origin, mm.
    pub(crate) fn point_mm(&self, ring: usize, theta_rad: f64, radius_mm: f64) -> DVec3 {
        let (sin, cos) = theta_rad.sin_cos();
        let frame = &self.frames[ring];
        self.points_mm[ring] + (frame.x_axis * cos + frame.y_axis * sin) * radius_mm
    }

    /// As [`Axis::point_mm`], between two rings.
    pub(crate) fn point_between_mm(&self, ring: f64, theta_rad: f64, radius_mm: f64) -> DVec3 {
        let below = (ring.max(0.0) as usize).min(self.rings() - 2);
        let point = |ring: usize| self.point_mm(ring, theta_rad, radius_mm);
        point(below).lerp(point(below + 1), ring - below as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quarter of a circle of radius 40 that rises out of its plane.
    fn axis() -> Axis {
        let curve: Vec<DVec3> = (0..=30)
            .map(|i| f64::from(i) / 30.0 * 1.5)
            .map(|a| DVec3::new(40.0 * a.cos(), 40.0 * a.sin(), 10.0 * a))
            .collect();
        Axis::along(&curve, 0.8, 5.0)
    }

    #[test]
    fn nodes_come_back_from_the_world() {
        let axis = axis();
        for (ring, theta, radius) in [(1, 0.0, 3.0), (20, 1.0, 12.0), (40, 3.0, 25.0), (60, 6.2, 0.5)] {
            let point = axis.point_mm(ring, theta, radius);
            let place = axis.place(point, 33).unwrap();
            assert!((place.ring - ring as f64).abs() < 1e-9, "{place:?}");
            assert!((place.theta_rad - theta).abs() < 1e-9, "{place:?}");
            assert!((place.radius_mm - radius).abs() < 1e-9, "{place:?}");
            let (there, directions) = axis.at(place.ring, place.theta_rad, place.radius_mm);
            assert!(there.distance(point) < 1e-9, "{there}");
            assert!(directions.abs_diff_eq(place.directions, 1e-9), "{directions}");
        }
    }

    #[test]
    fn coordinates_do_not_jump_from_ring_to_ring() {
        let axis = axis();
        let between =
            |k: usize, theta: f64| axis.point_mm(k, theta, 11.0).lerp(axis.point_mm(k + 1, theta, 11.0), 0.5);
        for k in 5..axis.rings() - 5 {
            let place = axis.place(between(k, 2.0), 0).unwrap();
            assert!((place.ring - (k as f64 + 0.5)).abs() < 1e-3, "{place:?}");
            assert!(
                (place.theta_rad - 2.0).abs() < 1e-3 && (place.radius_mm - 11.0).abs() < 1e-2,
                "{place:?}"
            );
            // A millimetre of the axis is this long out there.
            let length = axis.point_mm(k, 2.0, 11.0).distance(axis.point_mm(k + 1, 2.0, 11.0));
            assert!((place.stretch - length / axis.step_mm).abs() < 0.02, "{place:?}");
        }
    }

    #[test]
    fn what_lies_beyond_the_ends_has_no_place() {
        let axis = axis();
        let (first, last) = (axis.points_mm[0], axis.points_mm[axis.rings() - 1]);
        assert!(axis.place(first - axis.frames[0].z_axis * 0.01, 9).is_none());
        assert!(axis.place(last + axis.frames[axis.rings() - 1].z_axis * 0.01, 9).is_none());
        assert!(axis.place(first + axis.frames[0].z_axis * 0.01, 9).is_some());
    }
}
