//! Wall and pose errors as one linear mixed model.
//!
//! Echo i of frame k says of the radius under its foot `yᵢ = aᵢᵀr + jᵢᵀcₖ + eᵢ`: r are the radii at the nodes, cₖ the
//! error of the frame's pose, e noise. With normal priors, on c and on the bending of the wall, the likeliest r and c
//! minimise `Σ wᵢ (yᵢ - aᵢᵀr - jᵢᵀcₖ)² + σ² cᵀS⁻¹c + λ ∫ |bending|²`. c is eliminated, frame by frame: what is left is
//! generalised least squares for r, in which what a shift of a frame looks like has less weight than the rest.

use crate::geometry::Pose;
use crate::sweep::median;
use crate::sweep::prepare::axis::Axis;
use crate::sweep::wall::echo::{Echo, gate};
use crate::sweep::wall::grid::{Corners, Ease, Equations, Grid, Solver, System};
use crate::sweep::wall::{Wall, huber};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// A pose's error in the world's axes: shift in mm, then turn about the sensor in mm at the lumen's wall.
pub(in crate::sweep) type Twist = [f64; 6];
type Matrix = [Twist; 6];

/// Turn in degrees that goes with a shift of a millimetre: electromagnetic trackers shake by 0.3 to 1.4 mm and 0.3° to
/// 1°. Turns show too little, and in a straight vessel not at all, to have a level of their own.
const DEGREES_PER_MM: f64 = 1.0;
/// Least variance of pose errors, in variances of the noise: none at all has no inverse.
const LEAST_VARIANCE: f64 = 1e-12;
/// Stretches of the recording whose scatter tells the standard error of an offset.
const STRETCHES: usize = 32;
/// Steps of the ascent to the likeliest level of pose errors in one go.
const ASCENT_STEPS: usize = 10;

/// How the poses move, per second: shift in mm and turn in rad, in the world's axes.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::sweep) struct Motion {
    pub shift_mm: DVec3,
    pub turn_rad: DVec3,
}

/// How large noise and errors are.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Levels {
    /// σ: standard deviation of an echo about the wall when the poses are right, mm.
    pub noise_mm: f64,
    /// Standard deviation of a pose's shift along each axis, mm.
    pub shift_mm: f64,
}

/// An echo's equation.
struct Row {
    corners: Corners,
    /// Square root of the inverse variance, in units of the noise.
    scale: f64,
    /// Its square times the robust weight; 0 beyond the gate.
    weight: f64,
    /// y: the radius as the pose without any correction has it, mm.
    radius_mm: f64,
    /// j: by how much a pose's error lengthens the radius.
    pull: Twist,
    /// By how much a second of the poses' motion lengthens it, mm.
    slide_mm: f64,
}

/// The model about a wall.
pub(in crate::sweep) struct Joint<'a> {
    grid: &'a Grid,
    solver: &'a Solver,
    /// Frame by frame.
    rows: Vec<Row>,
    /// First row of each frame, and the end.
    starts: Vec<usize>,
    /// Per frame: `Σ w j jᵀ`.
    information: Vec<Matrix>,
    /// Variances of an error's components for a shift of variance one.
    shape: Twist,
}

/// Where the wall may bend more. Found in the first fits, then kept: a wall that may bend more does, and would then be
/// given still more.
#[derive(Default)]
pub(in crate::sweep) struct Eased {
    ease: Ease,
    is_settled: bool,
}

/// What the fit of a model gives.
pub(in crate::sweep) struct Fit {
    /// c: per frame.
    pub errors: Vec<Twist>,
    pub levels: Levels,
    pub solver_steps: usize,
}

/// An offset in time, s.
#[derive(Debug, Clone, Copy)]
pub(in crate::sweep) struct Offset {
    pub seconds: f64,
    pub standard_error_s: f64,
}

