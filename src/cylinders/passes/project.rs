//! Probe points to tube coordinates, and the gate (docs/method.md, "Local cylinder fit").

use super::Gate;
use crate::geometry::Pose;
use crate::numerics::Scalar;
use bytemuck::{Pod, Zeroable};
use glam::{DVec2, DVec3};

/// From the probe's plane to the tube's Cartesian axes X, Y, Z: the transform `cylTi` of one pair of cylinder
/// and frame, including the turn by -90° about y (X = -qz, Y = qy, Z = qx). It is formed in f64, because f32
/// would lose precision in world coordinates of hundreds of mm.
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

/// `Pair` of the shaders: the points of one frame and their transform into one cylinder.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct DevicePair {
    /// Image of the probe's x axis on the tube's X, Y, Z.
    pub x: [f32; 3],
    /// Image of the probe's y axis.
    pub y: [f32; 3],
    /// Image of the probe's origin, mm.
    pub origin: [f32; 3],
    /// The cylinder in the batch.
    pub cylinder: u32,
    /// Its frame's first point.
    pub first_point: u32,
    /// Its frame's number of points.
    pub count: u32,
    /// Slot of its first point.
    pub first_slot: u32,
    /// Padding to a multiple of 16 bytes.
    pub unused: [u32; 3],
}

impl DevicePair {
    /// The pair of a cylinder and a frame with `count` points from `first_point` on.
    pub fn new(
        cylinder_from_probe: &Pose,
        cylinder: u32,
        first_point: u32,
        count: u32,
        first_slot: u32,
    ) -> Self {
        let TubeTransform { x, y, origin } = TubeTransform::<f32>::new(cylinder_from_probe);
        Self { x, y, origin, cylinder, first_point, count, first_slot, unused: [0; 3] }
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

/// Appends those of a frame's points that pass the gate to `section`.
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
            // The origin comes first: drivers move the part that all points of a frame share inwards.
            xs[i] = (o[0] + ex[0] * px) + ey[0] * py;
            ys[i] = (o[1] + ex[1] * px) + ey[1] * py;
            zs[i] = (o[2] + ex[2] * px) + ey[2] * py;
            rs[i] = (xs[i] * xs[i] + ys[i] * ys[i]).sqrt();
        }
        // Pack the points that pass to the front, so that the arc tangent is computed for them alone.
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
