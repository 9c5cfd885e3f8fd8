//! The centreline of a vessel's branch.

use crate::geometry::{Pose, polyline, rotation_minimising_frames};
use crate::output::write_atomically;
use crate::recording::Table;
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use std::path::Path;

/// The centreline of one branch of a vessel: a smooth curve through given points, parameterised by the length
/// of the chords between them.
///
/// Between two points the curve is a cubic Hermite piece whose end tangents come from the parabola through
/// three neighbours, so that the tangent is continuous: a catheter that follows the curve does not kink. Beyond
/// its ends the curve goes on straight.
#[derive(Debug, Clone, PartialEq)]
pub struct Centreline {
    points_mm: Vec<DVec3>,
    arc_length_mm: Vec<f64>,
    inscribed_radius_mm: Vec<f64>,
    /// dp/ds at the points.
    slopes: Vec<DVec3>,
    /// Rotation-minimising frames every `frame_step_mm` from the first point to the last.
    frames: Vec<DMat3>,
    frame_step_mm: f64,
}

impl Centreline {
    /// The curve through `points_mm`, with the radius of the largest sphere inside the vessel at each of them.
    ///
    /// # Errors
    /// [`Error::Surface`] for fewer than two points, lists of different lengths, values that are not finite,
    /// radii that are not positive and neighbours that coincide.
    pub fn new(points_mm: Vec<DVec3>, inscribed_radius_mm: Vec<f64>) -> Result<Self> {
        let length = polyline::lengths(&points_mm).last().copied().unwrap_or_default();
        // Fine enough for the turn between two frames to be small, and no more frames than 25 m of vessel need,
        // whatever the coordinates in a file are.
        let steps = (length / 0.25).ceil().clamp(1.0, MAX_FRAME_STEPS) as usize;
        Self::with_frame_step_mm(points_mm, inscribed_radius_mm, length / steps as f64)
    }

    /// As [`Centreline::new`], with frames at the steps of another curve: where two curves begin with the same
    /// points, they have the same frames too.
    pub(super) fn with_frame_step_mm(
        points_mm: Vec<DVec3>,
        inscribed_radius_mm: Vec<f64>,
        frame_step_mm: f64,
    ) -> Result<Self> {
        if points_mm.len() < 2 || inscribed_radius_mm.len() != points_mm.len() {
            return Err(broken(
                "centreline".into(),
                format!("{} points and {} radii", points_mm.len(), inscribed_radius_mm.len()),
                "at least 2 points and a radius for each",
            ));
        }
        for (i, (p, r)) in points_mm.iter().zip(&inscribed_radius_mm).enumerate() {
            if !p.is_finite() || !r.is_finite() || *r <= 0.0 {
                return Err(broken(
                    format!("centreline point {i}"),
                    format!("{p} with radius {r}"),
                    "finite coordinates and a positive radius in mm",
                ));
            }
        }
        let chords: Vec<f64> = points_mm.windows(2).map(|p| p[0].distance(p[1])).collect();
        if let Some(i) = chords.iter().position(|&c| c <= 0.0) {
            return Err(broken(
                format!("centreline points {i} and {}", i + 1),
                "the same place twice".into(),
                "points that move on",
            ));
        }
        let arc_length_mm = polyline::lengths(&points_mm);
        let length = arc_length_mm[arc_length_mm.len() - 1];
        let mut line = Self {
            slopes: slopes(&points_mm, &chords),
            points_mm,
            arc_length_mm,
            inscribed_radius_mm,
            frames: Vec::new(),
            frame_step_mm,
        };
        // An endless length has endless steps, of which there are not a number.
        let steps = length / frame_step_mm;
        let steps =
            if steps.is_nan() { MAX_FRAME_STEPS } else { steps.round().clamp(1.0, MAX_FRAME_STEPS) } as usize;
        let (points, tangents): (Vec<_>, Vec<_>) =
            (0..=steps).map(|i| line.at(i as f64 * line.frame_step_mm)).unzip();
        line.frames = rotation_minimising_frames(&points, &tangents);
        Ok(line)
    }

