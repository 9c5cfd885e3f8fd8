//! The way of an echo to the wall, and what it says about the radii (`shaders/sweep/common/echo.wgsl`, `measure`,
//! `accumulate`). In f64 this is `ResidualModel::measure` of the CPU.

use super::{Echo, Job};
use crate::numerics::Scalar;

/// Of feet that lie farther off than so many cells nothing is left.
pub const FARTHEST_CELL: f32 = 16777216.0;

/// An echo and the wall under its foot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Way {
    /// The triangle's corners a, b, b' or a, a', b', as node indices.
    pub corners: [usize; 3],
    /// The weights of the foot there.
    pub weights: [f32; 3],
    /// Whether it is the bottom triangle (a, b, b').
    pub bottom: bool,
    /// Radius of the wall at the foot less the job's `start`, mm.
    pub wall: f32,
    /// Length of a node's arc there, mm.
    pub arc: f32,
    /// The likeliest way.
    pub likeliest: [f32; 3],
    /// Its variance, in units of the noise.
    pub variance: f32,
    /// Part of the wall's normal that points away from the axis.
    pub normal_x: f32,
    /// Distance along the normal, mm.
    pub across: f32,
    /// The same in units of the noise along the likeliest way, mm.
    pub miss: f32,
}

/// Finds the wall under the foot of an echo, which lies `shift` rings and nodes from it.
pub fn way_to_wall(job: &Job, echo: &Echo, wall: &[f32], shift: [f32; 2]) -> Way {
    let ring = echo.ring_part + shift[0];
    let rings_up = ring.floor().clamp(-FARTHEST_CELL, FARTHEST_CELL);
    let wanted = echo.ring as i32 + rings_up as i32;
    let last = job.rings as i32 - 2;
    let level = wanted.clamp(0, last) as usize;
    let mut up = (ring - rings_up).clamp(0.0, 1.0);
    if wanted < 0 {
        up = 0.0;
    }
    if wanted > last {
        up = 1.0;
    }
    let node = echo.node_part + shift[1];
    let nodes_on = node.floor().clamp(-FARTHEST_CELL, FARTHEST_CELL);
    let nodes = job.nodes as usize;
    let j = (echo.node as i32 + nodes_on as i32).rem_euclid(nodes as i32) as usize;
    let round = (node - nodes_on).clamp(0.0, 1.0);
    let next = if j + 1 == nodes { 0 } else { j + 1 };

    let row = level * nodes;
    let (a, b_above) = (row + j, row + nodes + next);
    let bottom = round >= up;
    let corners = [a, if bottom { row + next } else { row + nodes + j }, b_above];
    let weights = if bottom { [1.0 - round, round - up, up] } else { [1.0 - up, up - round, round] };
    let [r0, r1, r2] = corners.map(|corner| wall[corner]);
    // Slopes within the triangle.
    let (per_node, per_ring) = if bottom { (r1 - r0, r2 - r1) } else { (r2 - r1, r1 - r0) };
    let wall = r0 + round * per_node + up * per_ring;
    let arc = job.step_theta * (job.start + wall);

    let y = -(per_node / arc);
    let z = -(per_ring / echo.step);
    let length = (1.0 + y * y + z * z).sqrt();
    let normal = [1.0 / length, y / length, z / length];
    let image = echo.normal;
    let tilt = normal[0] * image[0] + normal[1] * image[1] + normal[2] * image[2];
    let along_image = job.in_plane * tilt;
    let likeliest = [
        normal[0] - image[0] * along_image,
        normal[1] - image[1] * along_image,
        normal[2] - image[2] * along_image,
    ];
    let variance = normal[0] * likeliest[0] + normal[1] * likeliest[1] + normal[2] * likeliest[2];
    let across =
        normal[0] * (echo.rise - wall) - normal[1] * (shift[1] * arc) - normal[2] * (shift[0] * echo.step);
    let miss = across / variance.sqrt();
    Way { corners, weights, bottom, wall, arc, likeliest, variance, normal_x: normal[0], across, miss }
}

