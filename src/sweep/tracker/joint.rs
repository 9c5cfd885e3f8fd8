//! Wall and pose errors as one linear mixed model.
//!
//! The equation of echo i of frame k for the radius at its projection is `yᵢ = aᵢᵀr + jᵢᵀcₖ + eᵢ`: r are the radii at the
//! nodes, cₖ is the error of the frame's pose, e is noise. With normal priors on c and on the bending of the wall, the
//! likeliest r and c minimise `Σ wᵢ (yᵢ - aᵢᵀr - jᵢᵀcₖ)² + σ² cᵀS⁻¹c + λ ∫ |bending|²`. Eliminating c frame by frame
//! leaves generalised least squares for r, which gives less weight to deviations that look like a shift of a frame.

use crate::geometry::Pose;
use crate::numerics::cholesky::{self, Matrix, cholesky, dot, inverse_column};
use crate::numerics::robust::{huber_weight, robust_sd};
use crate::sweep::prepare::axis::Axis;
use crate::sweep::prepare::echo::Echo;
use crate::sweep::prepare::grid::{Corners, WallGrid};
use crate::sweep::wall::bending::LocalSmoothness;
use crate::sweep::wall::equations::Equations;
use crate::sweep::wall::fit::Wall;
use crate::sweep::wall::residual::gate;
use crate::sweep::wall::solver::{MAX_STEPS, System, solve};
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// A pose's error in the world's axes: shift in mm, then rotation about the sensor in mm at the lumen's wall.
pub(super) type Twist = [f64; 6];

/// Rotation in degrees for each millimetre of shift: electromagnetic trackers have noise of 0.3 to 1.4 mm and 0.3° to 1°.
/// The data determine rotations too weakly, and in a straight vessel not at all, for a variance of their own.
const DEGREES_PER_MM: f64 = 1.0;
/// Smallest variance of pose errors, in variances of the noise: its inverse must be finite.
const MIN_VARIANCE: f64 = 1e-12;
/// Number of stretches of the vessel whose scatter gives the standard errors of global parameters. All passes by a place
/// belong to one stretch: the wall follows their mean, so that what is left of their errors is alike in all of them.
pub(super) const STRETCHES: usize = 16;
/// Steps towards the likeliest variance of pose errors in one fit.
const ASCENT_STEPS: usize = 10;

/// Velocity of a pose: shift in mm/s and rotation in rad/s, in the world's axes.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Velocity {
    pub shift_mm: DVec3,
    pub turn_rad: DVec3,
}

/// The standard deviations of the model.
#[derive(Debug, Clone, Copy)]
pub(super) struct NoiseLevels {
    /// σ: standard deviation of an echo about the wall when the poses are right, mm.
    pub noise_mm: f64,
    /// Standard deviation of a pose's shift along each axis, mm.
    pub shift_mm: f64,
}

/// The equation of an echo. The recording's N global parameters act on all echoes.
struct EchoEquation<const N: usize> {
    corners: Corners,
    /// Square root of the inverse variance, in units of the noise.
    scale: f64,
    /// Its square times the robust weight; 0 beyond the gate.
    weight: f64,
    /// y: the radius at the recorded pose, mm.
    radius_mm: f64,
    /// j: derivative of the radius by the pose's error.
    jacobian: Twist,
    /// g: derivatives of the radius by the global parameters, mm per unit.
    effects_mm: [f64; N],
}

/// The model about a wall.
pub(super) struct Joint<'a, const N: usize> {
    grid: &'a WallGrid,
    /// Frame by frame.
    equations: Vec<EchoEquation<N>>,
    /// First equation of each frame, and the end.
    starts: Vec<usize>,
    /// Per frame: `Σ w j jᵀ`.
    information: Vec<Matrix<6>>,
    /// Variances of an error's components for a shift of variance one.
    shape: Twist,
}

/// The local smoothness of the wall. It is estimated in the first fits, then frozen; otherwise it would keep decreasing.
#[derive(Default)]
pub(super) struct BendingPrior {
    local: LocalSmoothness,
    is_frozen: bool,
}

impl BendingPrior {
    /// The same, frozen, with λ times a factor on all `rings`.
    pub(super) fn weakened(&self, rings: usize, factor: f64) -> Self {
        let factors = (0..rings).map(|k| factor * self.local.factor(k)).collect();
        Self { local: LocalSmoothness::of(factors), is_frozen: true }
    }
}

