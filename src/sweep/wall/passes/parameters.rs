//! The structures that the passes share. Those of the shaders are in `shaders/sweep/common/parameters.wgsl`;
//! a test compares the layouts.

use crate::numerics::Scalar;
use crate::numerics::robust::HUBER;
use crate::sweep::prepare::grid::WallGrid;
use crate::sweep::wall::multigrid::{RELAXATIONS, coarsened};
use crate::sweep::wall::residual::{GATE_RADII, GATE_SDS, MAX_PROJECTION_SDS};
use bytemuck::{Pod, Zeroable};
use std::f64::consts::TAU;

/// `WallParameters` of the shaders: the uniform block of every pass.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct WallParameters {
    /// Rings.
    pub rings: u32,
    /// N: nodes per ring.
    pub nodes: u32,
    /// Nodes of all rings.
    pub node_count: u32,
    /// Echoes in the buffer.
    pub echoes: u32,
    /// 1 where projections are moved.
    pub project: u32,
    /// 1 where far echoes are left out.
    pub gated: u32,
    /// Distance of two rings, mm.
    pub step: f32,
    /// Distance of two nodes of a ring on a tube of the median radius, mm.
    pub arc: f32,
    /// Radius from which those of the wall and of the echoes are measured, mm.
    pub start: f32,
    /// 2π/N, rad.
    pub step_theta: f32,
    /// Share of the noise's variance that lies within the image planes only.
    pub in_plane: f32,
    /// σ, mm.
    pub noise: f32,
    /// 1/σ, 1/mm.
    pub per_noise: f32,
    /// Farthest that a projection lies from its echo, mm.
    pub max_projection: f32,
    /// Largest residual of an echo of the wall, mm …
    pub gate: f32,
    /// … or in radii.
    pub gate_radii: f32,
    /// Residual from which an echo's weight falls, mm.
    pub huber: f32,
    /// Steps per unit of the fixed-point sums of weights.
    pub weight_scale: f32,
    /// Its inverse.
    pub weight_unit: f32,
    /// Steps per unit of the fixed-point sums of right-hand sides, in units of the noise.
    pub rhs_scale: f32,
    /// Its inverse.
    pub rhs_unit: f32,
    /// λ times the bending along the axis, for each node.
    pub along: f32,
    /// λ times the bending about the axis, for each node.
    pub around: f32,
    /// λ times the twist, for each node.
    pub twist: f32,
    /// Square of the share of the right-hand side at which conjugate gradients stop, in the preconditioner's norm.
    pub tolerance_square: f32,
    /// Their largest number of steps.
    pub max_steps: u32,
    /// How far beyond a triangle slopes are taken: nodes to either side …
    pub slope_nodes: u32,
    /// … and rings.
    pub slope_rings: u32,
    /// Weight of the first and the last relaxation of a grid, those of the CPU's cycle …
    pub first_relaxation: f32,
    /// … and of those between.
    pub second_relaxation: f32,
    /// 1 where small grids have low tiles, which many workgroups share.
    pub low_tiles: u32,
}

impl WallParameters {
    /// A grid of rings and nodes per ring and the distances of both, with radii measured from `start_mm`, and a share
    /// `out_of_plane` of the noise's variance across the image planes. The noise is still unknown.
    pub fn new(
        [rings, nodes]: [u32; 2],
        [step_mm, arc_mm]: [f64; 2],
        start_mm: f64,
        out_of_plane: f64,
    ) -> Self {
        // A weight is at most 1/ε, where the image's normal is that of the wall; Huber bounds the weighted
        // residual.
        let weight_scale = f32::fixed_point_scale(1.0 / out_of_plane.min(1.0));
        let rhs_scale = f32::fixed_point_scale(HUBER / out_of_plane.min(1.0).sqrt());
        Self {
            rings,
            nodes,
            node_count: rings * nodes,
            step: step_mm as f32,
            arc: arc_mm as f32,
            start: start_mm as f32,
            step_theta: (TAU / f64::from(nodes)) as f32,
            in_plane: (1.0 - out_of_plane) as f32,
            gate_radii: GATE_RADII as f32,
            first_relaxation: RELAXATIONS[0] as f32,
            second_relaxation: RELAXATIONS[1] as f32,
            weight_scale,
            weight_unit: 1.0 / weight_scale,
            rhs_scale,
            rhs_unit: 1.0 / rhs_scale,
            ..Self::zeroed()
        }
    }

    /// The same with a noise of `noise_mm`.
    #[must_use]
    pub fn with_noise(self, noise_mm: f64) -> Self {
        let reach = self.grid().slope_reach(noise_mm);
        Self {
            slope_nodes: reach.nodes as u32,
            slope_rings: reach.rings as u32,
            noise: noise_mm as f32,
            per_noise: (1.0 / noise_mm) as f32,
            max_projection: (MAX_PROJECTION_SDS * noise_mm) as f32,
            gate: (GATE_SDS * noise_mm) as f32,
            huber: (HUBER * noise_mm) as f32,
            ..self
        }
    }

    /// The wall's grid.
    fn grid(&self) -> WallGrid {
        WallGrid {
            rings: self.rings as usize,
            nodes: self.nodes as usize,
            step_mm: f64::from(self.step),
            arc_mm: f64::from(self.arc),
        }
    }

