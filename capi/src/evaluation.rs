//! How far a mesh is from the truth.

use crate::memory::{check_place, copy_json, put};
use crate::mesh::{LumenmeshMesh, MESHES};
use crate::status::{LumenmeshStatus, border};
use lumenmesh_core::evaluate::{Truth, evaluate};
use std::ffi::c_char;

/// Measures the distance between a mesh and a truth. `mean_mm` receives the fitting error, the mean distance from the mesh's
/// vertices to the truth's triangles; `buffer` all numbers as JSON, as `lumenmesh evaluate --json` prints them, and `length`
/// the size of that text with its zero. `buffer` and `length` may both be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_evaluate(
    mesh: *const LumenmeshMesh,
    truth: *const LumenmeshMesh,
    mean_mm: *mut f64,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        check_place("mean_mm", mean_mm)?;
        let (mesh, truth) = (MESHES.get(mesh)?, MESHES.get(truth)?);
        let truth = Truth::new((*truth).clone())?;
        let evaluation = evaluate(&mesh, &truth)?;
        if !(buffer.is_null() && length.is_null()) {
            let json = serde_json::to_string_pretty(&evaluation);
            unsafe { copy_json("evaluation", json, buffer, capacity, length)? };
        }
        unsafe { put("mean_mm", mean_mm, evaluation.mesh_to_truth.mean_mm) }
    })
}
