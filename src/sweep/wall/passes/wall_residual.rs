//! The residual of an echo along its error ellipsoid (`shaders/sweep/common/wall_residual.wgsl`). In f64 this
//! is `ResidualModel::measure` of the CPU.

use super::{DeviceEcho, WallParameters};

/// Projections are at most this many cells away, so that integers hold their cells.
pub const MAX_CELLS: f32 = 16777216.0;

/// The residual of an echo, and the wall at its projection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallResidual {
    /// The triangle's corners a, b, b' or a, a', b', as node indices.
    pub corners: [usize; 3],
    /// The projection's barycentric weights.
    pub weights: [f32; 3],
    /// Whether it is the bottom triangle (a, b, b').
    pub bottom: bool,
    /// The wall's radius at the projection less `start` of the parameters, mm.
    pub wall: f32,
    /// Length of a node's arc there, mm.
    pub arc: f32,
    /// The likeliest direction of an error: the error ellipsoid's matrix times the wall's normal.
    pub likeliest: [f32; 3],
    /// The variance along the normal, in units of the noise.
    pub variance: f32,
    /// The radial part of the wall's normal.
    pub normal_x: f32,
    /// Distance along the normal, mm.
    pub normal_distance: f32,
    /// The standardised residual, in mm of noise along the likeliest direction.
    pub residual: f32,
}