/// An echo's miss, and its foot: moved, where the job moves feet.
pub fn measure(job: &Job, echo: &Echo, wall: &[f32], shift: [f32; 2]) -> (f32, [f32; 2]) {
    let way = way_to_wall(job, echo, wall, shift);
    if job.feet == 0 {
        return (way.miss, shift);
    }
    let size = way.miss.abs();
    let reach = if size > job.farthest_foot { job.farthest_foot / size } else { 1.0 };
    let distance = -(way.across / way.variance) * reach;
    (way.miss, [way.likeliest[2] * distance / echo.step, way.likeliest[1] * distance / way.arc])
}

/// Fixed-point sums per node: coupling to itself, to the next along the ring, to the one above, to the one above that
/// next, and the right-hand side.
pub type Sums = [i64; 5];

/// Adds an echo to the least-squares equations.
pub fn accumulate(job: &Job, echo: &Echo, wall: &[f32], shift: [f32; 2], sums: &mut [Sums]) {
    let way = way_to_wall(job, echo, wall, shift);
    let miss = way.miss.abs();
    if job.gated != 0 && miss > job.gate.max(job.gate_radii * (job.start + way.wall)) {
        return;
    }
    let robust = if miss > job.huber { job.huber / miss } else { 1.0 };
    let weight = robust * (way.normal_x * way.normal_x / way.variance);
    // In units of the noise.
    let value = weight * (way.across / way.normal_x) * job.per_noise;
    let [p, q, r] = way.weights;
    let [a, m, c] = way.corners;
    // a couples to b along the ring or to a' across; b to b' across, a' to b' along; a to b' always.
    let (from_a, to_c) = if way.bottom { (1, 2) } else { (2, 1) };
    let mut add = |node: usize, part: usize, x: f32, scale: f32| sums[node][part] += x.to_fixed(scale);
    add(a, 0, weight * p * p, job.weight_scale);
    add(m, 0, weight * q * q, job.weight_scale);
    add(c, 0, weight * r * r, job.weight_scale);
    add(a, from_a, weight * p * q, job.weight_scale);
    add(m, to_c, weight * q * r, job.weight_scale);
    add(a, 3, weight * p * r, job.weight_scale);
    add(a, 4, p * value, job.way_scale);
    add(m, 4, q * value, job.way_scale);
    add(c, 4, r * value, job.way_scale);
}

#[cfg(all(test, feature = "gpu"))]
mod tests {
    use super::*;
    use crate::recording::echo_error::OUT_OF_PLANE;
    use crate::sweep::prepare::axis::Place;
    use crate::sweep::prepare::echo::Echo as OnCpu;
    use crate::sweep::prepare::grid::WallGrid;
    use crate::sweep::wall::equations::Equations;
    use crate::sweep::wall::fit::Wall;
    use crate::sweep::wall::residual::gate;
    use glam::{DMat3, DVec3};
    use rand::{RngExt, SeedableRng};
    use std::f64::consts::TAU;

    const GRID: WallGrid = WallGrid { rings: 40, nodes: 24, step_mm: 2.6, arc_mm: TAU * 10.0 / 24.0 };
    const START_MM: f64 = 10.3;
    const NOISE_MM: f64 = 0.8;

