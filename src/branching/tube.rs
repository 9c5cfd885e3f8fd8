//! The wall of a branch as a function of place.

use crate::numerics::robust::median;
use crate::sweep::{Axis, Sweep};
use glam::DVec3;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

/// Rings of a stretch, of which one look tells whether the nearest may be among them.
const STRETCH: usize = 16;

/// The wall of a branch: a tube about its axis.
pub(super) struct Tube<'a> {
    pub axis: &'a Axis,
    /// Nodes per ring.
    pub nodes: usize,
    /// Radius at every node, mm.
    pub radii_mm: Vec<f64>,
    /// The rings that count.
    pub rings: RangeInclusive<usize>,
    /// Length of an edge, mm.
    pub edge_mm: f64,
    reach_mm: f64,
    /// Spheres that hold the origins of all rings of a stretch: centre and radius, mm.
    stretches: Vec<(DVec3, f64)>,
}

/// Where a point lies about a tube.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    /// Along the axis, in rings.
    pub ring: f64,
    /// About the axis, rad.
    pub theta_rad: f64,
    /// Distance from the wall along the radius, mm; negative inside.
    pub outside_mm: f64,
}

impl<'a> Tube<'a> {
    pub(super) fn of(sweep: &'a Sweep) -> Self {
        let Sweep { axis, nodes, radii_mm, .. } = sweep;
        Self::new(axis, *nodes, radii_mm.clone(), 0..=axis.rings() - 1)
    }

    /// A tube about an axis with so many nodes per ring.
    pub(super) fn new(
        axis: &'a Axis,
        nodes: usize,
        radii_mm: Vec<f64>,
        rings: RangeInclusive<usize>,
    ) -> Self {
        let edge_mm = axis.step_mm;
        let reach_mm = radii_mm.iter().copied().fold(0.0, f64::max) + 4.0 * edge_mm;
        let sphere = |points_mm: &[DVec3]| {
            let centre_mm = points_mm.iter().sum::<DVec3>() / points_mm.len() as f64;
            (centre_mm, points_mm.iter().map(|p| p.distance(centre_mm)).fold(0.0, f64::max))
        };
        let stretches = axis.points_mm.chunks(STRETCH).map(sphere).collect();
        Self { axis, nodes, radii_mm, rings, edge_mm, reach_mm, stretches }
    }

    /// Median radius of the wall, mm.
    pub(super) fn median_radius_mm(&self) -> f64 {
        median(&mut self.radii_mm.clone())
    }

    /// Radius of the wall, mm.
    pub(super) fn radius_mm(&self, ring: f64, theta_rad: f64) -> f64 {
        let k = (ring.max(0.0) as usize).min(self.axis.rings() - 2);
        let u = (ring - k as f64).clamp(0.0, 1.0);
        let node = theta_rad / TAU * self.nodes as f64;
        let (j, v) = (node as usize % self.nodes, node.fract());
        let next = (j + 1) % self.nodes;
        let at = |k: usize, j: usize| self.radii_mm[k * self.nodes + j];
        let ring = |k: usize| at(k, j) + (at(k, next) - at(k, j)) * v;
        ring(k) + (ring(k + 1) - ring(k)) * u
    }

    /// A node's place, mm.
    pub(super) fn node_mm(&self, ring: usize, node: usize) -> DVec3 {
        let theta_rad = TAU * node as f64 / self.nodes as f64;
        self.axis.point_mm(ring, theta_rad, self.radii_mm[ring * self.nodes + node])
    }

    /// Whether any point within a distance of a place may have a [`spot`](Self::spot).
    pub(super) fn may_reach(&self, place_mm: DVec3, distance_mm: f64) -> bool {
        let reach_mm = (self.reach_mm + distance_mm) * (1.0 + 1e-9);
        self.stretches
            .iter()
            .any(|(centre_mm, radius_mm)| centre_mm.distance(place_mm) <= radius_mm + reach_mm)
    }

    /// Where a point lies; `None` beyond the tube's rings, and so far away that it does not matter.
    pub(super) fn spot(&self, point_mm: DVec3) -> Option<Spot> {
        let (first, last) = (*self.rings.start(), *self.rings.end());
        let mut nearest = None;
        let mut least_mm2 = self.reach_mm * self.reach_mm;
        for (stretch, (centre_mm, radius_mm)) in self.stretches.iter().enumerate() {
            let beyond_mm = centre_mm.distance(point_mm) - radius_mm;
            if beyond_mm > 0.0 && beyond_mm * beyond_mm > least_mm2 {
                continue;
            }
            let start = stretch * STRETCH;
            for k in start.max(first)..=(start + STRETCH - 1).min(last) {
                let square_mm2 = self.axis.points_mm[k].distance_squared(point_mm);
                if square_mm2 < least_mm2 {
                    (nearest, least_mm2) = (Some(k), square_mm2);
                }
            }
        }
        let place = self.axis.place(point_mm, nearest?)?;
        if place.ring < first as f64 || place.ring > last as f64 {
            return None;
        }
        let outside_mm = place.radius_mm - self.radius_mm(place.ring, place.theta_rad);
        Some(Spot { ring: place.ring, theta_rad: place.theta_rad, outside_mm })
    }

    /// Distance from the wall, mm; infinite where there is no [`spot`](Self::spot).
    pub(super) fn outside_mm(&self, point_mm: DVec3) -> f64 {
        self.spot(point_mm).map_or(f64::INFINITY, |spot| spot.outside_mm)
    }
}
