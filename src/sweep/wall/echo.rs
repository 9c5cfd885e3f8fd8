//! An echo about the axis, and its way to the wall.

use super::grid::Grid;
use crate::sweep::prepare::axis::Place;
use glam::DVec3;
use std::f64::consts::TAU;

/// Share of the noise's variance that lies across the image plane: contours are uncertain within their plane, poses
/// in every direction. At the thesis's levels 0.09 mm² of 1.09 mm².
pub(in crate::sweep) const OUT_OF_PLANE: f64 = 0.1;
/// Echoes count as seen on this wall where they are nearer than so many standard deviations of the noise, or than
/// this share of the radius: what lies behind is a branch, or no wall at all.
pub(in crate::sweep) const GATE_SDS: f64 = 6.0;
pub(in crate::sweep) const GATE_RADII: f64 = 0.25;
/// Feet are not looked for farther away than so many standard deviations.
pub(in crate::sweep) const FARTHEST_FOOT_SDS: f64 = 3.0;

/// What an echo is held against.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Held<'a> {
    pub grid: &'a Grid,
    pub radii_mm: &'a [f64],
    /// Standard deviation of an echo about the wall, mm.
    pub noise_mm: f64,
    /// Share of the noise's variance across the image plane.
    pub out_of_plane: f64,
}

/// An echo about the axis.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Echo {
    /// Along the axis, in rings.
    ring: f64,
    /// About the axis, in nodes.
    node: f64,
    pub(in crate::sweep) radius_mm: f64,
    /// The image plane's normal: away from the axis, about it, along it.
    image_normal: DVec3,
    stretch: f64,
    pub(in crate::sweep) frame: u32,
    /// How much it counts: 1, or less for an old one.
    pub(in crate::sweep) weight: f64,
    /// From the echo to its foot on the wall, in rings and nodes.
    shift: [f64; 2],
    /// Distance to the wall in units of the noise along its way, mm; positive outside the wall.
    pub(in crate::sweep) miss_mm: f64,
}

impl Echo {
    pub(in crate::sweep) fn new(place: &Place, image_normal: DVec3, frame: u32, nodes: usize) -> Self {
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
    pub(in crate::sweep) fn ring(&self) -> f64 {
        self.ring
    }

    /// About the axis, rad.
    pub(in crate::sweep) fn theta_rad(&self, nodes: usize) -> f64 {
        self.node / nodes as f64 * TAU
    }

    /// Where its foot is: ring and node.
    pub(in crate::sweep) fn foot(&self) -> (f64, f64) {
        (self.ring + self.shift[0], self.node + self.shift[1])
    }

    /// The echo as a device holds it, radii measured from `start_mm`: cells and parts of cells apart, so that f32 keeps
    /// their digits.
    #[cfg(feature = "gpu")]
    pub(in crate::sweep) fn for_device(&self, grid: &Grid, start_mm: f64) -> super::passes::DeviceEcho {
        let ring = self.ring.max(0.0).floor();
        let around = self.node.rem_euclid(grid.nodes as f64);
        let node = around.floor();
        super::passes::DeviceEcho {
            ring: ring as u32,
            ring_part: (self.ring - ring) as f32,
            node: node as u32,
            node_part: (around - node) as f32,
            rise: (self.radius_mm - start_mm) as f32,
            step: (grid.step_mm * self.stretch) as f32,
            normal: self.image_normal.as_vec3().to_array(),
        }
    }

    /// Takes over what a device measured: the foot, in rings and nodes from the echo, and the miss, mm.
    #[cfg(feature = "gpu")]
    pub(in crate::sweep) fn set_way(&mut self, shift: [f64; 2], miss_mm: f64) {
        (self.shift, self.miss_mm) = (shift, miss_mm);
    }

    /// Finds the foot on the wall and measures the way to it.
    ///
    /// Errors of an echo have covariance `Σ ∝ I - (1 - ε) z zᵀ` with z the image plane's normal and `out_of_plane` = ε, so the likeliest
    /// point of the wall lies along `Σn`, n being the wall's normal, at `nᵀd / √(nᵀΣn)` standard deviations. Straight down to
    /// the axis instead, an echo that noise moved outwards along a tilted plane would be held against the wall
    /// farther along: where a catheter rests tilted, that lifts the wall by as much as the noise.
    pub(in crate::sweep) fn measure(&mut self, held: Held, feet: bool) -> Measured {
        let Held { grid, radii_mm: radii, noise_mm: noise, out_of_plane } = held;
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
        let likeliest = normal - self.image_normal * ((1.0 - out_of_plane) * tilt);
        let variance = normal.dot(likeliest);
        let across = normal.dot(way);
        self.miss_mm = across / variance.sqrt();
        if feet {
            let reach = (FARTHEST_FOOT_SDS * noise / self.miss_mm.abs().max(f64::MIN_POSITIVE)).min(1.0);
            let shift = likeliest * (-across / variance * reach);
            self.shift = [shift.z / step, shift.y / arc];
        }
        let weight = normal.x * normal.x / variance;
        Measured { radial_mm: across / normal.x, weight, wall_mm: wall, normal }
    }

    /// As [`Echo::measure`], about a wall of which nothing is known yet: it is taken to be a tube, right under the echo.
    pub(in crate::sweep) fn measure_straight(&mut self) -> Measured {
        self.shift = [0.0; 2];
        self.miss_mm = 0.0;
        let tilt = self.image_normal.x;
        let weight = (1.0 - (1.0 - OUT_OF_PLANE) * tilt * tilt).recip();
        Measured { radial_mm: 0.0, weight, wall_mm: self.radius_mm, normal: DVec3::X }
    }

    /// Where it is about the axis: ring and node.
    pub(in crate::sweep) fn place(&self) -> (f64, f64) {
        (self.ring, self.node)
    }

    /// Takes another's foot over.
    pub(in crate::sweep) fn keep_foot_of(&mut self, other: &Self) {
        (self.shift, self.miss_mm) = (other.shift, other.miss_mm);
    }

    /// Counts rings from one that lies `rings` before.
    pub(in crate::sweep) fn renumber(&mut self, rings: usize) {
        self.ring += rings as f64;
    }

    /// Whether the echo was seen on this wall.
    pub(in crate::sweep) fn is_inlier(&self, noise: f64) -> bool {
        self.miss_mm.abs() <= gate(noise, self.radius_mm - self.miss_mm)
    }
}

/// Farthest that an echo of a wall may lie from it, in the units of [`Echo::miss_mm`].
pub(in crate::sweep) fn gate(noise: f64, radius: f64) -> f64 {
    (GATE_SDS * noise).max(GATE_RADII * radius)
}

/// An echo's say about the radius under its foot.
pub(in crate::sweep) struct Measured {
    /// Way to the wall's tangent plane at the foot, along the radius, mm.
    pub radial_mm: f64,
    /// Inverse variance of that, in units of the noise.
    pub weight: f64,
    /// The radius there so far, mm.
    pub wall_mm: f64,
    /// The wall's unit normal there: away from the axis, about it, along it.
    pub normal: DVec3,
}
