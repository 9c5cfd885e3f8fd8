//! Echoes about the axis.

use super::axis::{Axis, Place};
use crate::geometry::Pose;
use crate::geometry::polyline::Searched;
use crate::recording::{FRAME_INTERVAL_S, Frame};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// An echo about the axis, and its projection onto the wall.
///
/// Every reweighting of a fit passes over all echoes, and waits for memory. Those values that need no double precision have
/// none, so that an echo has 64 bytes.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(in crate::sweep) struct Echo {
    /// Along the axis, in rings.
    pub ring: f64,
    /// About the axis, in nodes.
    pub node: f64,
    pub radius_mm: f64,
    /// The standardised residual: the distance to the wall along the likeliest direction, in mm of noise in that
    /// direction; positive outside the wall.
    pub residual_mm: f64,
    /// The image plane's normal: away from the axis, about it, along it.
    pub image_normal: Vec3,
    /// See [`Place::stretch`].
    pub stretch: f32,
    /// From the echo to its projection onto the wall, in rings and nodes.
    pub shift: [f32; 2],
    /// Weight: 1, less for an old echo, and the number of echoes where it stands for several, whose mean it is.
    pub weight: f32,
    pub frame: u32,
}

impl Echo {
    pub(in crate::sweep) fn new(place: &Place, image_normal: DVec3, frame: u32, nodes: usize) -> Self {
        Self {
            ring: place.ring,
            node: place.theta_rad / TAU * nodes as f64,
            radius_mm: place.radius_mm,
            image_normal: (place.directions.transpose() * image_normal).as_vec3(),
            stretch: place.stretch as f32,
            frame,
            weight: 1.0,
            shift: [0.0; 2],
            residual_mm: 0.0,
        }
    }

    /// The residual, mm, and where it is that of a mean of several echoes, as large as one of them usually has.
    pub(in crate::sweep) fn single_residual_mm(&self) -> f64 {
        self.residual_mm * f64::from(self.weight.max(1.0).sqrt())
    }

    /// Angle about the axis, rad.
    pub(in crate::sweep) fn theta_rad(&self, nodes: usize) -> f64 {
        self.node / nodes as f64 * TAU
    }

    /// Its projection onto the wall: ring and node.
    pub(in crate::sweep) fn projection(&self) -> (f64, f64) {
        let [rings, nodes] = self.shift.map(f64::from);
        (self.ring + rings, self.node + nodes)
    }

    /// Copies the projection and the residual of another echo.
    pub(in crate::sweep) fn keep_projection_of(&mut self, other: &Self) {
        (self.shift, self.residual_mm) = (other.shift, other.residual_mm);
    }
}

/// Frames whose echoes are placed one after the other.
const RUN: usize = 64;

/// The echoes of contours about an axis, sorted along it; those beyond its ends are left out. `contours_mm` has an empty
/// list for a frame that is left out, `poses` are those of the probe.
pub(in crate::sweep) fn placed(
    frames: &[Frame],
    contours_mm: &[&[DVec2]],
    poses: &[Pose],
    axis: &Axis,
    nodes: usize,
) -> Vec<Echo> {
    let rings = Searched::of(&axis.points_mm);
    let of_frame = |k: usize, echoes: &mut Vec<Echo>| {
        let (frame, pose) = (&frames[k], &poses[k]);
        if contours_mm[k].is_empty() {
            return;
        }
        let to_world = |p: DVec2| pose.transform_point(p.extend(0.0));
        let centre = frame.centroid_mm().or_else(|| frame.echoes_mm().next());
        let near = centre.map_or(0, |centre| rings.nearest_point(to_world(centre)));
        echoes.extend(frame.echoes_mm().filter_map(|echo| {
            let place = axis.place(to_world(echo), near)?;
            Some(Echo::new(&place, pose.rotation.z_axis, k as u32, nodes))
        }));
    };
    let of_run = |run: usize| {
        let run = run * RUN..frames.len().min((run + 1) * RUN);
        let mut echoes = Vec::with_capacity(run.clone().map(|k| contours_mm[k].len()).sum());
        run.for_each(|k| of_frame(k, &mut echoes));
        echoes
    };
    let runs: Vec<Vec<Echo>> = (0..frames.len().div_ceil(RUN)).into_par_iter().map(of_run).collect();
    // Echoes are moved once: what is sorted are their places in the runs, first by whole rings.
    let mut ends = vec![0; axis.rings() + 1];
    runs.iter().flatten().for_each(|echo| ends[echo.ring as usize + 1] += 1);
    for ring in 1..ends.len() {
        ends[ring] += ends[ring - 1];
    }
    let mut order: Vec<(f64, u32, u32)> = vec![(0.0, 0, 0); ends[axis.rings()]];
    for (run, echoes) in (0..).zip(&runs) {
        for (i, echo) in (0..).zip(echoes) {
            let end = &mut ends[echo.ring as usize];
            order[*end] = (echo.ring, run, i);
            *end += 1;
        }
    }
    let of_ring = order.par_chunk_by_mut(|a, b| a.0 as usize == b.0 as usize);
    of_ring.for_each(|places| {
        places.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    });
    order.into_par_iter().map(|(_, run, i)| runs[run as usize][i as usize]).collect()
}

/// When the frames were taken, s; a frame without a time counts as [`FRAME_INTERVAL_S`] after the one before.
pub(in crate::sweep) fn times_s(frames: &[Frame]) -> Vec<f64> {
    let times = frames.iter().scan(-FRAME_INTERVAL_S, |clock, frame| {
        *clock = frame.time_s.unwrap_or(*clock + FRAME_INTERVAL_S);
        Some(*clock)
    });
    times.collect()
}

/// Halves the weights of echoes, sorted along the axis, for every `half_life_s` between them and the newest echo between
/// the same two rings.
pub(in crate::sweep) fn age(echoes: &mut [Echo], frames: &[Frame], half_life_s: f64) {
    let times_s = times_s(frames);
    let time = |echo: &Echo| times_s[echo.frame as usize];
    for band in echoes.chunk_by_mut(|a, b| a.ring as usize == b.ring as usize) {
        let newest = band.iter().map(time).fold(f64::NEG_INFINITY, f64::max);
        band.iter_mut().for_each(|echo| echo.weight = ((time(echo) - newest) / half_life_s).exp2() as f32);
    }
}
