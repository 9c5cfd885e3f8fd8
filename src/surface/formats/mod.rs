//! File formats of surfaces, one module per format; what they share: numbers, text, and cells that become triangles.
//!
//! VTP uses `quick-xml`, `base64` and the crates of its compressors. The others are parsed here, which bounds the effects
//! of bad input: no buffer is larger than the size of the file justifies.

mod cells;
pub(super) mod mat;
#[cfg(feature = "mcap")]
pub(super) mod mcap;
mod number;
pub(super) mod obj;
pub(super) mod ply;
pub(super) mod stl;
mod text;
pub(super) mod vtk;
pub(super) mod vtp;
