//! The wall about the axis: robust penalised least squares on radii, with every echo measured across the wall.

use super::axis::Place;
use super::grid::{Equations, Grid, Solver};
use super::median;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// An echo about the axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Echo {
    /// Along the axis, in rings.
    ring: f64,
    /// About the axis, in nodes.
    node: f64,
    radius_mm: f64,
    /// The image plane's normal: away from the axis, about it, along it.
    image_normal: DVec3,
    stretch: f64,
    pub(super) frame: u32,
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
}

/// A wall fitted to echoes.
#[derive(Debug, Clone)]
pub(super) struct Wall {
    pub radii_mm: Vec<f64>,
    /// Standard deviation of an echo about the wall, mm.
    pub noise_mm: f64,
    /// λ, mm².
    pub smoothness_mm2: f64,
    pub iterations: usize,
    pub solver_steps: usize,
}

/// Share of the noise's variance that lies across the image plane: contours are uncertain within their plane, poses
/// in every direction. At the thesis's levels 0.09 mm² of 1.09 mm².
const OUT_OF_PLANE: f64 = 0.1;
/// Huber's constant: 95 % as good as least squares for normal noise.
const HUBER: f64 = 1.345;
/// Echoes count as seen on this wall where they are nearer than so many standard deviations of the noise, or than
/// this share of the radius: what lies behind is a branch, or no wall at all.
const GATE_SDS: f64 = 6.0;
const GATE_RADII: f64 = 0.25;
/// Feet are not looked for farther away than so many standard deviations.
const FARTHEST_FOOT_SDS: f64 = 3.0;
/// What a wall of roughness one bends away from a flat triangle, as noise, in edge lengths. It keeps perfect echoes from
/// being interpolated.
const CELL_NOISE: f64 = 0.3;
/// Iterations without feet and gate, until the wall has its shape.
const ROUGH_ITERATIONS: usize = 3;
const MOST_ITERATIONS: usize = 15;
/// The fit ends when no more than this share of the noise is left to travel, on average over the nodes, or …
const ENOUGH_NOISE_SHARE: f64 = 0.01;
/// … this many radii.
const ENOUGH_RADII: f64 = 1e-6;
/// Share of the noise to which the equations are solved.
const SOLVED_NOISE_SHARE: f64 = 1e-3;
/// Echoes that one task works through: a fixed number, so that sums do not depend on the number of threads.
const TASK: usize = 8192;

impl Echo {
    /// Finds the foot on the wall and measures the way to it.
    ///
    /// Errors of an echo have covariance `Σ ∝ I - (1 - ε) z zᵀ` with z the image plane's normal, so the likeliest point
    /// of the wall lies along `Σn`, n being the wall's normal, at `nᵀd / √(nᵀΣn)` standard deviations. Straight down to
    /// the axis instead, an echo that noise moved outwards along a tilted plane would be held against the wall
    /// farther along: where a catheter rests tilted, that lifts the wall by as much as the noise.
    fn measure(&mut self, grid: &Grid, radii: &[f64], noise: f64, feet: bool) -> Measured {
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

    /// Whether the echo was seen on this wall.
    pub(super) fn is_inlier(&self, noise: f64) -> bool {
        self.miss_mm.abs() <= gate(noise, self.radius_mm - self.miss_mm)
    }
}

fn gate(noise: f64, radius: f64) -> f64 {
    (GATE_SDS * noise).max(GATE_RADII * radius)
}

struct Measured {
    /// Way to the wall's tangent plane at the foot, along the radius, mm.
    radial_mm: f64,
    /// Inverse variance of that, in units of the noise.
    weight: f64,
    wall_mm: f64,
}

/// Fits a wall to echoes sorted along the axis. `roughness` is τ: λ = (noise/τ)².
pub(super) fn fit(grid: &Grid, echoes: &mut [Echo], roughness: f64) -> Wall {
    let solver = Solver::new(*grid);
    let start = median(&mut echoes.iter().map(|e| e.radius_mm).collect::<Vec<_>>());
    let mut wall = Wall {
        radii_mm: vec![start; grid.node_count()],
        noise_mm: start,
        smoothness_mm2: 0.0,
        iterations: 0,
        solver_steps: 0,
    };
    for iteration in 0..MOST_ITERATIONS {
        let rough = iteration < ROUGH_ITERATIONS;
        measure(grid, echoes, &wall, !rough);
        wall.noise_mm = noise(echoes).hypot(CELL_NOISE * roughness * grid.arc_mm);
        wall.smoothness_mm2 = (wall.noise_mm / roughness).powi(2);
        let equations = equations(grid, echoes, &wall, rough);
        let before = wall.radii_mm.clone();
        let tolerance = (SOLVED_NOISE_SHARE * wall.noise_mm / start).max(1e-10);
        wall.solver_steps += solver.solve(&equations, wall.smoothness_mm2, tolerance, &mut wall.radii_mm);
        wall.iterations = iteration + 1;
        let travel = before.iter().zip(&wall.radii_mm).map(|(a, b)| (a - b).abs()).sum::<f64>();
        let travel = travel / before.len() as f64;
        if !rough && travel <= (ENOUGH_RADII * start).max(ENOUGH_NOISE_SHARE * wall.noise_mm) {
            break;
        }
    }
    measure(grid, echoes, &wall, true);
    wall.noise_mm = noise(echoes);
    wall
}

fn measure(grid: &Grid, echoes: &mut [Echo], wall: &Wall, feet: bool) {
    echoes.par_chunks_mut(TASK).for_each(|task| {
        for echo in task {
            echo.measure(grid, &wall.radii_mm, wall.noise_mm, feet);
        }
    });
}

/// Standard deviation of normal noise with the echoes' median |miss|.
fn noise(echoes: &[Echo]) -> f64 {
    1.4826 * median(&mut echoes.iter().map(|e| e.miss_mm.abs()).collect::<Vec<_>>())
}

fn equations(grid: &Grid, echoes: &mut [Echo], wall: &Wall, rough: bool) -> Equations {
    let parts: Vec<Equations> = echoes
        .par_chunks_mut(TASK)
        .map(|task| {
            let rings = task.iter().map(|e| e.foot().0);
            let last = grid.rings - 2;
            let (low, high) = rings.fold((last, 0), |(low, high), ring| {
                let level = (ring.max(0.0) as usize).min(last);
                (low.min(level), high.max(level))
            });
            let mut sums = Equations::over(grid, low..high + 2);
            for echo in task {
                let (ring, node) = echo.foot();
                let measured = echo.measure(grid, &wall.radii_mm, wall.noise_mm, false);
                let miss = echo.miss_mm.abs();
                if !rough && miss > gate(wall.noise_mm, measured.wall_mm) {
                    continue;
                }
                let robust = (HUBER * wall.noise_mm / miss.max(f64::MIN_POSITIVE)).min(1.0);
                let corners = grid.corners(ring, node);
                sums.add(&corners, robust * measured.weight, measured.wall_mm + measured.radial_mm);
            }
            sums
        })
        .collect();
    let mut whole = Equations::over(grid, 0..grid.rings);
    parts.iter().for_each(|part| whole.merge(part));
    whole
}
