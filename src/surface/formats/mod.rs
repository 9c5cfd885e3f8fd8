//! The files that hold surfaces, one module per format.
//!
//! VTP rests on `quick-xml`, `flate2` and `base64`. PLY, STL and OBJ are read here: what bad input may do is then ours to
//! bound, as no buffer is ever larger than the file gives cause for.

pub(super) mod obj;
pub(super) mod ply;
pub(super) mod stl;
pub(super) mod vtp;
