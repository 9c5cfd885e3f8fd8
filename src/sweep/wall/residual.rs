//! The residual of an echo from a wall, along the echo's error ellipsoid.

use crate::numerics::vectorized;
use crate::recording::echo_error::{OUT_OF_PLANE, likeliest_direction};
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::{Corners, SlopeReach, WallGrid};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Echoes within this many standard deviations of the noise …
pub(in crate::sweep) const GATE_SDS: f64 = 6.0;
/// … or within this share of the radius count as echoes of this wall; others are echoes of a branch, or wrong.
pub(in crate::sweep) const GATE_RADII: f64 = 0.25;
/// Projections lie at most this many standard deviations from their echoes.
pub(in crate::sweep) const MAX_PROJECTION_SDS: f64 = 3.0;
/// Steps within which projections converge on a wall that stays.
const PROJECTION_STEPS: usize = 3;
/// Echoes per parallel task: a fixed number, so that sums do not depend on the number of threads.
pub(in crate::sweep) const TASK: usize = 8192;

/// Echoes whose residuals are evaluated side by side, and the numbers that go into one, and come out.
const BLOCK: usize = 32;
const INPUTS: usize = 11;
const OUTPUTS: usize = 8;

/// The wall and the noise that residuals are evaluated on.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct ResidualModel<'a> {
    pub grid: &'a WallGrid,
    pub radii_mm: &'a [f64],
    /// Standard deviation of an echo about the wall, mm.
    pub noise_mm: f64,
    /// Share of the noise's variance across the image plane.
    pub out_of_plane: f64,
    reach: SlopeReach,
}

/// The linearised equation of an echo for the radius at its projection.
pub(in crate::sweep) struct Measured {
    /// Distance along the radius to the wall's tangent plane at the projection, mm.
    pub radial_mm: f64,
    /// Inverse variance of that, in units of the noise.
    pub weight: f64,
    /// The current radius there, mm.
    pub wall_mm: f64,
    /// The wall's normal there, away from the axis, about it and along it, so long that its part away from the axis is 1.
    pub normal: DVec3,
}

impl Measured {
    /// Keeps residual and projection of the outputs of an echo.
    #[inline(always)]
    fn kept(outputs: [f64; OUTPUTS], echo: &mut Echo, project: bool) -> Self {
        let [radial_mm, weight, wall_mm, y, z, residual_mm, rings, nodes] = outputs;
        echo.residual_mm = residual_mm;
        if project {
            echo.shift = [rings as f32, nodes as f32];
        }
        Self { radial_mm, weight, wall_mm, normal: DVec3::new(1.0, y, z) }
    }
}

impl<'a> ResidualModel<'a> {
    pub(in crate::sweep) fn new(
        grid: &'a WallGrid,
        radii_mm: &'a [f64],
        noise_mm: f64,
        out_of_plane: f64,
    ) -> Self {
        Self { grid, radii_mm, noise_mm, out_of_plane, reach: grid.slope_reach(noise_mm) }
    }

    /// Evaluates an echo's residual on the triangle at its projection, and with `project` moves the projection.
    ///
    /// With n the wall's normal, of any length, from its slopes over the [reach of the noise](WallGrid::slope_reach), Σ the
    /// covariance of the echo's errors and d the vector from the projection to the echo, the likeliest point of the wall lies
    /// along `Σn` ([`likeliest_direction`]), and the standardised residual is `nᵀd / √(nᵀΣn)`. Along the radius instead, an echo that
    /// noise moved outwards along a tilted plane would be compared with the wall farther along the axis: where a catheter
    /// rests tilted, that lifts the wall by as much as the noise.
    #[inline(always)]
    pub(in crate::sweep) fn measure(&self, echo: &mut Echo, project: bool) -> Measured {
        let (_, inputs) = self.inputs(echo);
        Measured::kept(self.outputs(inputs, project), echo, project)
    }

