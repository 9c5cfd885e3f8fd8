//! Probe points to tube coordinates, and the gate (method, sections 1 and 3).

use crate::geometry::Pose;
use crate::numerics::Scalar;
use crate::settings::Settings;
use glam::{DVec2, DVec3};

/// From the probe's plane to the tube's Cartesian axes X, Y, Z: the transform `cylTi` of one pair of cylinder
/// and frame, with the turn by -90° about y folded in (X = -qz, Y = qy, Z = qx). Formed in f64, because world
/// coordinates of hundreds of mm would cost f32 its digits.
#[derive(Debug, Clone, Copy)]
pub struct TubeTransform<T> {
    /// Image of the probe's x axis.
    pub x: [T; 3],
    /// Image of the probe's y axis.
    pub y: [T; 3],
    /// Image of the probe's origin, mm.
    pub origin: [T; 3],
}

impl<T: Scalar> TubeTransform<T> {
    /// The transform of a pose `cylTi`.
    pub fn new(cylinder_from_probe: &Pose) -> Self {
        let tube = |q: DVec3| [-q.z, q.y, q.x].map(T::from_f64);
        Self {
            x: tube(cylinder_from_probe.rotation.x_axis),
            y: tube(cylinder_from_probe.rotation.y_axis),
            origin: tube(cylinder_from_probe.translation_mm),
        }
    }
}

/// Which points of a tube count: |z| up to half the height, r between two bounds, all in mm.
#[derive(Debug, Clone, Copy)]
pub struct Gate<T> {
    /// H/2.
    pub half_height: T,
    /// Least radius.
    pub low: T,
    /// Greatest radius.
    pub high: T,
}

impl<T: Scalar> Gate<T> {
    /// The gate of a cylinder of that radius.
    pub fn new(settings: &Settings, radius_mm: f64) -> Self {
        Self {
            half_height: T::from_f64(settings.height_mm / 2.0),
            low: T::from_f64(settings.gate[0] * radius_mm),
            high: T::from_f64(settings.gate[1] * radius_mm),
        }
    }
}

/// The points of one cylinder in tube coordinates: r and z in mm, θ in rad, one entry each per point.
#[derive(Debug, Clone, Default)]
pub struct Section<T> {
    /// Distances from the axis, mm.
    pub r: Vec<T>,
    /// Angles in [0, 2π), rad.
    pub theta: Vec<T>,
    /// Positions along the axis, mm.
    pub z: Vec<T>,
    /// Points that lie within the height but outside the radial gate.
    pub gated: u64,
}

impl<T: Scalar> Section<T> {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.r.len()
    }

    /// Whether there is no point at all.
    pub fn is_empty(&self) -> bool {
        self.r.is_empty()
    }
}

/// Appends to `section` those of a frame's points that pass the gate.
pub fn project<T: Scalar>(
    points_mm: &[DVec2],
    transform: &TubeTransform<T>,
    gate: &Gate<T>,
    section: &mut Section<T>,
) {
    const BLOCK: usize = 128;
    let TubeTransform { x: ex, y: ey, origin: o } = *transform;
    for points in points_mm.chunks(BLOCK) {
        let mut block = [[T::default(); BLOCK]; 4];
        let [xs, ys, zs, rs] = &mut block;
        for (i, p) in points.iter().enumerate() {
            let (px, py) = (T::from_f64(p.x), T::from_f64(p.y));
            // The origin comes first: drivers move what is the same for all points of a frame inwards.
            xs[i] = (o[0] + ex[0] * px) + ey[0] * py;
            ys[i] = (o[1] + ex[1] * px) + ey[1] * py;
            zs[i] = (o[2] + ex[2] * px) + ey[2] * py;
            rs[i] = (xs[i] * xs[i] + ys[i] * ys[i]).sqrt();
        }
        // Pack what passes to the front, then spend the arc tangent on that alone.
        let mut kept = 0;
        for i in 0..points.len() {
            let (x, y, z, r) = (xs[i], ys[i], zs[i], rs[i]);
            let within = -gate.half_height <= z && z <= gate.half_height;
            let passes = within && gate.low <= r && r <= gate.high;
            section.gated += u64::from(within && !passes);
            (xs[kept], ys[kept], zs[kept], rs[kept]) = (x, y, z, r);
            kept += usize::from(passes);
        }
        section.r.extend_from_slice(&rs[..kept]);
        section.z.extend_from_slice(&zs[..kept]);
        section.theta.extend(ys[..kept].iter().zip(&xs[..kept]).map(|(&y, &x)| T::angle(y, x)));
    }
}