/// The fit of a model.
pub(super) struct Fit {
    /// c: per frame.
    pub errors: Vec<Twist>,
    pub levels: NoiseLevels,
    pub solver_steps: usize,
}

/// The normal equations of the global parameters, with radii and pose errors eliminated.
pub(super) struct GlobalEquations<const N: usize> {
    /// `GᵀPG`: the information times the variance of the noise.
    pub information: Matrix<N>,
    /// `-GᵀPy'`, in parts: the stretches of the vessel.
    pub scores: [[f64; N]; STRETCHES],
}

/// An offset in time, s.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    pub seconds: f64,
    pub standard_error_s: f64,
}

impl<'a, const N: usize> Joint<'a, N> {
    /// The model about `wall`, for echoes with their projections on it. `sensors` are the poses that the echoes were placed
    /// with, `errors` the corrections that were subtracted from the recorded ones; `displacements` says how far the global
    /// parameters move an echo, mm per unit: of its frame, a point of the world.
    pub(super) fn about(
        grid: &'a WallGrid,
        axis: &Axis,
        echoes: &[Echo],
        wall: &Wall,
        sensors: &[Pose],
        errors: &[Twist],
        displacements: impl Fn(usize, DVec3) -> [DVec3; N] + Sync,
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
        let equations: Vec<EchoEquation<N>> = order
            .par_iter()
            .map(|&i| {
                let mut echo = echoes[i];
                let frame = echo.frame as usize;
                let (ring, node) = echo.projection();
                let measured = wall.residual_model(grid).measure(&mut echo, false);
                let (point, directions) = axis.at(echo.ring, echo.theta_rad(grid.nodes), echo.radius_mm);
                let arm = point - sensors[frame].translation_mm;
                let normal = directions * measured.normal;
                let effects_mm = displacements(frame, point).map(|moved| normal.dot(moved));
                // A shift along the vessel hardly changes the radii; where it does, at a narrow place, frames would slide to
                // where the wall is smoothest.
                let shift = normal - directions.z_axis * normal.dot(directions.z_axis);
                let turn = (arm / radius_mm).cross(shift);
                let jacobian = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
                let residual = echo.residual_mm.abs();
                let counts = residual <= gate(wall.noise_mm, measured.wall_mm);
                EchoEquation {
                    corners: grid.corners(ring, node),
                    scale: measured.weight.sqrt(),
                    weight: if counts {
                        huber_weight(wall.noise_mm, residual) * measured.weight * f64::from(echo.weight)
                    } else {
                        0.0
                    },
                    radius_mm: measured.wall_mm + measured.radial_mm + dot(&jacobian, &errors[frame]),
                    jacobian,
                    effects_mm,
                }
            })
            .collect();
        let information = starts
            .par_windows(2)
            .map(|range| {
                let mut sum = Matrix::default();
                for equation in &equations[range[0]..range[1]] {
                    let EchoEquation { weight, jacobian, .. } = equation;
                    for (line, j) in sum.iter_mut().zip(jacobian) {
                        line.iter_mut().zip(jacobian).for_each(|(s, other)| *s += weight * j * other);
                    }
                }
                sum
            })
            .collect();
        let turn = (DEGREES_PER_MM.to_radians() * radius_mm).powi(2);
        Self { grid, equations, starts, information, shape: [1.0, 1.0, 1.0, turn, turn, turn] }
    }

    /// Replaces the effects of the global parameters by others: of a frame, on the radius at a place of the wall.
    pub(super) fn with_effects_mm(mut self, of: impl Fn(usize, &Corners) -> [f64; N]) -> Self {
        for (k, range) in self.starts.windows(2).enumerate() {
            for equation in &mut self.equations[range[0]..range[1]] {
                equation.effects_mm = of(k, &equation.corners);
            }
        }
        self
    }

    /// Fits radii and errors and estimates the noise levels from them, `times` times in turn; λ = (σ/τ)² follows.
    pub(super) fn fit(
        &self,
        levels: NoiseLevels,
        times: usize,
        roughness: f64,
        prior: &mut BendingPrior,
        radii_mm: &mut [f64],
    ) -> Result<Fit> {
        let values: Vec<f64> = self.equations.iter().map(|equation| equation.radius_mm).collect();
        let mut fit = Fit { errors: Vec::new(), levels, solver_steps: 0 };
        for _ in 0..times {
            let noise_mm = fit.levels.noise_mm;
            let errors = self.errors_at(fit.levels)?;
            if !prior.is_frozen {
                prior.local = LocalSmoothness::from_bending(self.grid, radii_mm, roughness);
            }
            fit.solver_steps +=
                self.solve(&errors, fit.levels, roughness, &prior.local, &values, radii_mm)?;
            let sums = self.sums(|i| values[i] - self.equations[i].corners.value(radii_mm));
            fit.errors = errors.of(&sums);
            fit.levels.noise_mm = self.noise_mm(&values, &fit.errors, &errors, radii_mm).max(1e-9 * noise_mm);
            fit.levels.shift_mm = self.shift_level_mm(&sums, fit.levels)?;
        }
        prior.is_frozen = true;
        Ok(fit)
    }