    /// As [`measure`](Self::measure), for many echoes; calls `each` with the place of every echo in the list, the echo, and the
    /// triangle that it was measured on.
    #[inline(always)]
    pub(in crate::sweep) fn measure_each(
        &self,
        echoes: &mut [Echo],
        project: bool,
        mut each: impl FnMut(usize, &Echo, &Corners, &Measured),
    ) {
        let mut triangles = [Corners::default(); BLOCK];
        let mut inputs = [[0.0; BLOCK]; INPUTS];
        let mut outputs = [[0.0; BLOCK]; OUTPUTS];
        for (first, block) in (0..).step_by(BLOCK).zip(echoes.chunks_mut(BLOCK)) {
            for (i, (echo, triangle)) in block.iter().zip(&mut triangles).enumerate() {
                let (corners, values) = self.inputs(echo);
                *triangle = corners;
                for (of_block, value) in inputs.iter_mut().zip(&values) {
                    of_block[i] = *value;
                }
            }
            // Divisions and roots take most of the time. Where nothing else is done, a processor computes several side by side.
            let [wall, around, along, rings_apart, radius, stretch, rings, nodes, x, y, z] = &inputs;
            for i in 0..BLOCK {
                let of_echo = [
                    wall[i],
                    around[i],
                    along[i],
                    rings_apart[i],
                    radius[i],
                    stretch[i],
                    rings[i],
                    nodes[i],
                    x[i],
                    y[i],
                    z[i],
                ];
                let values = self.outputs(of_echo, project);
                for (of_block, value) in outputs.iter_mut().zip(&values) {
                    of_block[i] = *value;
                }
            }
            let [radial, weight, wall, y, z, residual, rings, nodes] = &outputs;
            for (i, (echo, triangle)) in block.iter_mut().zip(&triangles).enumerate() {
                let values = [radial[i], weight[i], wall[i], y[i], z[i], residual[i], rings[i], nodes[i]];
                let measured = Measured::kept(values, echo, project);
                each(first + i, echo, triangle, &measured);
            }
        }
    }

    /// What the residual of an echo is computed from, and the triangle at its projection.
    #[inline(always)]
    fn inputs(&self, echo: &Echo) -> (Corners, [f64; INPUTS]) {
        let Self { grid, radii_mm, reach, .. } = *self;
        let (ring, node) = echo.projection();
        let corners = grid.corners(ring, node);
        let [r0, r1, r2] = corners.nodes.map(|n| radii_mm[n]);
        let [w0, w1, w2] = corners.weights;
        let wall_mm = r0 * w0 + r1 * w1 + r2 * w2;
        let [around_mm, along_mm, rings] = grid.rises(&corners, radii_mm, reach);
        let [shift_rings, shift_nodes] = echo.shift.map(f64::from);
        let DVec3 { x, y, z } = echo.image_normal.as_dvec3();
        let stretch = f64::from(echo.stretch);
        let values =
            [wall_mm, around_mm, along_mm, rings, echo.radius_mm, stretch, shift_rings, shift_nodes, x, y, z];
        (corners, values)
    }

    /// The [`Measured`] of an echo, its residual, and with `project` the shift to its new projection.
    #[inline(always)]
    fn outputs(&self, inputs: [f64; INPUTS], project: bool) -> [f64; OUTPUTS] {
        let Self { grid, noise_mm: noise, out_of_plane, reach, .. } = *self;
        let [wall, around, along, rings_apart, radius, stretch, rings, nodes, x, y, z] = inputs;
        let [per_node, per_ring] = [around / reach.span_nodes(), along / rings_apart];
        let arc = TAU / grid.nodes as f64 * wall;
        let step = grid.step_mm * stretch;
        let [per_arc, per_step] = [arc.recip(), step.recip()];
        let normal = DVec3::new(1.0, -per_node * per_arc, -per_ring * per_step);
        let from_projection = DVec3::new(radius - wall, -nodes * arc, -rings * step);
        let (likeliest, variance) = likeliest_direction(normal, DVec3::new(x, y, z), out_of_plane);
        let weight = variance.recip();
        let radial = normal.dot(from_projection);
        let residual = radial * weight.sqrt();
        let mut shift = [0.0; 2];
        if project {
            let (size, most) = (residual.abs(), MAX_PROJECTION_SDS * noise);
            let share = if size > most { most / size } else { 1.0 };
            let moved = likeliest * (-radial * weight * share);
            shift = [moved.z * per_step, moved.y * per_arc];
        }
        [radial, weight, wall, normal.y, normal.z, residual, shift[0], shift[1]]
    }