impl<'a> Joint<'a> {
    /// The model about `wall`, for echoes with their feet on it. `sensors` are the poses that the echoes were placed
    /// with, `errors` what was taken off the recorded ones to get them.
    pub(in crate::sweep) fn about(
        (grid, solver): (&'a Grid, &'a Solver),
        axis: &Axis,
        echoes: &[Echo],
        wall: &Wall,
        sensors: &[Pose],
        errors: &[Twist],
        motions: &[Motion],
    ) -> Self {
        let radius_mm = grid.radius_mm();
        let mut starts = vec![0; sensors.len() + 1];
        echoes.iter().for_each(|echo| starts[echo.frame as usize + 1] += 1);
        for k in 0..sensors.len() {
            starts[k + 1] += starts[k];
        }
        let mut next = starts.clone();
        let mut order = vec![0; echoes.len()];
        for (i, echo) in echoes.iter().enumerate() {
            let slot = &mut next[echo.frame as usize];
            order[*slot] = i;
            *slot += 1;
        }
        let rows: Vec<Row> = order
            .par_iter()
            .map(|&i| {
                let mut echo = echoes[i];
                let frame = echo.frame as usize;
                let (ring, node) = echo.foot();
                let measured = echo.measure(wall.held(grid), false);
                let (point, directions) = axis.at(echo.ring(), echo.theta_rad(grid.nodes), echo.radius_mm);
                let arm = point - sensors[frame].translation_mm;
                let normal = directions * measured.normal;
                let Motion { shift_mm, turn_rad } = motions[frame];
                let slide_mm = normal.dot(shift_mm + turn_rad.cross(arm)) / measured.normal.x;
                // A shift along the vessel hardly shows: where it does, at a narrow place, frames would slide to
                // wherever the wall is smoothest.
                let across = normal - directions.z_axis * normal.dot(directions.z_axis);
                let shift = across / measured.normal.x;
                let turn = (arm / radius_mm).cross(shift);
                let pull = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
                let miss = echo.miss_mm.abs();
                let counts = miss <= gate(wall.noise_mm, measured.wall_mm);
                Row {
                    corners: grid.corners(ring, node),
                    scale: measured.weight.sqrt(),
                    weight: if counts {
                        huber(wall.noise_mm, miss) * measured.weight * echo.weight
                    } else {
                        0.0
                    },
                    radius_mm: measured.wall_mm + measured.radial_mm + dot(&pull, &errors[frame]),
                    pull,
                    slide_mm,
                }
            })
            .collect();
        let information = starts
            .par_windows(2)
            .map(|range| {
                let mut sum = Matrix::default();
                for row in &rows[range[0]..range[1]] {
                    for (line, pull) in sum.iter_mut().zip(row.pull) {
                        line.iter_mut().zip(row.pull).for_each(|(s, other)| *s += row.weight * pull * other);
                    }
                }
                sum
            })
            .collect();
        let turn = (DEGREES_PER_MM.to_radians() * radius_mm).powi(2);
        Self { grid, solver, rows, starts, information, shape: [1.0, 1.0, 1.0, turn, turn, turn] }
    }

    /// Fits radii and errors, and estimates the levels from them, `times` times in turn. λ = (σ/τ)² goes along.
    pub(in crate::sweep) fn fit(
        &self,
        levels: Levels,
        times: usize,
        roughness: f64,
        eased: &mut Eased,
        radii_mm: &mut [f64],
    ) -> Fit {
        let values: Vec<f64> = self.rows.iter().map(|row| row.radius_mm).collect();
        let mut fit = Fit { errors: Vec::new(), levels, solver_steps: 0 };
        for _ in 0..times {
            let noise_mm = fit.levels.noise_mm;
            let errors = self.errors_at(fit.levels);
            if !eased.is_settled {
                eased.ease = Ease::at_bends(self.grid, radii_mm, roughness);
            }
            fit.solver_steps += self.solve(&errors, fit.levels, roughness, &eased.ease, &values, radii_mm);
            let sums = self.sums(|i| values[i] - self.rows[i].corners.value(radii_mm));
            fit.errors = errors.of(&sums);
            fit.levels.noise_mm = self.noise_mm(&values, &fit.errors, &errors, radii_mm).max(1e-9 * noise_mm);
            fit.levels.shift_mm = self.shift_level_mm(&sums, fit.levels);
        }
        eased.is_settled = true;
        fit
    }