    /// The same with a smoothness λ of `smoothness_mm2`.
    #[must_use]
    pub fn with_smoothness(self, smoothness_mm2: f64) -> Self {
        let [step_mm, arc_mm] = [self.step, self.arc].map(f64::from);
        let area = smoothness_mm2 * step_mm * arc_mm;
        Self {
            along: (area / step_mm.powi(4)) as f32,
            around: (area / arc_mm.powi(4)) as f32,
            twist: (2.0 * area / (step_mm * arc_mm).powi(2)) as f32,
            ..self
        }
    }
}

/// `Level` of the shaders: a grid of the multigrid cycle.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Level {
    /// Rings.
    pub rings: u32,
    /// Nodes per ring.
    pub nodes: u32,
    /// Nodes of all rings.
    pub count: u32,
    /// Its first node in the buffers that hold the nodes of all grids, the finest first.
    pub first: u32,
    /// The number of coarser grids.
    pub coarser: u32,
    /// λ times the bending along the axis, for each node.
    pub along: f32,
    /// λ times the bending about the axis, for each node.
    pub around: f32,
    /// λ times the twist, for each node.
    pub twist: f32,
    /// A binding may begin at every 256 bytes.
    pub unused: [[u32; 28]; 2],
}

/// Most rings of the coarsest grid.
pub const MOST_COARSEST: usize = 16;

impl WallParameters {
    /// The finest grid.
    pub fn finest(&self) -> Level {
        let Self { rings, nodes, node_count: count, along, around, twist, .. } = *self;
        Level { rings, nodes, count, first: 0, coarser: 0, along, around, twist, unused: [[0; 28]; 2] }
    }

    /// The grids of the multigrid cycle, the finest first: each has half as many rings and nodes as the one before or, where
    /// these are much closer than the others, half as many of these only; the last is a line of at most
    /// [`MOST_COARSEST`] rings.
    pub fn levels(&self) -> Vec<Level> {
        let is_coarsest = |grid: &WallGrid| grid.nodes == 1 && grid.rings <= MOST_COARSEST;
        let grids: Vec<WallGrid> =
            std::iter::successors(Some(self.grid()), |grid| (!is_coarsest(grid)).then(|| coarsened(grid)))
                .collect();
        let mut levels = vec![self.finest()];
        for pair in grids.windows(2) {
            let before = levels[levels.len() - 1];
            // Bending is λ times the area of a cell over a fourth power of distances.
            let wider = pair[1].step_mm / pair[0].step_mm;
            let longer = pair[1].arc_mm / pair[0].arc_mm;
            let times = |bending: f32, factor: f64| (f64::from(bending) * factor) as f32;
            levels.push(Level {
                rings: pair[1].rings as u32,
                nodes: pair[1].nodes as u32,
                count: pair[1].node_count() as u32,
                first: before.first + before.count,
                along: times(before.along, longer / wider.powi(3)),
                around: times(before.around, wider / longer.powi(3)),
                twist: times(before.twist, (wider * longer).recip()),
                ..before
            });
        }
        for (coarser, level) in (0..).zip(levels.iter_mut().rev()) {
            level.coarser = coarser;
        }
        levels
    }
}

/// `Echo` of the shaders: an echo in coordinates about the axis.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct DeviceEcho {
    /// The ring below it.
    pub ring: u32,
    /// Its distance from that ring, as a fraction of the distance to the next.
    pub ring_part: f32,
    /// The node before it.
    pub node: u32,
    /// Its distance from that node, as a fraction of the distance to the next.
    pub node_part: f32,
    /// Its radius less `start` of the parameters, mm.
    pub rise: f32,
    /// Distance between two rings there, mm.
    pub step: f32,
    /// The image plane's normal: radial, about the axis, along it.
    pub normal: [f32; 3],
}

/// [`State::done`]: the residual is small enough.
pub const CONVERGED: u32 = 1;
/// [`State::done`]: the equations are not positive definite, or hold numbers that are not finite.
pub const BROKEN: u32 = 2;
/// [`State::done`]: the steps ran out.
pub const EXHAUSTED: u32 = 3;

/// `State` of the shaders: values that pass from pass to pass.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct State {
    /// The known digits of the median: leading bytes of an f32 that is not negative.
    pub prefix: u32,
    /// The median's rank among the residuals that share them.
    pub rank: u32,
    /// The number of known digits, of four.
    pub digits: u32,
    /// How conjugate gradients ended: 0 while they go on, [`CONVERGED`], [`BROKEN`] or [`EXHAUSTED`].
    pub done: u32,
    /// The number of their steps.
    pub steps: u32,
    /// Square of the residual, in the preconditioner's norm, before the last of them.
    pub residual_square: f32,
    /// Square of the residual at which they end.
    pub max_residual_square: f32,
}

impl State {
    /// Whether there is a solution to go on with.
    pub fn is_solved(&self) -> bool {
        self.done == CONVERGED || self.done == EXHAUSTED
    }
}

/// `NextStep` of the shaders: what `apply` finds before a step of conjugate gradients, and `cg_step` goes by.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct NextStep {
    /// How they end: 0 while they go on, [`CONVERGED`], [`BROKEN`] or [`EXHAUSTED`].
    pub ends: u32,
    /// Square of the residual, in the preconditioner's norm.
    pub square: f32,
    /// β: share of the last direction in the next.
    pub beta: f32,
}
