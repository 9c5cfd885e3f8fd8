//! What the passes know. The shaders' structures are in `shaders/sweep/common/job.wgsl`; a test compares the layouts.

use crate::numerics::Scalar;
use crate::numerics::robust::HUBER;
use crate::sweep::wall::residual::{GATE_RADII, GATE_SDS, MAX_PROJECTION_SDS};
use bytemuck::{Pod, Zeroable};
use std::f64::consts::TAU;

/// `Job` of the shaders.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Job {
    /// Rings.
    pub rings: u32,
    /// N: nodes a ring.
    pub nodes: u32,
    /// Nodes of all rings.
    pub node_count: u32,
    /// Echoes that lie together in one buffer.
    pub echoes: u32,
    /// 1 where feet are moved.
    pub feet: u32,
    /// 1 where far echoes are left out.
    pub gated: u32,
    /// Blocks that the rings are cut into for the preconditioner.
    pub blocks: u32,
    /// Rings of each block but the last, which has what is left.
    pub block_rings: u32,
    /// What the wall's and the echoes' radii are measured from, mm.
    pub start: f32,
    /// 2π/N, rad.
    pub step_theta: f32,
    /// 1/N.
    pub per_node: f32,
    /// Share of the noise's variance that the image planes have to themselves.
    pub in_plane: f32,
    /// σ, mm.
    pub noise: f32,
    /// 1/σ, 1/mm.
    pub per_noise: f32,
    /// Farthest way to a foot, mm.
    pub farthest_foot: f32,
    /// Farthest that an echo of the wall lies from it, mm …
    pub gate: f32,
    /// … or in radii.
    pub gate_radii: f32,
    /// Distance from which an echo's weight falls, mm.
    pub huber: f32,
    /// Steps of the fixed-point sums of weights.
    pub weight_scale: f32,
    /// Its inverse.
    pub weight_unit: f32,
    /// Steps of the fixed-point sums of weighted ways, in units of the noise.
    pub way_scale: f32,
    /// Its inverse.
    pub way_unit: f32,
    /// λ times the bending along the axis, for each node.
    pub along: f32,
    /// The same about the axis.
    pub around: f32,
    /// The same across both.
    pub twist: f32,
    /// Square of the residual that conjugate gradients leave, in the preconditioner's norm.
    pub enough: f32,
    /// The largest factor of N that is not above its root.
    pub short: u32,
    /// The other factor.
    pub long: u32,
}

impl Job {
    /// A grid of rings and nodes, with radii measured from `start_mm`, and `out_of_plane` of the noise's variance across
    /// the image planes. The noise is yet unknown.
    pub fn new(rings: u32, nodes: u32, start_mm: f64, out_of_plane: f64) -> Self {
        // A weight is at most 1/ε, as of a wall across the image's normal; Huber bounds the way that goes with it.
        let weight_scale = f32::fixed_point_scale(1.0 / out_of_plane.min(1.0));
        let way_scale = f32::fixed_point_scale(HUBER / out_of_plane.min(1.0).sqrt());
        let block_rings = block_rings(rings);
        let short = (1..=nodes.isqrt()).rev().find(|factor| nodes.is_multiple_of(*factor)).unwrap_or(1);
        Self {
            rings,
            nodes,
            node_count: rings * nodes,
            blocks: (rings / block_rings).max(1),
            block_rings,
            start: start_mm as f32,
            short,
            long: nodes / short,
            step_theta: (TAU / f64::from(nodes)) as f32,
            per_node: (1.0 / f64::from(nodes)) as f32,
            in_plane: (1.0 - out_of_plane) as f32,
            gate_radii: GATE_RADII as f32,
            weight_scale,
            weight_unit: 1.0 / weight_scale,
            way_scale,
            way_unit: 1.0 / way_scale,
            ..Self::zeroed()
        }
    }

    /// The same with a noise of `noise_mm`.
    #[must_use]
    pub fn with_noise(self, noise_mm: f64) -> Self {
        Self {
            noise: noise_mm as f32,
            per_noise: (1.0 / noise_mm) as f32,
            farthest_foot: (MAX_PROJECTION_SDS * noise_mm) as f32,
            gate: (GATE_SDS * noise_mm) as f32,
            huber: (HUBER * noise_mm) as f32,
            ..self
        }
    }

    /// The same with a wall that bends at the price of `smoothness_mm2`, its rings and nodes so far apart.
    #[must_use]
    pub fn with_smoothness(self, smoothness_mm2: f64, step_mm: f64, arc_mm: f64) -> Self {
        let area = smoothness_mm2 * step_mm * arc_mm;
        Self {
            along: (area / step_mm.powi(4)) as f32,
            around: (area / arc_mm.powi(4)) as f32,
            twist: (2.0 * area / (step_mm * arc_mm).powi(2)) as f32,
            ..self
        }
    }
}

/// Rings of a block: as many as there are blocks, since one invocation goes through a block and one over all blocks.
fn block_rings(rings: u32) -> u32 {
    rings.isqrt().max(8)
}

/// `Echo` of the shaders: an echo about the axis.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Echo {
    /// The ring before it.
    pub ring: u32,
    /// Its part of the way to the next.
    pub ring_part: f32,
    /// The node before it.
    pub node: u32,
    /// Its part of the way to the next.
    pub node_part: f32,
    /// Its radius less the job's `start`, mm.
    pub rise: f32,
    /// Distance of two rings there, mm.
    pub step: f32,
    /// The image plane's normal: away from the axis, about it, along it.
    pub normal: [f32; 3],
}

/// `State` of the shaders: what goes from pass to pass.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct State {
    /// The digits of the median that are known: those of a number of f32 that is not negative.
    pub prefix: u32,
    /// The median's rank among the numbers that share them.
    pub rest: u32,
    /// How many digits these are, of four.
    pub round: u32,
    /// 1 where conjugate gradients have come near enough.
    pub done: u32,
    /// After how many steps.
    pub steps: u32,
    /// Square of the residual, in the preconditioner's norm.
    pub size: f32,
    /// Length of the step.
    pub length: f32,
    /// How much of the last direction is in the next.
    pub turn: f32,
}