    /// The offset in time that the motion of the poses makes likeliest at a fit: one Gauss-Newton step, radii and errors
    /// free to follow.
    pub(in crate::sweep) fn offset(
        &self,
        fit: &Fit,
        roughness: f64,
        eased: &Eased,
        radii_mm: &[f64],
    ) -> Offset {
        let errors = self.errors_at(fit.levels);
        let slides: Vec<f64> = self.rows.iter().map(|row| row.slide_mm).collect();
        let mut follow = vec![0.0; radii_mm.len()];
        self.solve(&errors, fit.levels, roughness, &eased.ease, &slides, &mut follow);
        let unseen = errors.of(&self.sums(|i| slides[i] - self.rows[i].corners.value(&follow)));
        let mut information = 0.0;
        let stretch = self.information.len().div_ceil(STRETCHES);
        let mut scores = [0.0; STRETCHES];
        for (k, range) in self.starts.windows(2).enumerate() {
            for (row, slide) in self.rows[range[0]..range[1]].iter().zip(&slides[range[0]..]) {
                let left = slide - row.corners.value(&follow) - dot(&row.pull, &unseen[k]);
                let miss = row.radius_mm - row.corners.value(radii_mm) - dot(&row.pull, &fit.errors[k]);
                information += row.weight * slide * left;
                scores[k / stretch] -= row.weight * left * miss;
            }
        }
        let seconds = scores.iter().sum::<f64>() / information;
        // What a model leaves out is alike in neighbouring frames, so the scatter of whole stretches counts as well.
        let scatter = scores.iter().map(|s| s * s).sum::<f64>() / (information * information);
        let of_noise = fit.levels.noise_mm.powi(2) / information;
        Offset { seconds, standard_error_s: scatter.max(of_noise).sqrt() }
    }

    /// Σ w j value of each frame.
    fn sums(&self, value: impl Fn(usize) -> f64 + Sync) -> Vec<Twist> {
        self.starts
            .par_windows(2)
            .map(|range| {
                let mut sum = Twist::default();
                for i in range[0]..range[1] {
                    let row = &self.rows[i];
                    let weighted = row.weight * value(i);
                    sum.iter_mut().zip(row.pull).for_each(|(s, pull)| *s += weighted * pull);
                }
                sum
            })
            .collect()
    }

    /// `σ²S⁻¹`: what the prior adds to a frame's information.
    fn prior(&self, levels: Levels) -> Twist {
        let noise = levels.noise_mm * levels.noise_mm;
        let variance = (levels.shift_mm * levels.shift_mm).max(LEAST_VARIANCE * noise);
        self.shape.map(|shape| noise / (variance * shape))
    }

    fn errors_at(&self, levels: Levels) -> Errors {
        let prior = self.prior(levels);
        let factored = |information: &Matrix| {
            let mut matrix = *information;
            (0..6).for_each(|i| matrix[i][i] += prior[i]);
            Cholesky::of(&matrix)
        };
        Errors { frames: self.information.par_iter().map(factored).collect() }
    }

