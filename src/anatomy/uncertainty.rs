//! Standard errors of what is measured of an outline, from those of the nodes about it.
//!
//! Neighbouring nodes err alike. The error of a smoothing spline's value correlates as
//! ρ(u) = e^(-u/√2ℓ) (cos u/√2ℓ + sin u/√2ℓ) over a distance u. Of an outline of length C, half of which is a = C/2√2ℓ, the
//! integral of ρ is L = 2√2ℓ (1 - e^-a cos a); nodes have it as `error_reach_mm`. A measure's error is a weighted sum of the
//! errors of the outline's points, so that its variance is a double sum over them.

use glam::DVec2;

/// The error of a point of an outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PointError {
    pub standard_error_mm: f64,
    /// Distance along the outline over which errors are alike, mm: the integral of their correlation.
    pub reach_mm: f64,
}

/// √2ℓ, mm, of a reach L on an outline of length C.
fn decay_mm(reach_mm: f64, outline_mm: f64) -> f64 {
    let integral = |decay: f64| {
        let a = outline_mm / (2.0 * decay);
        2.0 * decay * (1.0 - (-a).exp() * a.cos())
    };
    // The integral exceeds an infinite line's, 2√2ℓ, by at most 7 %, and tends to C.
    let (mut low, mut high) = (reach_mm / 4.0, reach_mm / 2.0);
    while integral(high) < reach_mm && high < 1e3 * outline_mm {
        high *= 2.0;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if integral(middle) < reach_mm { low = middle } else { high = middle }
    }
    high
}

fn correlation(distance_mm: f64, decay_mm: f64) -> f64 {
    let u = distance_mm / decay_mm;
    if u > 30.0 { 0.0 } else { (-u).exp() * (u.cos() + u.sin()) }
}

/// An outline whose points err along their rays from its centroid.
pub(super) struct Outline<'a> {
    points_mm: &'a [DVec2],
    centroid_mm: DVec2,
    /// Per pair of points: the covariance of their errors, mm².
    covariance: Vec<f64>,
}

impl<'a> Outline<'a> {
    /// `None` where a point's standard error is not known.
    pub(super) fn with_errors(
        points_mm: &'a [DVec2],
        centroid_mm: DVec2,
        errors: &[PointError],
    ) -> Option<Self> {
        let is_known = |e: &PointError| e.standard_error_mm.is_finite() && e.reach_mm > 0.0;
        if !errors.iter().all(is_known) {
            return None;
        }
        let count = points_mm.len();
        let mut along = vec![0.0; count + 1];
        for i in 0..count {
            along[i + 1] = along[i] + points_mm[i].distance(points_mm[(i + 1) % count]);
        }
        let whole = along[count];
        let decays: Vec<f64> = errors.iter().map(|error| decay_mm(error.reach_mm, whole)).collect();
        let mut covariance = vec![0.0; count * count];
        for i in 0..count {
            for j in i..count {
                let apart = along[j] - along[i];
                let alike = correlation(apart.min(whole - apart), 0.5 * (decays[i] + decays[j]));
                let value = errors[i].standard_error_mm * errors[j].standard_error_mm * alike;
                covariance[i * count + j] = value;
                covariance[j * count + i] = value;
            }
        }
        Some(Self { points_mm, centroid_mm, covariance })
    }

    /// The standard error of the sum of the points' errors, each with its weight.
    fn error_of(&self, weight: impl Fn(usize) -> f64) -> f64 {
        let count = self.points_mm.len();
        let weights: Vec<f64> = (0..count).map(weight).collect();
        let rows = self.covariance.chunks_exact(count);
        let variance: f64 = weights
            .iter()
            .zip(rows)
            .filter(|(w, _)| **w != 0.0)
            .map(|(w, row)| w * row.iter().zip(&weights).map(|(c, w)| c * w).sum::<f64>())
            .sum();
        variance.max(0.0).sqrt()
    }

    fn neighbours(&self, i: usize) -> [DVec2; 2] {
        let count = self.points_mm.len();
        [self.points_mm[(i + count - 1) % count], self.points_mm[(i + 1) % count]]
    }

    fn ray(&self, i: usize) -> DVec2 {
        (self.points_mm[i] - self.centroid_mm).normalize_or_zero()
    }