    /// The equations of a Gauss-Newton step of the global parameters, with free radii and errors.
    pub(super) fn global_equations(
        &self,
        levels: NoiseLevels,
        roughness: f64,
        prior: &BendingPrior,
        radii_mm: &[f64],
    ) -> Result<GlobalEquations<N>> {
        let errors = self.errors_at(levels)?;
        // The part of each parameter's effects that radii and errors explain.
        let mut explained = Vec::with_capacity(N);
        for parameter in 0..N {
            let effects: Vec<f64> = self.equations.iter().map(|e| e.effects_mm[parameter]).collect();
            let mut of_wall = vec![0.0; radii_mm.len()];
            self.solve(&errors, levels, roughness, &prior.local, &effects, &mut of_wall)?;
            let of_poses = errors.of(&self.sums(|i| effects[i] - self.equations[i].corners.value(&of_wall)));
            explained.push((of_wall, of_poses));
        }
        let mut information = [[0.0; N]; N];
        let mut scores = [[0.0; N]; STRETCHES];
        for (k, range) in self.starts.windows(2).enumerate() {
            for equation in &self.equations[range[0]..range[1]] {
                let EchoEquation { corners, weight, radius_mm, jacobian, effects_mm, .. } = equation;
                // With the errors of the poses: what they explain is taken out of the effects. Taken out of the residual as
                // well, it would count twice, and steps would be too short wherever a prior holds errors back.
                let residual = radius_mm - corners.value(radii_mm);
                let ring = corners.nodes[0] / self.grid.nodes;
                let score = &mut scores[ring * STRETCHES / self.grid.rings];
                for (j, (of_wall, of_poses)) in explained.iter().enumerate() {
                    let unexplained = effects_mm[j] - corners.value(of_wall) - dot(jacobian, &of_poses[k]);
                    for (line, effect_mm) in information.iter_mut().zip(effects_mm) {
                        line[j] += weight * effect_mm * unexplained;
                    }
                    score[j] -= weight * unexplained * residual;
                }
            }
        }
        Ok(GlobalEquations { information, scores })
    }

    /// `Σ w j value` of each frame.
    fn sums(&self, value: impl Fn(usize) -> f64 + Sync) -> Vec<Twist> {
        self.starts
            .par_windows(2)
            .map(|range| {
                let mut sum = Twist::default();
                for i in range[0]..range[1] {
                    let equation = &self.equations[i];
                    let weighted = equation.weight * value(i);
                    sum.iter_mut().zip(equation.jacobian).for_each(|(s, j)| *s += weighted * j);
                }
                sum
            })
            .collect()
    }

    /// `σ²S⁻¹`: the prior's part of a frame's information.
    fn prior(&self, levels: NoiseLevels) -> Twist {
        let noise = levels.noise_mm * levels.noise_mm;
        let variance = (levels.shift_mm * levels.shift_mm).max(MIN_VARIANCE * noise);
        self.shape.map(|shape| noise / (variance * shape))
    }

    fn errors_at(&self, levels: NoiseLevels) -> Result<PoseErrors> {
        PoseErrors::new(&self.information, &self.prior(levels))
    }