    /// The likeliest radii for these values of the echoes when errors are free to follow.
    fn solve(
        &self,
        errors: &Errors,
        levels: Levels,
        roughness: f64,
        ease: &Ease,
        values: &[f64],
        x: &mut [f64],
    ) -> usize {
        let explained = errors.of(&self.sums(|i| values[i]));
        let mut equations = Equations::over(self.grid, 0..self.grid.rings);
        for (k, range) in self.starts.windows(2).enumerate() {
            for (row, value) in self.rows[range[0]..range[1]].iter().zip(&values[range[0]..]) {
                equations.add(&row.corners, row.weight, value - dot(&row.pull, &explained[k]));
            }
        }
        let coupling = |x: &[f64], out: &mut [f64]| {
            let explained = errors.of(&self.sums(|i| self.rows[i].corners.value(x)));
            for (k, range) in self.starts.windows(2).enumerate() {
                for row in &self.rows[range[0]..range[1]] {
                    let pull = row.weight * dot(&row.pull, &explained[k]);
                    for (node, weight) in row.corners.nodes.iter().zip(row.corners.weights) {
                        out[*node] -= pull * weight;
                    }
                }
            }
        };
        let noise_mm = crate::sweep::wall::smoothed_noise(self.grid, levels.noise_mm, roughness);
        let of_a_frame = self.rows.len() as f64 / self.information.len() as f64 / 2.0;
        let system = System {
            equations: &equations,
            smoothness_mm2: (noise_mm / roughness).powi(2),
            ease,
            coupling: &coupling,
            first_harmonic: 1.0 / (1.0 + of_a_frame * (levels.shift_mm / levels.noise_mm).powi(2)),
        };
        self.solver.solve(&system, (1e-3 * levels.noise_mm / self.grid.radius_mm()).max(1e-10), x)
    }

    /// σ, from the median of what radii and errors leave, with the freedom that the errors took.
    fn noise_mm(&self, values: &[f64], errors: &[Twist], factored: &Errors, radii_mm: &[f64]) -> f64 {
        let mut misses: Vec<f64> = Vec::with_capacity(values.len());
        for (k, range) in self.starts.windows(2).enumerate() {
            for (row, value) in self.rows[range[0]..range[1]].iter().zip(&values[range[0]..]) {
                if row.weight > 0.0 {
                    let left = value - row.corners.value(radii_mm) - dot(&row.pull, &errors[k]);
                    misses.push((left * row.scale).abs());
                }
            }
        }
        let freedom: f64 = factored.frames.iter().zip(&self.information).map(|(f, h)| f.trace_of(h)).sum();
        let count = misses.len() as f64;
        1.4826 * median(&mut misses) * (count / (count - freedom).max(0.1 * count)).sqrt()
    }

    /// The likeliest standard deviation of a shift given the radii. Where `v` is its square and P the precision of a
    /// frame's misses as they bear on its error, the likelihood rises with every `v ← v √(Σ |Pg|²/Σ tr P)`.
    fn shift_level_mm(&self, sums: &[Twist], mut levels: Levels) -> f64 {
        let noise = levels.noise_mm * levels.noise_mm;
        for _ in 0..ASCENT_STEPS {
            let prior = self.prior(levels);
            let errors = self.errors_at(levels);
            let terms: Vec<[f64; 2]> = errors
                .frames
                .par_iter()
                .zip(sums)
                .map(|(factor, sum)| {
                    let error = factor.solve(sum);
                    let inverse = factor.inverse_diagonal();
                    let mut terms = [0.0; 2];
                    for i in 0..6 {
                        // In units of the noise: S⁻¹c, and the diagonal of S⁻¹ - S⁻¹K⁻¹S⁻¹.
                        terms[0] += self.shape[i] * (prior[i] * error[i]).powi(2);
                        terms[1] += self.shape[i] * noise * (prior[i] - prior[i] * prior[i] * inverse[i]);
                    }
                    terms
                })
                .collect();
            let [pulled, expected] = terms.iter().fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
            if expected.is_nan() || expected <= 0.0 {
                break;
            }
            levels.shift_mm *= (pulled / expected).powf(0.25);
            levels.shift_mm = levels.shift_mm.max(levels.noise_mm * LEAST_VARIANCE.sqrt());
        }
        levels.shift_mm
    }
}

/// The errors' part of the equations, factored: one system a frame.
struct Errors {
    frames: Vec<Cholesky>,
}

