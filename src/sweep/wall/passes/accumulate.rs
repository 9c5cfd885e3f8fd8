//! The sums over echoes (`shaders/sweep/accumulate.wgsl`). In f64 these are `Equations` of the CPU.

use super::{DeviceEcho, WallParameters, residual_to_wall};
use crate::numerics::Scalar;

/// Fixed-point sums per node: the coefficients of the node itself, of the next node of its ring, of the node
/// above and of the next node above; and the right-hand side.
pub type Sums = [i64; 5];

/// Adds an echo to the normal equations.
pub fn accumulate(
    parameters: &WallParameters,
    echo: &DeviceEcho,
    wall: &[f32],
    shift: [f32; 2],
    sums: &mut [Sums],
) {
    let to_wall = residual_to_wall(parameters, echo, wall, shift);
    let residual = to_wall.residual.abs();
    let gate = parameters.gate.max(parameters.gate_radii * (parameters.start + to_wall.wall));
    if parameters.gated != 0 && residual > gate {
        return;
    }
    let robust = if residual > parameters.huber { parameters.huber / residual } else { 1.0 };
    let weight = robust * (to_wall.normal_x * to_wall.normal_x / to_wall.variance);
    // In units of the noise.
    let value = weight * (to_wall.normal_distance / to_wall.normal_x) * parameters.per_noise;
    let [p, q, r] = to_wall.weights;
    let [a, m, c] = to_wall.corners;
    // The edge a-b lies along the ring, a-a' and b-b' across, a'-b' along the next ring, and the diagonal
    // a-b' in both triangles.
    let (from_a, to_c) = if to_wall.bottom { (1, 2) } else { (2, 1) };
    let mut add = |node: usize, part: usize, x: f32, scale: f32| sums[node][part] += x.to_fixed(scale);
    add(a, 0, weight * p * p, parameters.weight_scale);
    add(m, 0, weight * q * q, parameters.weight_scale);
    add(c, 0, weight * r * r, parameters.weight_scale);
    add(a, from_a, weight * p * q, parameters.weight_scale);
    add(m, to_c, weight * q * r, parameters.weight_scale);
    add(a, 3, weight * p * r, parameters.weight_scale);
    add(a, 4, p * value, parameters.rhs_scale);
    add(m, 4, q * value, parameters.rhs_scale);
    add(c, 4, r * value, parameters.rhs_scale);
}