    /// The likeliest radii for these values of the echoes, with free errors; returns the solver's steps.
    fn solve(
        &self,
        errors: &PoseErrors,
        levels: NoiseLevels,
        roughness: f64,
        local: &LocalSmoothness,
        values: &[f64],
        x: &mut [f64],
    ) -> Result<usize> {
        let explained = errors.of(&self.sums(|i| values[i]));
        let mut equations = Equations::over(self.grid, 0..self.grid.rings);
        for (k, range) in self.starts.windows(2).enumerate() {
            for (equation, value) in self.equations[range[0]..range[1]].iter().zip(&values[range[0]..]) {
                let EchoEquation { corners, weight, jacobian, .. } = equation;
                equations.add(corners, *weight, value - dot(jacobian, &explained[k]));
            }
        }
        let coupling = |x: &[f64], out: &mut [f64]| {
            let explained = errors.of(&self.sums(|i| self.equations[i].corners.value(x)));
            for (k, range) in self.starts.windows(2).enumerate() {
                for EchoEquation { corners, weight, jacobian, .. } in &self.equations[range[0]..range[1]] {
                    let weighted = weight * dot(jacobian, &explained[k]);
                    for (node, share) in corners.nodes.iter().zip(corners.weights) {
                        out[*node] -= weighted * share;
                    }
                }
            }
        };
        let noise_mm = self.grid.smoothed_noise_mm(levels.noise_mm, roughness);
        let system = System {
            equations: &equations,
            smoothness_mm2: (noise_mm / roughness).powi(2),
            local,
            coupling: &coupling,
        };
        let tolerance = (1e-3 * levels.noise_mm / self.grid.radius_mm()).max(1e-10);
        Ok(solve(self.grid, &system, tolerance, MAX_STEPS, x)?.steps)
    }

    /// σ, from the median of the residuals, corrected for the degrees of freedom of the errors.
    fn noise_mm(&self, values: &[f64], errors: &[Twist], factored: &PoseErrors, radii_mm: &[f64]) -> f64 {
        let mut residuals: Vec<f64> = Vec::with_capacity(values.len());
        for (k, range) in self.starts.windows(2).enumerate() {
            for (equation, value) in self.equations[range[0]..range[1]].iter().zip(&values[range[0]..]) {
                if equation.weight > 0.0 {
                    let EchoEquation { corners, scale, jacobian, .. } = equation;
                    let residual = value - corners.value(radii_mm) - dot(jacobian, &errors[k]);
                    residuals.push((residual * scale).abs());
                }
            }
        }
        let freedom: f64 = factored.factors.iter().zip(&self.information).map(|(l, h)| trace(l, h)).sum();
        let count = residuals.len() as f64;
        robust_sd(&mut residuals) * (count / (count - freedom).max(0.1 * count)).sqrt()
    }

    /// The standard deviation of a shift that maximises the marginal likelihood of the residuals, given the radii. With `v`
    /// its square and P the precision of a frame's residuals projected on its error, every step `v ← v √(Σ |Pg|²/Σ tr P)`
    /// increases the likelihood.
    fn shift_level_mm(&self, sums: &[Twist], mut levels: NoiseLevels) -> Result<f64> {
        let noise = levels.noise_mm * levels.noise_mm;
        for _ in 0..ASCENT_STEPS {
            let prior = self.prior(levels);
            let errors = self.errors_at(levels)?;
            let terms: Vec<[f64; 2]> = errors
                .factors
                .par_iter()
                .zip(sums)
                .map(|(factor, sum)| {
                    let error = cholesky::solve(factor, *sum);
                    let inverse: Twist = std::array::from_fn(|i| inverse_column(factor, i)[i]);
                    let mut terms = [0.0; 2];
                    for i in 0..6 {
                        // In units of the noise: S⁻¹c, and the diagonal of S⁻¹ - S⁻¹K⁻¹S⁻¹.
                        terms[0] += self.shape[i] * (prior[i] * error[i]).powi(2);
                        terms[1] += self.shape[i] * noise * (prior[i] - prior[i] * prior[i] * inverse[i]);
                    }
                    terms
                })
                .collect();
            let [found, expected] = terms.iter().fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
            if expected.is_nan() || expected <= 0.0 {
                break;
            }
            levels.shift_mm *= (found / expected).powf(0.25);
            levels.shift_mm = levels.shift_mm.max(levels.noise_mm * MIN_VARIANCE.sqrt());
        }
        Ok(levels.shift_mm)
    }
}

impl Joint<'_, 1> {
    /// A Gauss-Newton step to the likeliest offset in time, where that is the global parameter.
    pub(super) fn offset(
        &self,
        levels: NoiseLevels,
        roughness: f64,
        prior: &BendingPrior,
        radii_mm: &[f64],
    ) -> Result<Offset> {
        let GlobalEquations { information: [[information]], scores } =
            self.global_equations(levels, roughness, prior, radii_mm)?;
        let seconds = scores.as_flattened().iter().sum::<f64>() / information;
        // Model errors are alike in neighbouring frames, so the scatter of whole stretches counts as well.
        let scatter = scores.as_flattened().iter().map(|s| s * s).sum::<f64>() / (information * information);
        let of_noise = levels.noise_mm.powi(2) / information;
        Ok(Offset { seconds, standard_error_s: scatter.max(of_noise).sqrt() })
    }
}