/// The residual of an echo whose projection lies `shift` rings and nodes from it.
pub fn residual_to_wall(
    parameters: &WallParameters,
    echo: &DeviceEcho,
    wall_mm: &[f32],
    shift: [f32; 2],
) -> WallResidual {
    let ring = echo.ring_part + shift[0];
    let rings_up = ring.floor().clamp(-MAX_CELLS, MAX_CELLS);
    let wanted = echo.ring as i32 + rings_up as i32;
    let last = parameters.rings as i32 - 2;
    let level = wanted.clamp(0, last) as usize;
    let mut up = (ring - rings_up).clamp(0.0, 1.0);
    if wanted < 0 {
        up = 0.0;
    }
    if wanted > last {
        up = 1.0;
    }
    let node = echo.node_part + shift[1];
    let nodes_on = node.floor().clamp(-MAX_CELLS, MAX_CELLS);
    let nodes = parameters.nodes as usize;
    let j = (echo.node as i32 + nodes_on as i32).rem_euclid(nodes as i32) as usize;
    let round = (node - nodes_on).clamp(0.0, 1.0);
    let next = if j + 1 == nodes { 0 } else { j + 1 };

    let row = level * nodes;
    let (a, b_above) = (row + j, row + nodes + next);
    let bottom = round >= up;
    let corners = [a, if bottom { row + next } else { row + nodes + j }, b_above];
    let weights = if bottom { [1.0 - round, round - up, up] } else { [1.0 - up, up - round, round] };
    let [r0, r1, r2] = corners.map(|corner| wall_mm[corner]);
    // Slopes within the triangle.
    let (per_node, per_ring) = if bottom { (r1 - r0, r2 - r1) } else { (r2 - r1, r1 - r0) };
    let wall = r0 + round * per_node + up * per_ring;
    let arc = parameters.step_theta * (parameters.start + wall);

    // Those over the noise's reach.
    let reach = parameters.slope_nodes as usize;
    let behind = (j + nodes - reach) % nodes;
    let ahead = (j + 1 + reach) % nodes;
    let round_row = if bottom { row } else { row + nodes };
    let around = (wall_mm[round_row + ahead] - wall_mm[round_row + behind]) / (2 * reach + 1) as f32;
    let low = level.saturating_sub(parameters.slope_rings as usize);
    let high = (level + 1 + parameters.slope_rings as usize).min(parameters.rings as usize - 1);
    let column = if bottom { next } else { j };
    let along = (wall_mm[high * nodes + column] - wall_mm[low * nodes + column]) / (high - low) as f32;
    let y = -(around / arc);
    let z = -(along / echo.step);
    let length = (1.0 + y * y + z * z).sqrt();
    let normal = [1.0 / length, y / length, z / length];
    let image = echo.normal;
    let tilt = normal[0] * image[0] + normal[1] * image[1] + normal[2] * image[2];
    let along_image = parameters.in_plane * tilt;
    let likeliest = [
        normal[0] - image[0] * along_image,
        normal[1] - image[1] * along_image,
        normal[2] - image[2] * along_image,
    ];
    let variance = normal[0] * likeliest[0] + normal[1] * likeliest[1] + normal[2] * likeliest[2];
    let normal_distance =
        normal[0] * (echo.rise - wall) - normal[1] * (shift[1] * arc) - normal[2] * (shift[0] * echo.step);
    let residual = normal_distance / variance.sqrt();
    WallResidual {
        corners,
        weights,
        bottom,
        wall,
        arc,
        likeliest,
        variance,
        normal_x: normal[0],
        normal_distance,
        residual,
    }
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
    use crate::sweep::wall::passes::{accumulate, measure};
    use crate::sweep::wall::residual::gate;
    use glam::{DMat3, DVec3};
    use rand::{RngExt, SeedableRng};
    use std::f64::consts::TAU;

    const GRID: WallGrid = WallGrid { rings: 40, nodes: 24, step_mm: 2.6, arc_mm: TAU * 10.0 / 24.0 };
    const START_MM: f64 = 10.3;
    const NOISE_MM: f64 = 0.8;

    fn parameters() -> WallParameters {
        WallParameters::new([40, 24], [GRID.step_mm, GRID.arc_mm], START_MM, OUT_OF_PLANE)
    }

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
    fn projections_and_residuals_are_the_cpu_s() {
        let (radii, mut echoes) = wall_and_echoes();
        let wall: Vec<f32> = radii.iter().map(|r| (r - START_MM) as f32).collect();
        let parameters = WallParameters { project: 1, ..parameters() }.with_noise(NOISE_MM);
        let mut shifts = vec![[0.0_f32; 2]; echoes.len()];
        // Projections that have moved, too. After rounding, some lie on the neighbouring triangle: the wall is the
        // same there, but not its slope.
        for round in 0..4 {
            let mut on_other_triangles = 0;
            for (echo, shift) in echoes.iter_mut().zip(&mut shifts) {
                let (residual, moved) =
                    measure(&parameters, &echo.for_device(&GRID, START_MM), &wall, *shift);
                let before = echo.projection();
                on_cpu(&radii, NOISE_MM).residual_model(&GRID).measure(echo, true);
                // A dozen roundings of some 4 mm.
                if (f64::from(residual) - echo.residual_mm).abs() > 2e-5 {
                    on_other_triangles += 1;
                    let place = (before.0.fract() - before.1.rem_euclid(1.0)).abs();
                    assert!(place.min(before.0.fract()) < 1e-5, "{round}: {residual} {}", echo.residual_mm);
                }
                *shift = moved;
            }
            assert!(on_other_triangles <= 3, "{on_other_triangles}");
        }
        let apart = |(echo, shift): (&OnCpu, &[f32; 2])| {
            let device = echo.for_device(&GRID, START_MM);
            let projection = echo.projection();
            let ring =
                f64::from(device.ring) + f64::from(device.ring_part) + f64::from(shift[0]) - projection.0;
            let node =
                f64::from(device.node) + f64::from(device.node_part) + f64::from(shift[1]) - projection.1;
            ring.abs().max((node + 12.0).rem_euclid(24.0) - 12.0)
        };
        let far = echoes.iter().zip(&shifts).map(apart).filter(|apart| *apart > 1e-4).count();
        assert!(far <= 6, "{far} projections elsewhere");
    }

    #[test]
    fn sums_are_the_cpu_s() {
        let (radii, echoes) = wall_and_echoes();
        let wall: Vec<f32> = radii.iter().map(|r| (r - START_MM) as f32).collect();
        for gated in [0, 1] {
            let parameters = WallParameters { gated, ..parameters() }.with_noise(NOISE_MM / 4.0);
            let mut sums = vec![[0; 5]; GRID.node_count()];
            let mut expected = Equations::over(&GRID, 0..GRID.rings);
            for mut echo in echoes.iter().copied() {
                accumulate(&parameters, &echo.for_device(&GRID, START_MM), &wall, [0.0; 2], &mut sums);
                let measured = on_cpu(&radii, NOISE_MM / 4.0).residual_model(&GRID).measure(&mut echo, false);
                let residual = echo.residual_mm.abs();
                if gated == 0 || residual <= gate(NOISE_MM / 4.0, measured.wall_mm) {
                    let robust = (crate::numerics::robust::HUBER * NOISE_MM / 4.0 / residual).min(1.0);
                    let corners = GRID.corners(echo.projection().0, echo.projection().1);
                    expected.add(&corners, robust * measured.weight, measured.radial_mm * 4.0 / NOISE_MM);
                }
            }
            for (found, expected) in sums.iter().zip(expected.rows()) {
                for (part, (&found, expected)) in found.iter().zip(expected).enumerate() {
                    let unit = if part == 4 { parameters.rhs_unit } else { parameters.weight_unit };
                    let found = found as f64 * f64::from(unit);
                    assert!((found - expected).abs() < 2e-4, "{part}: {found} {expected}");
                }
            }
        }
    }
}
