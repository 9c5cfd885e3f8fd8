//! Points and tracks to fit, made from seeds.

use glam::{DQuat, DVec2, DVec3};
use lumenmesh::geometry::Pose;
use lumenmesh::low_level::cylinders::passes::Section;
use lumenmesh::recording::CylinderModel;
use lumenmesh::recording::{Frame, Recording};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

pub fn seeded(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Radius of the primitive tubes, mm.
pub const RADIUS_MM: f64 = 12.0;

/// Points of a rough wall about a tube of [`RADIUS_MM`], all within the default height and gate.
pub fn wall(points: usize, seed: u64) -> Section<f32> {
    patch(points, seed, 0.0..TAU, -5.0..5.0)
}

/// The part of such a wall with some angles and heights.
pub fn patch(points: usize, seed: u64, theta: std::ops::Range<f64>, z: std::ops::Range<f64>) -> Section<f32> {
    let mut rng = seeded(seed);
    let mut section = Section::default();
    for _ in 0..points {
        let (theta, z) = (rng.random_range(theta.clone()), rng.random_range(z.clone()));
        let bulge = 1.0 + 0.1 * (2.0 * theta).sin() + 0.05 * z.sin();
        let outlier = if rng.random_range(0.0..1.0) < 0.03 { rng.random_range(-3.0..3.0) } else { 0.0 };
        let r = RADIUS_MM * bulge + rng.random_range(-0.5..0.5) + outlier;
        section.r.push(r as f32);
        section.theta.push(theta as f32);
        section.z.push(z as f32);
    }
    section
}

/// Two sections as one.
pub fn both(mut a: Section<f32>, b: &Section<f32>) -> Section<f32> {
    a.r.extend(&b.r);
    a.theta.extend(&b.theta);
    a.z.extend(&b.z);
    a
}

/// r of all points, then θ, then z, as a device holds them.
pub fn coordinates(section: &Section<f32>) -> Vec<f32> {
    [&section.r[..], &section.theta, &section.z].concat()
}

/// A pullback through a wavy vessel: `frames` frames 0.4 mm apart with `rays` rays each and a cylinder model.
pub fn recording(frames: usize, rays: usize, seed: u64) -> Recording {
    let mut rng = seeded(seed);
    let mut frame = |k: usize| {
        let along = 0.4 * k as f64;
        let position = DVec3::new(210.0 + along, -35.0 + (along / 9.0).sin(), 480.0 + 0.2 * along);
        let tilt = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2 + 0.05 * (along / 7.0).sin());
        let contour_mm = (0..rays)
            .map(|ray| {
                let angle = TAU * ray as f64 / rays as f64;
                let radius = RADIUS_MM * (1.0 + 0.1 * (2.0 * angle).cos()) + rng.random_range(-0.6..0.6);
                match rng.random_range(0..40) {
                    0 => DVec2::NAN,
                    1 => DVec2::from_angle(angle) * radius * 1.8,
                    _ => DVec2::from_angle(angle) * radius + DVec2::new(0.7, -0.4),
                }
            })
            .collect();
        let axis = DVec3::new(0.03, 0.02 * (along / 5.0).cos(), 1.0);
        Frame::new(Pose::from_quaternion(position, tilt), contour_mm)
            .with_time_s(Some(k as f64 / 30.0))
            .with_cylinder(Some(CylinderModel::from_axis(0.7, -0.4, axis, RADIUS_MM + 0.01 * (k % 7) as f64)))
    };
    Recording { frames: (0..frames).map(&mut frame).collect() }
}
