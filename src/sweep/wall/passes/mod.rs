//! The passes of the wall's fit as plain functions in f32: twins of the shaders in `shaders/sweep/`,
//! statement by statement. Each file has the name of its shader.
//!
//! The CPU fits in f64 with structures of its own. These functions define what a device has to compute, to
//! the bit where it rounds in the same way. Lengths are mm. The wall's radii are measured from `start` of the
//! parameters, so that f32 keeps their digits, and the solver works in units of the noise.

mod accumulate;
mod apply;
mod assemble;
mod assemble_rhs;
mod bending;
mod blocks;
mod cg_alpha;
mod cg_beta;
mod cg_direction;
mod cg_step;
mod count_residuals;
mod couple;
mod coupled;
mod eliminate;
mod hartley_first;
mod hartley_second;
mod hartley_second_spectrum;
mod hartley_second_values;
mod measure;
mod move_wall;
mod parameters;
mod partials;
mod pick_digit;
mod substitute;
mod sum;
mod wall_residual;
mod weigh_rings;

pub use accumulate::{Sums, accumulate};
pub use apply::apply;
pub use assemble::assemble;
pub use assemble_rhs::assemble_rhs;
pub use bending::bending;
pub use blocks::Factors;
pub use cg_alpha::cg_alpha;
pub use cg_beta::cg_beta;
pub use cg_direction::cg_direction;
pub use cg_step::cg_step;
pub use count_residuals::count_residuals;
pub use couple::couple;
pub use eliminate::eliminate;
pub use hartley_first::{hartley_first, twiddles};
pub use hartley_second_spectrum::hartley_second_spectrum;
pub use hartley_second_values::hartley_second_values;
pub use measure::measure;
pub use move_wall::move_wall;
pub use parameters::{BROKEN, CONVERGED, DeviceEcho, State, WallParameters};
pub use partials::sum_of_partials;
pub use pick_digit::pick_digit;
pub use substitute::substitute;
pub use sum::sum_of_workgroup;
pub use wall_residual::{MAX_CELLS, WallResidual, residual_to_wall};
pub use weigh_rings::weigh_rings;