    /// Reads the centrelines of a vessel from a CSV file with the columns `branch`, `x_mm`, `y_mm`, `z_mm` and
    /// `r_inscribed_mm`, one row per point; others are left alone. Lengths may be in another unit that the name
    /// states. A branch is a run of rows with the same number.
    ///
    /// # Errors
    /// [`Error::Read`], and [`Error::Input`] for rows that cannot be read and branches that
    /// [`Centreline::new`] refuses.
    pub fn read_branches(path: &Path) -> Result<Vec<Self>> {
        let mut table = Table::open(path)?;
        let branch = table.column("branch")?;
        let [x, y, z, radius] = table.columns(["x_mm", "y_mm", "z_mm", "r_inscribed_mm"], 1)?;
        let mut rows: Vec<(f64, DVec3, f64)> = Vec::new();
        while let Some(row) = table.next_row()? {
            let number = |column| table.number(&row, column);
            rows.push((number(branch)?, DVec3::new(number(x)?, number(y)?, number(z)?), number(radius)?));
        }
        if rows.is_empty() {
            return Err(Error::input(path, "rows", "none", "the points of at least one branch"));
        }
        rows.chunk_by(|(a, ..), (b, ..)| a == b)
            .map(|branch| {
                let points = branch.iter().map(|&(_, point, _)| point).collect();
                let radii = branch.iter().map(|&(.., radius)| radius).collect();
                Self::new(points, radii).map_err(|error| match error {
                    Error::Surface { what, found, expected } => {
                        Error::input(path, format!("branch {}: {what}", branch[0].0), found, expected)
                    }
                    other => other,
                })
            })
            .collect()
    }

    /// Writes the centrelines of a vessel as [`Centreline::read_branches`] reads them, with the column `s_mm`,
    /// how far along its branch a point lies. Numbers have all their digits.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_branches(branches: &[Self], path: &Path) -> Result<()> {
        write_atomically(path, |out| {
            let mut table = csv::Writer::from_writer(out);
            table.write_record(["branch", "s_mm", "x_mm", "y_mm", "z_mm", "r_inscribed_mm"])?;
            for (number, branch) in branches.iter().enumerate() {
                let along = branch.arc_length_mm.iter().zip(&branch.inscribed_radius_mm);
                for (p, (s, radius)) in branch.points_mm.iter().zip(along) {
                    let row = [*s, p.x, p.y, p.z, *radius].map(|value| value.to_string());
                    table.write_record([number.to_string()].iter().chain(&row))?;
                }
            }
            table.flush()
        })
    }

    /// How far apart frames are along the curve, mm.
    pub(super) fn frame_step_mm(&self) -> f64 {
        self.frame_step_mm
    }

    /// The points that the curve passes through, mm.
    pub fn points_mm(&self) -> &[DVec3] {
        &self.points_mm
    }

    /// Length along the curve up to each point, mm; the first is 0.
    pub fn arc_length_mm(&self) -> &[f64] {
        &self.arc_length_mm
    }

    /// Radius of the largest sphere inside the vessel at each point, mm.
    pub fn inscribed_radius_mm(&self) -> &[f64] {
        &self.inscribed_radius_mm
    }

    /// The length of the whole curve, mm.
    pub fn length_mm(&self) -> f64 {
        self.arc_length_mm.last().copied().unwrap_or_default()
    }

    /// Points of the curve at equal steps of about 1 mm, both ends among them, each with its length from the
    /// start, mm.
    pub fn every_mm(&self) -> Vec<(f64, DVec3)> {
        let whole = self.length_mm();
        let steps = whole.ceil().max(1.0) as usize;
        (0..=steps).map(|i| i as f64 / steps as f64 * whole).map(|s| (s, self.at(s).0)).collect()
    }

    /// The point `s_mm` along the curve, mm, and the unit tangent there.
    pub fn at(&self, s_mm: f64) -> (DVec3, DVec3) {
        let i = self.piece(s_mm);
        let (s0, h) = (self.arc_length_mm[i], self.arc_length_mm[i + 1] - self.arc_length_mm[i]);
        let (p0, p1) = (self.points_mm[i], self.points_mm[i + 1]);
        let (m0, m1) = (self.slopes[i] * h, self.slopes[i + 1] * h);
        let u = ((s_mm - s0) / h).clamp(0.0, 1.0);
        let (u2, u3) = (u * u, u * u * u);
        let point = p0 * (2.0 * u3 - 3.0 * u2 + 1.0)
            + m0 * (u3 - 2.0 * u2 + u)
            + p1 * (3.0 * u2 - 2.0 * u3)
            + m1 * (u3 - u2);
        let slope =
            (p1 - p0) * (6.0 * (u - u2)) + m0 * (3.0 * u2 - 4.0 * u + 1.0) + m1 * (3.0 * u2 - 2.0 * u);
        let tangent = slope.try_normalize().unwrap_or_else(|| (p1 - p0).normalize());
        let beyond = s_mm - s_mm.clamp(0.0, self.length_mm());
        (point + tangent * beyond, tangent)
    }

    /// The rotation-minimising frame `s_mm` along the curve: origin on it, z along its tangent.
    pub fn frame(&self, s_mm: f64) -> Pose {
        let (point, z) = self.at(s_mm);
        let nearest = (s_mm / self.frame_step_mm).round().clamp(0.0, (self.frames.len() - 1) as f64) as usize;
        let x = self.frames[nearest].x_axis;
        let x = (x - z * x.dot(z)).normalize();
        Pose { rotation: DMat3::from_cols(x, z.cross(x), z), translation_mm: point }
    }

    /// The inscribed radius `s_mm` along the curve, mm, interpolated linearly and constant beyond the ends.
    pub fn inscribed_radius_at_mm(&self, s_mm: f64) -> f64 {
        let i = self.piece(s_mm);
        let (s0, s1) = (self.arc_length_mm[i], self.arc_length_mm[i + 1]);
        let u = ((s_mm - s0) / (s1 - s0)).clamp(0.0, 1.0);
        self.inscribed_radius_mm[i] * (1.0 - u) + self.inscribed_radius_mm[i + 1] * u
    }

    /// The median of the inscribed radii at the points, mm.
    pub fn median_radius_mm(&self) -> f64 {
        let mut radii = self.inscribed_radius_mm.clone();
        radii.sort_by(f64::total_cmp);
        radii[radii.len() / 2]
    }

    /// How far along the curve its point nearest to `point_mm` lies, looking no further than `reach_mm` from
    /// `s_mm`.
    pub fn nearest_mm(&self, point_mm: DVec3, s_mm: f64, reach_mm: f64) -> f64 {
        let (low, high) = (s_mm - reach_mm, s_mm + reach_mm);
        let steps = ((high - low) / 0.5).ceil().clamp(1.0, 1e4) as usize;
        let station = |i: usize| low + (high - low) * i as f64 / steps as f64;
        let distance = |s: f64| self.at(s).0.distance_squared(point_mm);
        let mut s =
            (0..=steps).map(station).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(s_mm);
        for _ in 0..4 {
            let (p, t) = self.at(s);
            s = (s + (point_mm - p).dot(t)).clamp(low, high);
        }
        s
    }

    /// The piece that holds `s_mm`: the index of its first point, never that of the last point.
    fn piece(&self, s_mm: f64) -> usize {
        self.arc_length_mm.partition_point(|&s| s <= s_mm).clamp(1, self.arc_length_mm.len() - 1) - 1
    }
}

