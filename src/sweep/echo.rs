//! An echo about the axis, and its way to the wall.

use super::axis::Place;
use super::grid::Grid;
use glam::DVec3;
use std::f64::consts::TAU;

/// Share of the noise's variance that lies across the image plane: contours are uncertain within their plane, poses
/// in every direction. At the thesis's levels 0.09 mm² of 1.09 mm².
const OUT_OF_PLANE: f64 = 0.1;
/// Echoes count as seen on this wall where they are nearer than so many standard deviations of the noise, or than
/// this share of the radius: what lies behind is a branch, or no wall at all.
const GATE_SDS: f64 = 6.0;
const GATE_RADII: f64 = 0.25;
/// Feet are not looked for farther away than so many standard deviations.
const FARTHEST_FOOT_SDS: f64 = 3.0;

/// An echo about the axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Echo {
    /// Along the axis, in rings.
    ring: f64,
    /// About the axis, in nodes.
    node: f64,
    pub(super) radius_mm: f64,
    /// The image plane's normal: away from the axis, about it, along it.
    image_normal: DVec3,
    stretch: f64,
    pub(super) frame: u32,
    /// How much it counts: 1, or less for an old one.
    pub(super) weight: f64,
    /// From the echo to its foot on the wall, in rings and nodes.
    shift: [f64; 2],
    /// Distance to the wall in units of the noise along its way, mm; positive outside the wall.
    pub(super) miss_mm: f64,
}

impl Echo {
    pub(super) fn new(place: &Place, image_normal: DVec3, frame: u32, nodes: usize) -> Self {
        Self {
            ring: place.ring,
            node: place.theta_rad / TAU * nodes as f64,
            radius_mm: place.radius_mm,
            image_normal: place.directions.transpose() * image_normal,
            stretch: place.stretch,
            frame,
            weight: 1.0,
            shift: [0.0; 2],
            miss_mm: 0.0,
        }
    }

    /// Sorts along the axis.
    pub(super) fn ring(&self) -> f64 {
        self.ring
    }

    /// Where its foot is: ring and node.
    pub(super) fn foot(&self) -> (f64, f64) {
        (self.ring + self.shift[0], self.node + self.shift[1])
    }

    /// Finds the foot on the wall and measures the way to it.
    ///
    /// Errors of an echo have covariance `Σ ∝ I - (1 - ε) z zᵀ` with z the image plane's normal, so the likeliest point
    /// of the wall lies along `Σn`, n being the wall's normal, at `nᵀd / √(nᵀΣn)` standard deviations. Straight down to
    /// the axis instead, an echo that noise moved outwards along a tilted plane would be held against the wall
    /// farther along: where a catheter rests tilted, that lifts the wall by as much as the noise.
    pub(super) fn measure(&mut self, grid: &Grid, radii: &[f64], noise: f64, feet: bool) -> Measured {
        let (ring, node) = self.foot();
        let corners = grid.corners(ring, node);
        let [r0, r1, r2] = corners.nodes.map(|n| radii[n]);
        let [w0, w1, w2] = corners.weights;
        let wall = r0 * w0 + r1 * w1 + r2 * w2;
        // Slopes within the triangle, per node and per ring.
        let (per_node, per_ring) = if corners.bottom { (r1 - r0, r2 - r1) } else { (r2 - r1, r1 - r0) };
        let arc = TAU / grid.nodes as f64 * wall;
        let step = grid.step_mm * self.stretch;
        let normal = DVec3::new(1.0, -per_node / arc, -per_ring / step).normalize();
        let way = DVec3::new(self.radius_mm - wall, -self.shift[1] * arc, -self.shift[0] * step);
        let tilt = normal.dot(self.image_normal);
        let likeliest = normal - self.image_normal * ((1.0 - OUT_OF_PLANE) * tilt);
        let variance = normal.dot(likeliest);
        let across = normal.dot(way);
        self.miss_mm = across / variance.sqrt();
        if feet {
            let reach = (FARTHEST_FOOT_SDS * noise / self.miss_mm.abs().max(f64::MIN_POSITIVE)).min(1.0);
            let shift = likeliest * (-across / variance * reach);
            self.shift = [shift.z / step, shift.y / arc];
        }
        Measured { radial_mm: across / normal.x, weight: normal.x * normal.x / variance, wall_mm: wall }
    }

    /// As [`Echo::measure`], about a wall of which nothing is known yet: it is taken to be a tube, right under the echo.
    pub(super) fn measure_straight(&mut self) -> Measured {
        self.shift = [0.0; 2];
        self.miss_mm = 0.0;
        let tilt = self.image_normal.x;
        let weight = (1.0 - (1.0 - OUT_OF_PLANE) * tilt * tilt).recip();
        Measured { radial_mm: 0.0, weight, wall_mm: self.radius_mm }
    }

    /// Where it is about the axis: ring and node.
    pub(super) fn place(&self) -> (f64, f64) {
        (self.ring, self.node)
    }

    /// Takes another's foot over.
    pub(super) fn keep_foot_of(&mut self, other: &Self) {
        (self.shift, self.miss_mm) = (other.shift, other.miss_mm);
    }

    /// Counts rings from one that lies `rings` before.
    pub(super) fn renumber(&mut self, rings: usize) {
        self.ring += rings as f64;
    }

    /// Whether the echo was seen on this wall.
    pub(super) fn is_inlier(&self, noise: f64) -> bool {
        self.miss_mm.abs() <= gate(noise, self.radius_mm - self.miss_mm)
    }
}

/// Farthest that an echo of a wall may lie from it, in the units of [`Echo::miss_mm`].
pub(super) fn gate(noise: f64, radius: f64) -> f64 {
    (GATE_SDS * noise).max(GATE_RADII * radius)
}

/// An echo's say about the radius under its foot.
pub(super) struct Measured {
    /// Way to the wall's tangent plane at the foot, along the radius, mm.
    pub radial_mm: f64,
    /// Inverse variance of that, in units of the noise.
    pub weight: f64,
    /// The radius there so far, mm.
    pub wall_mm: f64,
}