    /// A smooth wall, and echoes about it, far beyond its ends too.
    fn wall_and_echoes() -> (Vec<f64>, Vec<OnCpu>) {
        let radius = |node: usize| {
            let (k, j) = ((node / 24) as f64, (node % 24) as f64);
            10.0 + 0.6 * (0.4 * k).sin() + 0.5 * (2.0 * TAU * j / 24.0).cos()
        };
        // As f32 holds it, so that both see the same wall.
        let radii =
            (0..GRID.node_count()).map(|n| START_MM + f64::from((radius(n) - START_MM) as f32)).collect();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let echo = |_| {
            let turn = rng.random_range(0.0..TAU);
            let tilt: f64 = rng.random_range(-0.5..0.5);
            let place = Place {
                ring: rng.random_range(0.0..39.0),
                theta_rad: rng.random_range(0.0..TAU),
                radius_mm: rng.random_range(8.0..13.0),
                directions: DMat3::from_rotation_y(rng.random_range(-0.1..0.1)),
                stretch: rng.random_range(0.8..1.2),
            };
            OnCpu::new(
                &place,
                DVec3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos()),
                0,
                24,
            )
        };
        (radii, (0..3000).map(echo).collect())
    }

    fn on_cpu(radii_mm: &[f64], noise_mm: f64) -> Wall {
        Wall { radii_mm: radii_mm.to_vec(), noise_mm, ..Wall::tube(&GRID, START_MM) }
    }

    #[test]
    fn feet_and_misses_are_the_cpu_s() {
        let (radii, mut echoes) = wall_and_echoes();
        let wall: Vec<f32> = radii.iter().map(|r| (r - START_MM) as f32).collect();
        let job = Job { feet: 1, ..Job::new(40, 24, START_MM, OUT_OF_PLANE) }.with_noise(NOISE_MM);
        let mut shifts = vec![[0.0_f32; 2]; echoes.len()];
        // Feet that have moved, too. What is on another triangle after rounding is the same wall, but another slope.
        for round in 0..4 {
            let mut on_other_triangles = 0;
            for (echo, shift) in echoes.iter_mut().zip(&mut shifts) {
                let (miss, moved) = measure(&job, &echo.for_device(&GRID, START_MM), &wall, *shift);
                let before = echo.projection();
                on_cpu(&radii, NOISE_MM).residual_model(&GRID).measure(echo, true);
                // A dozen roundings of some 4 mm.
                if (f64::from(miss) - echo.residual_mm).abs() > 2e-5 {
                    on_other_triangles += 1;
                    let place = (before.0.fract() - before.1.rem_euclid(1.0)).abs();
                    assert!(place.min(before.0.fract()) < 1e-5, "{round}: {miss} {}", echo.residual_mm);
                }
                *shift = moved;
            }
            assert!(on_other_triangles <= 3, "{on_other_triangles}");
        }
        let apart = |(echo, shift): (&OnCpu, &[f32; 2])| {
            let device = echo.for_device(&GRID, START_MM);
            let foot = echo.projection();
            let ring = f64::from(device.ring) + f64::from(device.ring_part) + f64::from(shift[0]) - foot.0;
            let node = f64::from(device.node) + f64::from(device.node_part) + f64::from(shift[1]) - foot.1;
            ring.abs().max((node + 12.0).rem_euclid(24.0) - 12.0)
        };
        let far = echoes.iter().zip(&shifts).map(apart).filter(|apart| *apart > 1e-4).count();
        assert!(far <= 6, "{far} feet elsewhere");
    }

    #[test]
    fn sums_are_the_cpu_s() {
        let (radii, echoes) = wall_and_echoes();
        let wall: Vec<f32> = radii.iter().map(|r| (r - START_MM) as f32).collect();
        for gated in [0, 1] {
            let job = Job { gated, ..Job::new(40, 24, START_MM, OUT_OF_PLANE) }.with_noise(NOISE_MM / 4.0);
            let mut sums = vec![[0; 5]; GRID.node_count()];
            let mut expected = Equations::over(&GRID, 0..GRID.rings);
            for mut echo in echoes.iter().copied() {
                accumulate(&job, &echo.for_device(&GRID, START_MM), &wall, [0.0; 2], &mut sums);
                let measured = on_cpu(&radii, NOISE_MM / 4.0).residual_model(&GRID).measure(&mut echo, false);
                let miss = echo.residual_mm.abs();
                if gated == 0 || miss <= gate(NOISE_MM / 4.0, measured.wall_mm) {
                    let robust = (crate::numerics::robust::HUBER * NOISE_MM / 4.0 / miss).min(1.0);
                    let corners = GRID.corners(echo.projection().0, echo.projection().1);
                    expected.add(&corners, robust * measured.weight, measured.radial_mm * 4.0 / NOISE_MM);
                }
            }
            for (found, expected) in sums.iter().zip(expected.rows()) {
                for (part, (&found, expected)) in found.iter().zip(expected).enumerate() {
                    let unit = if part == 4 { job.way_unit } else { job.weight_unit };
                    let found = found as f64 * f64::from(unit);
                    assert!((found - expected).abs() < 2e-4, "{part}: {found} {expected}");
                }
            }
        }
    }
}