/// The most frames along a curve.
const MAX_FRAME_STEPS: f64 = 1e5;

/// Derivatives at the points of the parabola through each point and its two neighbours.
fn slopes(points: &[DVec3], chords: &[f64]) -> Vec<DVec3> {
    let d = |i: usize| (points[i + 1] - points[i]) / chords[i];
    let last = points.len() - 1;
    let inner = |i: usize| (d(i - 1) * chords[i] + d(i) * chords[i - 1]) / (chords[i - 1] + chords[i]);
    (0..=last)
        .map(|i| match i {
            _ if last == 1 => d(0),
            0 => d(0) * 2.0 - inner(1),
            i if i == last => d(last - 1) * 2.0 - inner(last - 1),
            i => inner(i),
        })
        .collect()
}

fn broken(what: String, found: String, expected: &str) -> Error {
    Error::Surface { what, found, expected: expected.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quarter_circle() -> Centreline {
        let points: Vec<DVec3> = (0..=50)
            .map(|i| f64::from(i) / 50.0 * std::f64::consts::FRAC_PI_2)
            .map(|a| DVec3::new(30.0 * a.cos(), 30.0 * a.sin(), 0.0))
            .collect();
        Centreline::new(points, vec![5.0; 51]).unwrap()
    }

    #[test]
    fn between_its_points_the_curve_stays_on_the_circle() {
        let line = quarter_circle();
        for i in 0..500 {
            let s = f64::from(i) / 499.0 * line.length_mm();
            let (p, t) = line.at(s);
            assert!((p.length() - 30.0).abs() < 1e-3, "{}", p.length());
            assert!(t.dot(p.normalize()).abs() < 1e-2);
            assert!(line.frame(s).orthogonality_error() < 1e-12);
        }
    }

    #[test]
    fn beyond_its_ends_the_curve_goes_on_straight() {
        let line = quarter_circle();
        let (p0, t0) = line.at(0.0);
        let (p, t) = line.at(-7.0);
        assert!(p.abs_diff_eq(p0 - t0 * 7.0, 1e-12) && t == t0);
    }

    #[test]
    fn the_nearest_point_is_found_from_the_side() {
        let line = quarter_circle();
        let (p, _) = line.at(20.3);
        assert!((line.nearest_mm(p * 0.8, 17.0, 15.0) - 20.3).abs() < 1e-2);
    }

    #[test]
    fn the_frames_of_an_endless_curve_are_bounded() {
        let line = Centreline::new(vec![DVec3::ZERO, DVec3::X * 1e300], vec![1.0; 2]).unwrap();
        assert_eq!(line.frames.len(), 100_001);
    }

    #[test]
    fn coinciding_points_are_refused() {
        let error = Centreline::new(vec![DVec3::ZERO, DVec3::X, DVec3::X], vec![1.0; 3]).unwrap_err();
        assert!(error.to_string().contains("points 1 and 2: found the same place twice"), "{error}");
    }
}
