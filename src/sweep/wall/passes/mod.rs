//! The passes of the wall's fit as plain functions in f32: twins of the shaders in `shaders/sweep/`,
//! statement by statement. Each file has the name of its shader.
//!
//! The CPU fits in f64 with structures of its own. These functions define what a device has to compute, to
//! the bit where it rounds in the same way. Lengths are mm. The wall's radii are measured from `start` of the
//! parameters, so that f32 keeps their digits, and the solver works in units of the noise.

mod accumulate;
mod apply;
mod ascend;
mod assemble;
mod assemble_rhs;
mod bending;
mod cg_limit;
mod cg_step;
mod coarse_cycle;
mod coarsen;
mod count_residuals;
mod coupled;
mod descend;
mod diagonal;
mod interpolated;
mod lump;
mod matrix;
mod measure;
mod move_wall;
mod parameters;
mod partials;
mod pick_digit;
mod restricted;
mod stencil;
mod stencil_at;
mod sum;
mod tile;
mod transfer;
mod wall_residual;

pub use accumulate::{Sums, accumulate};
pub use apply::{Applied, apply};
pub use ascend::ascend;
pub use assemble::assemble;
pub use assemble_rhs::assemble_rhs;
pub use bending::bending;
pub use cg_limit::cg_limit;
pub use cg_step::cg_step;
#[cfg(feature = "gpu")]
pub(in crate::sweep::wall) use coarse_cycle::FLOOR;
pub use coarse_cycle::{MOST_OF_ONE, coarse_cycle};
pub use coarsen::coarsen;
pub use count_residuals::count_residuals;
pub use descend::descend;
pub use lump::lump;
pub use matrix::Matrix;
pub use measure::measure;
pub use move_wall::move_wall;
pub use parameters::{
    BROKEN, CONVERGED, DeviceEcho, EXHAUSTED, Level, MOST_COARSEST, NextStep, State, WallParameters,
};
pub use partials::sum_of_partials;
pub use pick_digit::pick_digit;
pub use sum::sum_of_workgroup;
pub use tile::{
    APPLY_COLUMNS, ASCEND_COLUMNS, DESCEND_COLUMNS, LOW_TILE_RINGS, MANY_NODES, TILE_COLUMNS, TILE_RINGS,
    tile_count,
};
pub use wall_residual::{MAX_CELLS, WallResidual, residual_to_wall};