/// The pose errors' part of the equations: one 6 × 6 system per frame, as Cholesky factors.
struct PoseErrors {
    factors: Vec<Matrix<6>>,
}

impl PoseErrors {
    /// For the frames' information matrices `Σ w j jᵀ` and the diagonal of the prior's.
    ///
    /// # Errors
    /// Where a frame's matrix is not positive definite.
    fn new(information: &[Matrix<6>], prior: &Twist) -> Result<Self> {
        let with_prior = |information: &Matrix<6>| {
            let mut matrix = *information;
            (0..6).for_each(|i| matrix[i][i] += prior[i]);
            matrix
        };
        let factors: Vec<_> = information.par_iter().map(|h| cholesky(&with_prior(h))).collect();
        let checked = factors.into_iter().enumerate().map(|(frame, factor)| {
            factor.ok_or_else(|| {
                let matrix = with_prior(&information[frame]);
                let diagonal: Twist = std::array::from_fn(|i| matrix[i][i]);
                Error::Frame {
                    frame,
                    field: "information about the pose's error",
                    found: format!("a matrix that is not positive definite, with the diagonal {diagonal:?}"),
                    expected: "a positive definite matrix: finite echoes and a finite noise above 0".into(),
                }
            })
        });
        Ok(Self { factors: checked.collect::<Result<_>>()? })
    }

    /// The likeliest errors for these [sums](Joint::sums) of residuals.
    fn of(&self, sums: &[Twist]) -> Vec<Twist> {
        self.factors.iter().zip(sums).map(|(factor, sum)| cholesky::solve(factor, *sum)).collect()
    }
}

/// Trace of `(L Lᵀ)⁻¹` times a symmetric matrix.
fn trace(factor: &Matrix<6>, matrix: &Matrix<6>) -> f64 {
    (0..6).map(|i| dot(&inverse_column(factor, i), &matrix[i])).sum()
}

/// A pose without its error.
pub(super) fn corrected(pose: &Pose, error: &Twist, radius_mm: f64) -> Pose {
    let (shift, turn) = split(error, radius_mm);
    Pose {
        rotation: DMat3::from_quat(glam::DQuat::from_scaled_axis(-turn)) * pose.rotation,
        translation_mm: pose.translation_mm - shift,
    }
}

/// Shift in mm and rotation in rad.
pub(super) fn split(error: &Twist, radius_mm: f64) -> (DVec3, DVec3) {
    let [a, b, c, d, e, f] = *error;
    (DVec3::new(a, b, c), DVec3::new(d, e, f) / radius_mm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factored_system_is_solved() {
        let column = |i: usize| std::array::from_fn(|j| 1.0 / (1.0 + (i + j) as f64));
        let mut matrix: Matrix<6> = std::array::from_fn(column);
        (0..6).for_each(|i| matrix[i][i] += 0.1);
        let factored = PoseErrors::new(&[matrix], &[0.0; 6]).unwrap();
        let x = [1.0, -2.0, 3.0, 0.5, 0.0, 7.0];
        let found = factored.of(&[matrix.map(|line| dot(&line, &x))])[0];
        assert!(found.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-10), "{found:?}");
        assert!((trace(&factored.factors[0], &matrix) - 6.0).abs() < 1e-10);
    }

    #[test]
    fn an_indefinite_information_matrix_is_refused() {
        let mut definite = Matrix::<6>::default();
        (0..6).for_each(|i| definite[i][i] = 1.0);
        let mut indefinite = definite;
        // Of determinant 1·1 - 2·2.
        (indefinite[1][0], indefinite[0][1]) = (2.0, 2.0);
        let mut no_number = definite;
        no_number[3][3] = f64::NAN;
        assert!(PoseErrors::new(&[definite, definite], &[0.0; 6]).is_ok());
        for bad in [indefinite, no_number] {
            let refused = PoseErrors::new(&[definite, bad, definite], &[0.0; 6]).err().unwrap().to_string();
            assert!(refused.starts_with("frame 1: information about the pose's error: found"), "{refused}");
            assert!(refused.contains("not positive definite") && refused.contains("expected"), "{refused}");
        }
        // A prior makes it definite.
        assert!(PoseErrors::new(&[indefinite], &[2.0; 6]).is_ok());
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