    /// How much area a unit of point i's error adds, mm.
    fn width(&self, i: usize) -> f64 {
        let [before, after] = self.neighbours(i);
        (0.5 * self.ray(i).perp_dot(after - before)).abs()
    }

    pub(super) fn error_of_area(&self) -> f64 {
        self.error_of(|i| self.width(i))
    }

    pub(super) fn error_of_perimeter(&self) -> f64 {
        self.error_of(|i| {
            let p = self.points_mm[i];
            let [before, after] = self.neighbours(i);
            self.ray(i).dot((p - before).normalize_or_zero() + (p - after).normalize_or_zero())
        })
    }

    pub(super) fn errors_of_centroid(&self, area_mm2: f64) -> [f64; 2] {
        let offset = |i: usize| (self.points_mm[i] - self.centroid_mm) * self.width(i) / area_mm2;
        [self.error_of(|i| offset(i).x), self.error_of(|i| offset(i).y)]
    }

    fn nearest(&self, point_mm: DVec2) -> usize {
        let distance = |i: &usize| self.points_mm[*i].distance_squared(point_mm);
        (0..self.points_mm.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    pub(super) fn error_of_chord(&self, ends_mm: [DVec2; 2]) -> f64 {
        let ends = ends_mm.map(|end| self.nearest(end));
        self.error_of(|i| ends.iter().filter(|&&end| end == i).count() as f64)
    }

    /// Of the diameter of a circle that touches the outline: twice the mean of the points that it nearly touches.
    pub(super) fn error_of_circle(&self, centre_mm: DVec2, radius_mm: f64) -> f64 {
        /// How near, in radii.
        const NEARLY: f64 = 0.02;
        let touches = |i: usize| {
            let away = self.points_mm[i].distance(centre_mm) - radius_mm;
            i == self.nearest(centre_mm) || away <= NEARLY * radius_mm
        };
        let touching: Vec<bool> = (0..self.points_mm.len()).map(touches).collect();
        let count = touching.iter().filter(|&&t| t).count() as f64;
        self.error_of(|i| if touching[i] { 2.0 / count } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn circle(radius: f64, count: u32) -> Vec<DVec2> {
        (0..count).map(|k| DVec2::from_angle(f64::from(k) / f64::from(count) * TAU) * radius).collect()
    }

    #[test]
    fn errors_of_a_circle_are_those_of_the_formulas() {
        let points = circle(10.0, 400);
        let sd = 0.1;
        let with =
            |standard_error_mm, reach_mm| vec![PointError { standard_error_mm, reach_mm }; points.len()];
        let of = |reach_mm| Outline::with_errors(&points, DVec2::ZERO, &with(sd, reach_mm)).unwrap();
        for reach in [1.0, 4.0, 12.0, 30.0] {
            let outline = of(reach);
            // ∮∮ ρ: the circumference times the reach.
            let area = sd * (TAU * 10.0 * reach).sqrt();
            assert!(
                (outline.error_of_area() / area - 1.0).abs() < 0.01,
                "{} {area}",
                outline.error_of_area()
            );
            // 2π times the error of the mean radius.
            assert!((outline.error_of_perimeter() / (area / 10.0) - 1.0).abs() < 0.01);
            let [x, y] = outline.errors_of_centroid(100.0 * TAU / 2.0);
            assert!((x / y - 1.0).abs() < 0.01 && x < sd, "{x} {y}");
        }
        let chord = of(4.0).error_of_chord([DVec2::X * 10.0, DVec2::X * -10.0]);
        assert!((chord / (sd * 2.0_f64.sqrt()) - 1.0).abs() < 0.01, "{chord}");
        // Errors that are all alike make a larger circle.
        assert!((of(TAU * 10.0).error_of_area() / (sd * TAU * 10.0) - 1.0).abs() < 0.01);
        assert!((of(TAU * 10.0).error_of_circle(DVec2::ZERO, 10.0) / (2.0 * sd) - 1.0).abs() < 0.01);
        for unknown in [with(f64::INFINITY, 1.0), with(sd, f64::NAN)] {
            assert!(Outline::with_errors(&points, DVec2::ZERO, &unknown).is_none());
        }
    }
}
