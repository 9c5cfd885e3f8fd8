//! Natural cubic splines.

use glam::DVec3;

/// A natural cubic spline through points, straight beyond its ends.
pub(crate) struct NaturalSpline<'a> {
    points: &'a [DVec3],
    lengths: Vec<f64>,
    /// Second derivatives at the points.
    bends: Vec<DVec3>,
}

impl<'a> NaturalSpline<'a> {
    /// The spline through at least two points. Its parameter is `lengths`: the length of the polyline through the points up
    /// to each of them, from 0, strictly increasing.
    pub(crate) fn through(points: &'a [DVec3], lengths: Vec<f64>) -> Self {
        let count = points.len();
        let mut bends = vec![DVec3::ZERO; count];
        // Thomas algorithm for the continuity of the first derivative; the matrix is diagonally dominant.
        let mut upper = vec![0.0; count];
        for i in 1..count.saturating_sub(1) {
            let (before, after) = (lengths[i] - lengths[i - 1], lengths[i + 1] - lengths[i]);
            let jump = (points[i + 1] - points[i]) / after - (points[i] - points[i - 1]) / before;
            let pivot = (before + after) / 3.0 - before / 6.0 * upper[i - 1];
            upper[i] = after / 6.0 / pivot;
            bends[i] = (jump - bends[i - 1] * (before / 6.0)) / pivot;
        }
        for i in (1..count.saturating_sub(1)).rev() {
            bends[i] = bends[i] - bends[i + 1] * upper[i];
        }
        Self { points, lengths, bends }
    }

    /// The parameter of the last point.
    pub(crate) fn length(&self) -> f64 {
        self.lengths[self.lengths.len() - 1]
    }

    /// Point and unit tangent at parameter `s`.
    pub(crate) fn at(&self, s: f64) -> (DVec3, DVec3) {
        let inside = s.clamp(0.0, self.length());
        let k = self.lengths.partition_point(|&l| l <= inside).clamp(1, self.points.len() - 1) - 1;
        let h = self.lengths[k + 1] - self.lengths[k];
        let b = (inside - self.lengths[k]) / h;
        let a = 1.0 - b;
        let (p, q, m, n) = (self.points[k], self.points[k + 1], self.bends[k], self.bends[k + 1]);
        let point = p * a + q * b + (m * (a * a * a - a) + n * (b * b * b - b)) * (h * h / 6.0);
        let slope = (q - p) / h + (n * (3.0 * b * b - 1.0) - m * (3.0 * a * a - 1.0)) * (h / 6.0);
        let tangent = slope.normalize_or(DVec3::Z);
        (point + tangent * (s - inside), tangent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spline_meets_its_points_and_goes_on_straight() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 2.0, 0.0), DVec3::new(0.0, 2.0, 1.0)];
        let lengths = vec![0.0, 1.0, 3.0, 3.0 + 2.0_f64.sqrt()];
        let spline = NaturalSpline::through(&points, lengths.clone());
        for (point, s) in points.iter().zip(&lengths) {
            assert!(spline.at(*s).0.distance(*point) < 1e-12, "{s}");
        }
        let (end, tangent) = spline.at(spline.length());
        let (beyond, same) = spline.at(spline.length() + 2.0);
        assert!(beyond.distance(end + tangent * 2.0) < 1e-12 && same == tangent);
    }
}