    /// Moves the projections of all echoes until they have converged on the wall.
    pub(in crate::sweep) fn project_all(&self, echoes: &mut [Echo]) {
        echoes.par_chunks_mut(TASK / 8).for_each(|task| {
            vectorized(
                #[inline(always)]
                || (0..PROJECTION_STEPS).for_each(|_| self.measure_each(task, true, |_, _, _, _| ())),
            );
        });
    }
}

/// As [`ResidualModel::measure`] while no wall is known: the wall is taken to be a tube through the echo.
pub(in crate::sweep) fn measure_on_tube(echo: &mut Echo) -> Measured {
    echo.shift = [0.0; 2];
    echo.residual_mm = 0.0;
    let tilt = f64::from(echo.image_normal.x);
    let weight = (1.0 - (1.0 - OUT_OF_PLANE) * tilt * tilt).recip();
    Measured { radial_mm: 0.0, weight, wall_mm: echo.radius_mm, normal: DVec3::X }
}

/// The largest standardised residual of an echo of a wall, mm.
pub(in crate::sweep) fn gate(noise_mm: f64, radius_mm: f64) -> f64 {
    (GATE_SDS * noise_mm).max(GATE_RADII * radius_mm)
}

/// Whether an echo with a known residual is one of this wall.
pub(in crate::sweep) fn is_inlier(echo: &Echo, noise_mm: f64) -> bool {
    echo.residual_mm.abs() <= gate(noise_mm, echo.radius_mm - echo.residual_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn residuals_side_by_side_are_those_of_single_echoes() {
        let grid = WallGrid { rings: 30, nodes: 24, step_mm: 1.1, arc_mm: 0.9 };
        let radii_mm: Vec<f64> =
            (0..grid.node_count()).map(|n| 9.0 + (0.37 * (n * n % 101) as f64).sin()).collect();
        let model = ResidualModel::new(&grid, &radii_mm, 0.8, OUT_OF_PLANE);
        let echo = |i: u32| {
            let wave = |step: f64| (step * f64::from(i * i % 977)).sin();
            let tilt = 0.4 * wave(0.7) as f32;
            Echo {
                ring: 14.5 + 16.0 * wave(0.3),
                node: 12.0 + 13.0 * wave(0.5),
                radius_mm: 9.0 + 3.0 * wave(0.9),
                residual_mm: 0.0,
                image_normal: Vec3::new(tilt.sin(), 0.0, tilt.cos()),
                stretch: 1.0 + 0.2 * wave(0.2) as f32,
                shift: [0.3 * wave(1.3) as f32, 0.2 * wave(1.7) as f32],
                weight: 1.0,
                frame: i,
            }
        };
        // Whole blocks, and a part of one.
        for count in [1, 31, 32, 75] {
            for project in [false, true] {
                let echoes: Vec<Echo> = (0..count).map(echo).collect();
                let mut expected = echoes.clone();
                let measured: Vec<Measured> =
                    expected.iter_mut().map(|echo| model.measure(echo, project)).collect();
                let mut found = echoes.clone();
                let mut places = Vec::new();
                vectorized(
                    #[inline(always)]
                    || {
                        model.measure_each(&mut found, project, |i, echo, corners, found| {
                            let (ring, node) = echoes[i].projection();
                            assert_eq!(grid.corners(ring, node).nodes, corners.nodes);
                            assert_eq!(echo.residual_mm.to_bits(), expected[i].residual_mm.to_bits());
                            let [a, b] = [found, &measured[i]]
                                .map(|of| [of.radial_mm, of.weight, of.wall_mm, of.normal.y, of.normal.z]);
                            assert_eq!(a.map(f64::to_bits), b.map(f64::to_bits), "{i} of {count}");
                            places.push(i);
                        });
                    },
                );
                assert_eq!(places, (0..count as usize).collect::<Vec<_>>());
                let shifts = |of: &[Echo]| of.iter().map(|echo| echo.shift).collect::<Vec<_>>();
                assert_eq!(shifts(&found), shifts(&expected));
                assert_eq!(project, shifts(&found) != shifts(&echoes));
            }
        }
    }
}
