//! The axis of a vessel: a smooth curve along the middle of the lumen.

use crate::geometry::polyline::{lengths, nearest, station};
use crate::geometry::{NaturalSpline, Pose, rotation_minimising_frames};
use crate::sweep::Sweep;
use crate::{Error, Result};
use glam::{DMat3, DVec3};

/// The axis of one branch of a vessel, with frames that turn about it as little as possible.
///
/// Points are dense: between two of them the curve is straight to far below a micrometre.
#[derive(Debug, Clone, PartialEq)]
pub struct VesselAxis {
    points_mm: Vec<DVec3>,
    lengths_mm: Vec<f64>,
    frames: Vec<DMat3>,
}

/// Most and fewest points of an axis, and the distance that is aimed at, mm.
const POINTS: [f64; 2] = [200.0, 20_000.0];
const STEP_MM: f64 = 0.25;

impl VesselAxis {
    /// The smooth curve through some points, mm. Points in one place count once.
    ///
    /// # Errors
    /// [`Error::Surface`] for fewer than two places and for coordinates that are not finite.
    pub fn through(points_mm: &[DVec3]) -> Result<Self> {
        let mut points: Vec<DVec3> = points_mm.to_vec();
        points.dedup_by(|a, b| a.distance(*b) <= 1e-9);
        if points.len() < 2 || points.iter().any(|p| !p.is_finite()) {
            return Err(Error::Surface {
                what: "axis".into(),
                found: format!("{} places", points.len()),
                expected: "at least two, with finite coordinates".into(),
            });
        }
        let spline = NaturalSpline::through(&points, lengths(&points));
        let steps = (spline.length() / STEP_MM).ceil().clamp(POINTS[0], POINTS[1]) as usize;
        let at = |i: usize| spline.at(spline.length() * i as f64 / steps as f64);
        let (points_mm, tangents): (Vec<DVec3>, Vec<DVec3>) = (0..=steps).map(at).unzip();
        let frames = rotation_minimising_frames(&points_mm, &tangents);
        Ok(Self { lengths_mm: lengths(&points_mm), points_mm, frames })
    }

    /// The axis of a sweep, between the outermost rings that echoes support.
    ///
    /// # Errors
    /// As [`VesselAxis::through`].
    pub fn of_sweep(sweep: &Sweep) -> Result<Self> {
        let is_supported = |ring: &usize| {
            let nodes = ring * sweep.nodes..(ring + 1) * sweep.nodes;
            sweep.support.supported[nodes].contains(&true)
        };
        let mut rings = (0..sweep.axis.rings()).filter(is_supported);
        let first = rings.next().unwrap_or(0);
        let last = rings.next_back().unwrap_or(sweep.axis.rings() - 1);
        Self::through(&sweep.axis.points_mm[first..=last])
    }

    /// Its points, mm.
    pub fn points_mm(&self) -> &[DVec3] {
        &self.points_mm
    }

    /// Length along the axis up to each point, mm.
    pub fn arc_mm(&self) -> &[f64] {
        &self.lengths_mm
    }

    /// The frame at each point: x and y across the vessel, z along it.
    pub fn frames(&self) -> &[DMat3] {
        &self.frames
    }

    /// Its length, mm.
    pub fn length_mm(&self) -> f64 {
        self.lengths_mm[self.lengths_mm.len() - 1]
    }

    /// The plane across the vessel `at_mm` along the axis: origin on it, z along it. Straight beyond the ends.
    pub fn pose(&self, at_mm: f64) -> Pose {
        let inside = at_mm.clamp(0.0, self.length_mm());
        let k = self.lengths_mm.partition_point(|&l| l <= inside).clamp(1, self.points_mm.len() - 1) - 1;
        let (a, b) = (&self.frames[k], &self.frames[k + 1]);
        let share = (inside - self.lengths_mm[k]) / (self.lengths_mm[k + 1] - self.lengths_mm[k]);
        let z = a.z_axis.lerp(b.z_axis, share).normalize();
        let x = a.x_axis.lerp(b.x_axis, share);
        let x = (x - z * x.dot(z)).normalize();
        let origin = self.points_mm[k].lerp(self.points_mm[k + 1], share) + z * (at_mm - inside);
        Pose { rotation: DMat3::from_cols(x, z.cross(x), z), translation_mm: origin }
    }

