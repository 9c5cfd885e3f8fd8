//! File formats of surfaces, one module per format.
//!
//! VTP uses `quick-xml`, `flate2` and `base64`. PLY, STL and OBJ are parsed here, which bounds the effects of bad input: no
//! buffer is larger than the size of the file justifies.

pub(super) mod obj;
pub(super) mod ply;
pub(super) mod stl;
pub(super) mod vtp;
