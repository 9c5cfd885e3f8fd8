//! Curves from their curvature.

use glam::{DMat3, DQuat, DVec2, DVec3};

/// A curve from its curvature, with rotation-minimising frames: turning the frame only about axes across the
/// tangent is what makes it so.
pub(super) struct Curve {
    step_mm: f64,
    pub points: Vec<DVec3>,
    frames: Vec<DMat3>,
}

impl Curve {
    pub fn integrate(length_mm: f64, curvature: impl Fn(f64) -> DVec2) -> Self {
        let steps = (length_mm / 0.05 - 1e-6).ceil() as usize;
        let h = length_mm / steps as f64;
        let (mut point, mut frame) = (DVec3::ZERO, DMat3::IDENTITY);
        let (mut points, mut frames) = (vec![point], vec![frame]);
        for i in 0..steps {
            let k = curvature((i as f64 + 0.5) * h);
            let turn =
                |length: f64| DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(-k.y, k.x, 0.0) * length));
            // Over a step of constant curvature the chord has the direction of the middle's tangent.
            let half = 0.5 * h * k.length();
            let chord = if half > 1e-9 { half.sin() / half * h } else { h };
            point += (frame * turn(0.5 * h)).z_axis * chord;
            frame *= turn(h);
            points.push(point);
            frames.push(frame);
        }
        Self { step_mm: h, points, frames }
    }

    /// The point at `s_mm` and the frame of the step nearest to it. The straight way on from that step is at
    /// most half a step long, so the point errs by less than 1e-4 mm on any curve that a phantom has.
    pub fn at(&self, s_mm: f64) -> (DVec3, DMat3) {
        let i = ((s_mm / self.step_mm).round() as usize).min(self.points.len() - 1);
        let frame = self.frames[i];
        (self.points[i] + frame.z_axis * (s_mm - i as f64 * self.step_mm), frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn a_curve_of_constant_curvature_is_a_circle() {
        let curve = Curve::integrate(35.0 * PI, |_| DVec2::new(1.0 / 35.0, 0.0));
        let (end, frame) = curve.at(35.0 * PI);
        assert!(end.abs_diff_eq(DVec3::new(70.0, 0.0, 0.0), 1e-9), "{end}");
        assert!(frame.z_axis.abs_diff_eq(-DVec3::Z, 1e-9));
    }
}