    /// How far along the axis its place nearest to a point lies, mm.
    pub fn station_mm(&self, point_mm: DVec3) -> f64 {
        station(&self.points_mm, &self.lengths_mm, nearest(&self.points_mm, point_mm))
    }

    /// The part between two lengths, mm.
    ///
    /// # Errors
    /// As [`VesselAxis::through`].
    pub(crate) fn part(&self, [from_mm, to_mm]: [f64; 2]) -> Result<Self> {
        let steps = ((to_mm - from_mm) / STEP_MM).ceil().clamp(POINTS[0], POINTS[1]) as usize;
        let at = |i: usize| from_mm + (to_mm - from_mm) * i as f64 / steps as f64;
        Self::through(&(0..=steps).map(|i| self.pose(at(i)).translation_mm).collect::<Vec<_>>())
    }

    /// Curvature and torsion `at_mm` along the axis, 1/mm, of the cubic that fits the axis best within `reach_mm` on both
    /// sides. Torsion is 0 where the axis is straight.
    pub fn bending(&self, at_mm: f64, reach_mm: f64) -> [f64; 2] {
        const SAMPLES: i32 = 12;
        let origin = self.pose(at_mm).translation_mm;
        // Powers of u = length / reach, from -1 to 1, less the point itself: odd and even powers separate.
        let (mut odd, mut even) = ([DVec3::ZERO; 2], DVec3::ZERO);
        let (mut s2, mut s4, mut s6) = (0.0, 0.0, 0.0);
        let mut mean = DVec3::ZERO;
        for i in -SAMPLES..=SAMPLES {
            let u = f64::from(i) / f64::from(SAMPLES);
            let p = self.pose(at_mm + u * reach_mm).translation_mm - origin;
            odd[0] += p * u;
            odd[1] += p * u.powi(3);
            even += p * (u * u);
            mean += p;
            s2 += u * u;
            s4 += u.powi(4);
            s6 += u.powi(6);
        }
        let count = f64::from(2 * SAMPLES + 1);
        let determinant = s2 * s6 - s4 * s4;
        let first = (odd[0] * s6 - odd[1] * s4) / determinant;
        let third = (odd[1] * s2 - odd[0] * s4) / determinant;
        let second = (even - mean * (s2 / count)) / (s4 - s2 * s2 / count);
        let [d1, d2, d3] =
            [first / reach_mm, second * (2.0 / reach_mm.powi(2)), third * (6.0 / reach_mm.powi(3))];
        let binormal = d1.cross(d2);
        let curvature = binormal.length() / d1.length().powi(3);
        // Where the plane of the bend is rounding noise, so is its turn.
        let torsion =
            if curvature * reach_mm > 1e-3 { binormal.dot(d3) / binormal.length_squared() } else { 0.0 };
        [curvature, torsion]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_helix_has_its_curvature_and_torsion() {
        let (radius, rise) = (20.0, 6.0);
        let points: Vec<DVec3> = (0..400)
            .map(|i| f64::from(i) * 0.02)
            .map(|a| DVec3::new(radius * a.cos(), radius * a.sin(), rise * a))
            .collect();
        let axis = VesselAxis::through(&points).unwrap();
        let square = radius * radius + rise * rise;
        for at in [40.0, 80.0, 120.0] {
            let [curvature, torsion] = axis.bending(at, 8.0);
            assert!((curvature * square / radius - 1.0).abs() < 0.02, "{curvature}");
            assert!((torsion * square / rise - 1.0).abs() < 0.05, "{torsion}");
            assert!((axis.station_mm(axis.pose(at).translation_mm) - at).abs() < 1e-6);
        }
        let part = axis.part([30.0, 70.0]).unwrap();
        assert!((part.length_mm() - 40.0).abs() < 1e-3);
        let straight = VesselAxis::through(&[DVec3::ZERO, DVec3::X * 50.0]).unwrap();
        let [curvature, torsion] = straight.bending(25.0, 5.0);
        assert!(curvature < 1e-9 && torsion == 0.0);
        assert!(VesselAxis::through(&[DVec3::ONE; 5]).is_err());
    }
}
