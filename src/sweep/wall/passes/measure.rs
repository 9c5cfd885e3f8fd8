//! The residuals and projections of echoes (`shaders/sweep/measure.wgsl`).

use super::{DeviceEcho, WallParameters, residual_to_wall};

/// The residual of an echo, and the shift of its projection: a new one where the parameters ask for it.
pub fn measure(
    parameters: &WallParameters,
    echo: &DeviceEcho,
    wall: &[f32],
    shift: [f32; 2],
) -> (f32, [f32; 2]) {
    let to_wall = residual_to_wall(parameters, echo, wall, shift);
    if parameters.project == 0 {
        return (to_wall.residual, shift);
    }
    let size = to_wall.residual.abs();
    let reach = if size > parameters.max_projection { parameters.max_projection / size } else { 1.0 };
    let distance = -(to_wall.normal_distance / to_wall.variance) * reach;
    (
        to_wall.residual,
        [to_wall.likeliest[2] * distance / echo.step, to_wall.likeliest[1] * distance / to_wall.arc],
    )
}
