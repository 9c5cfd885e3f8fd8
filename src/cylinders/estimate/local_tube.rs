//! A short piece of vessel as a bent, tapering tube with a section that need not be round.

use crate::geometry::Pose;
use crate::recording::echo_error::{OUT_OF_PLANE, likeliest_direction};
use glam::{DMat3, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Number of parameters of a [`LocalTube`], in the order of [`Change`].
pub(crate) const PARAMETERS: usize = 12;

/// Changes of the parameters: centre (2, mm), slope (2), bend (2, 1/mm), radius (mm), taper, oval (2, mm) and lobes (2, mm).
pub(crate) type Change = [f64; PARAMETERS];

/// A short tube that bends, tapers and is not quite round. In its own coordinates, the axis is the parabola (b z²/2, z) and
/// the radius is R + t z + o·(cos 2φ, sin 2φ) + l·(cos 3φ, sin 3φ).
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct LocalTube {
    /// Origin on the tube's axis, z along it.
    pub world_from_axis: Pose,
    /// b: the axis's curvature at the origin.
    pub bend_per_mm: DVec2,
    pub radius_mm: f64,
    pub taper: f64,
    pub oval_mm: DVec2,
    pub lobes_mm: DVec2,
}

/// The residual of an echo from the wall of a tube.
pub(crate) struct TubeResidual {
    /// Distance outside the wall along its normal, mm.
    pub distance_mm: f64,
    /// Variance of that distance, in units of the echo's variance within its image plane.
    pub variance: f64,
    /// Station along the axis of the likeliest point of the wall, mm.
    pub s_mm: f64,
    /// Derivatives of the wall's distance from the axis there by each parameter; the first two are its normal.
    pub gain: Change,
}

impl TubeResidual {
    /// The standardised residual: the distance divided by its standard deviation, in mm of noise within the image plane.
    pub fn residual_mm(&self) -> f64 {
        self.distance_mm / self.variance.sqrt()
    }
}

impl LocalTube {
    pub fn straight(world_from_axis: Pose, radius_mm: f64) -> Self {
        Self {
            world_from_axis,
            bend_per_mm: DVec2::ZERO,
            radius_mm,
            taper: 0.0,
            oval_mm: DVec2::ZERO,
            lobes_mm: DVec2::ZERO,
        }
    }

    /// z of the point of the axis nearest to `p`, given in the tube's coordinates; two Newton steps.
    pub fn station(&self, p: DVec3) -> f64 {
        (0..2).fold(p.z, |s, _| {
            let along = (self.bend_per_mm * s).extend(1.0);
            let away = p - self.on_axis(s);
            let fall = along.length_squared();
            // Behind the centre of curvature there is no nearest point: steps are limited.
            s + away.dot(along) / (fall - away.truncate().dot(self.bend_per_mm)).max(0.3 * fall)
        })
    }

    /// Distance of `p`, given in the tube's coordinates, outside the wall, mm.
    pub fn distance_mm(&self, p: DVec3) -> f64 {
        self.projection(p).distance_mm
    }

    /// The residual of an echo at `p`, given in the tube's coordinates, along its error ellipsoid
    /// ([`likeliest_direction`]); the likeliest point of the wall is sought at most `reach_mm` away.
    ///
    /// Plain distances would shrink as the tube leans against its frames, so every fit would lean.
    pub fn residual_of(&self, p: DVec3, image_normal: DVec3, reach_mm: f64) -> TubeResidual {
        let Projection { s, normal: n, waves, distance_mm } = self.projection(p);
        let (likeliest, variance) = likeliest_direction(n, image_normal, OUT_OF_PLANE);
        let along = (self.bend_per_mm * s).extend(1.0);
        let shift = distance_mm.clamp(-reach_mm, reach_mm) / variance;
        let s = s - shift * likeliest.dot(along) / along.length_squared();
        let half = 0.5 * s * s;
        let [c2, s2, c3, s3] = waves;
        let gain = [n.x, n.y, n.x * s, n.y * s, n.x * half, n.y * half, 1.0, s, c2, s2, c3, s3];
        TubeResidual { distance_mm, variance, s_mm: s, gain }
    }

    fn on_axis(&self, s: f64) -> DVec3 {
        (self.bend_per_mm * (0.5 * s * s)).extend(s)
    }

    fn projection(&self, p: DVec3) -> Projection {
        let s = self.station(p);
        let away = p - self.on_axis(s);
        let distance = away.length();
        let normal = if distance > 0.0 { away / distance } else { DVec3::X };
        let first = normal.truncate().try_normalize().unwrap_or(DVec2::X);
        let second = first.rotate(first);
        let third = second.rotate(first);
        let wall = self.radius_mm + self.taper * s + self.oval_mm.dot(second) + self.lobes_mm.dot(third);
        let waves = [second.x, second.y, third.x, third.y];
        Projection { s, normal, waves, distance_mm: distance - wall }
    }

    /// The tube with changed parameters; its z axis follows the slope.
    #[must_use]
    pub fn changed(&self, by: &Change) -> Self {
        let [cx, cy, slope_x, slope_y, bx, by, radius, taper, o1, o2, l1, l2] = *by;
        let slope = DVec3::new(slope_x, slope_y, 1.0).normalize();
        let turn = Pose {
            rotation: DMat3::from_quat(DQuat::from_rotation_arc(DVec3::Z, slope)),
            translation_mm: DVec3::new(cx, cy, 0.0),
        };
        Self {
            world_from_axis: self.world_from_axis * turn,
            bend_per_mm: self.bend_per_mm + DVec2::new(bx, by),
            radius_mm: self.radius_mm + radius,
            taper: self.taper + taper,
            oval_mm: self.oval_mm + DVec2::new(o1, o2),
            lobes_mm: self.lobes_mm + DVec2::new(l1, l2),
        }
    }

    /// The same tube described from the point of its axis at z = `s`.
    #[must_use]
    pub fn moved(&self, s: f64) -> Self {
        let (centre, slope) = (self.bend_per_mm * (0.5 * s * s), self.bend_per_mm * s);
        let mut change = [0.0; PARAMETERS];
        change[..4].copy_from_slice(&[centre.x, centre.y, slope.x, slope.y]);
        change[6] = self.taper * s;
        let mut moved = self.changed(&change);
        moved.world_from_axis.translation_mm += self.world_from_axis.rotation.z_axis * s;
        moved
    }

    /// Whether all parameters are finite and the radius is positive.
    pub fn is_sound(&self) -> bool {
        self.world_from_axis.is_finite()
            && self.bend_per_mm.is_finite()
            && self.taper.is_finite()
            && self.oval_mm.is_finite()
            && self.lobes_mm.is_finite()
            && self.radius_mm > 0.0
            && self.radius_mm.is_finite()
    }
}

/// The projection of a point onto the wall, through the nearest point of the axis.
struct Projection {
    /// Station of that point, mm.
    s: f64,
    /// Unit vector from the axis to the point.
    normal: DVec3,
    /// cos 2φ, sin 2φ, cos 3φ, sin 3φ.
    waves: [f64; 4],
    /// Distance outside the wall, mm.
    distance_mm: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tube() -> LocalTube {
        let turned = DQuat::from_rotation_x(0.5) * DQuat::from_rotation_z(2.0);
        LocalTube {
            bend_per_mm: DVec2::new(0.02, -0.01),
            taper: 0.05,
            oval_mm: DVec2::new(0.3, -0.2),
            lobes_mm: DVec2::new(0.1, 0.2),
            ..LocalTube::straight(Pose::from_quaternion(DVec3::new(1.0, 2.0, 3.0), turned), 10.0)
        }
    }

    fn distance_mm(tube: &LocalTube, world: DVec3) -> f64 {
        tube.distance_mm(tube.world_from_axis.inverse().transform_point(world))
    }

    #[test]
    fn gains_are_the_derivatives_of_the_distance() {
        // Waves would turn with the slope: an effect of second order in the shape.
        let tube = LocalTube { oval_mm: DVec2::ZERO, lobes_mm: DVec2::ZERO, taper: 0.0, ..tube() };
        let p = DVec3::new(7.0, 8.0, 3.0);
        let world = tube.world_from_axis.transform_point(p);
        // No reach: the wall right under the point.
        let residual = tube.residual_of(p, DVec3::Z, 0.0);
        for i in 0..PARAMETERS {
            let h = 1e-5;
            let stepped = |h: f64| {
                let mut change = [0.0; PARAMETERS];
                change[i] = h;
                distance_mm(&tube.changed(&change), world)
            };
            let slope = (stepped(-h) - stepped(h)) / (2.0 * h);
            assert!(
                (slope - residual.gain[i]).abs() < 0.02 * (1.0 + slope.abs()),
                "{i}: {slope} {}",
                residual.gain[i]
            );
        }
    }

    #[test]
    fn a_tube_is_the_same_from_another_place() {
        let tube = tube();
        let moved = tube.moved(2.0);
        for p in [DVec3::new(9.0, 1.0, 0.0), DVec3::new(-5.0, 8.0, 3.0)] {
            let world = tube.world_from_axis.transform_point(p);
            let (here, there) = (distance_mm(&tube, world), distance_mm(&moved, world));
            assert!((here - there).abs() < 0.03, "{here} {there}");
        }
    }

    #[test]
    fn a_slanting_image_makes_distances_less_certain_than_they_look() {
        let straight = LocalTube::straight(Pose::IDENTITY, 10.0);
        let across = straight.residual_of(DVec3::new(10.5, 0.0, 0.0), DVec3::Z, 1.0);
        assert!((across.variance - 1.0).abs() < 1e-12 && across.s_mm == 0.0);
        let normal = DVec3::new(0.6, 0.0, 0.8);
        let slanting = straight.residual_of(DVec3::new(10.5, 0.0, 0.0), normal, 1.0);
        assert!((slanting.variance - (1.0 - 0.9 * 0.36)).abs() < 1e-12);
        // Noise moved the echo along the image: it came from farther up the wall.
        let expected = 0.5 / slanting.variance * 0.9 * 0.6 * 0.8;
        assert!((slanting.s_mm - expected).abs() < 1e-12, "{}", slanting.s_mm);
    }
}