impl Errors {
    /// The likeliest errors for these sums of misses.
    fn of(&self, sums: &[Twist]) -> Vec<Twist> {
        self.frames.iter().zip(sums).map(|(frame, sum)| frame.solve(sum)).collect()
    }
}

/// `LLᵀ` of a symmetric positive definite matrix.
struct Cholesky(Matrix);

impl Cholesky {
    fn of(matrix: &Matrix) -> Self {
        let mut l = Matrix::default();
        for i in 0..6 {
            for j in 0..=i {
                let rest = matrix[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
                l[i][j] = if i == j { rest.max(f64::MIN_POSITIVE).sqrt() } else { rest / l[j][j] };
            }
        }
        Self(l)
    }

    fn solve(&self, right: &Twist) -> Twist {
        let Self(l) = self;
        let mut x = *right;
        for i in 0..6 {
            let known: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
            x[i] = (x[i] - known) / l[i][i];
        }
        for i in (0..6).rev() {
            let known: f64 = (i + 1..6).map(|k| l[k][i] * x[k]).sum();
            x[i] = (x[i] - known) / l[i][i];
        }
        x
    }

    fn column(&self, i: usize) -> Twist {
        let mut unit = Twist::default();
        unit[i] = 1.0;
        self.solve(&unit)
    }

    fn inverse_diagonal(&self) -> Twist {
        std::array::from_fn(|i| self.column(i)[i])
    }

    /// Trace of the inverse times a symmetric matrix.
    fn trace_of(&self, matrix: &Matrix) -> f64 {
        (0..6).map(|i| dot(&self.column(i), &matrix[i])).sum()
    }
}

fn dot(a: &Twist, b: &Twist) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A pose without its error.
pub(in crate::sweep) fn corrected(pose: &Pose, error: &Twist, radius_mm: f64) -> Pose {
    let (shift, turn) = split(error, radius_mm);
    Pose {
        rotation: DMat3::from_quat(glam::DQuat::from_scaled_axis(-turn)) * pose.rotation,
        translation_mm: pose.translation_mm - shift,
    }
}

/// Shift in mm and turn in rad.
pub(in crate::sweep) fn split(error: &Twist, radius_mm: f64) -> (DVec3, DVec3) {
    let [a, b, c, d, e, f] = *error;
    (DVec3::new(a, b, c), DVec3::new(d, e, f) / radius_mm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factored_system_is_solved() {
        let column = |i: usize| std::array::from_fn(|j| 1.0 / (1.0 + (i + j) as f64));
        let mut matrix: Matrix = std::array::from_fn(column);
        (0..6).for_each(|i| matrix[i][i] += 0.1);
        let factored = Cholesky::of(&matrix);
        let x = [1.0, -2.0, 3.0, 0.5, 0.0, 7.0];
        let found = factored.solve(&matrix.map(|line| dot(&line, &x)));
        assert!(found.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-10), "{found:?}");
        assert!((factored.trace_of(&matrix) - 6.0).abs() < 1e-10);
    }

    #[test]
    fn an_error_that_is_taken_off_leaves_the_pose() {
        let turn = DVec3::new(0.01, -0.02, 0.03);
        let truth = Pose { rotation: DMat3::from_rotation_x(0.4), translation_mm: DVec3::new(1.0, 2.0, 3.0) };
        let wrong = Pose {
            rotation: DMat3::from_quat(glam::DQuat::from_scaled_axis(turn)) * truth.rotation,
            translation_mm: truth.translation_mm + DVec3::new(0.3, -0.2, 0.1),
        };
        let error = [0.3, -0.2, 0.1, 10.0 * turn.x, 10.0 * turn.y, 10.0 * turn.z];
        let found = corrected(&wrong, &error, 10.0);
        assert!(found.rotation.abs_diff_eq(truth.rotation, 1e-12));
        assert!(found.translation_mm.distance(truth.translation_mm) < 1e-12);
    }
}
