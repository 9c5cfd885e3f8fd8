//! Triangle meshes with arrays over their nodes.

use crate::handles::Handles;
use crate::memory::{array, check_place, copy, copy_text, put, text};
use crate::status::{Failure, LumenmeshStatus, border};
use lumenmesh_core::glam::DVec3;
use lumenmesh_core::surface::{Space, Surface};
use std::ffi::c_char;
use std::path::Path;

/// A triangle mesh with arrays over its nodes.
pub struct LumenmeshMesh {
    _private: [u8; 0],
}

pub static MESHES: Handles<Surface> = Handles::new("mesh");

/// A mesh from arrays: x, y, z of each vertex in mm, and three vertices of each triangle, counted from 0 and
/// counter-clockwise seen from outside the lumen.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_new(
    vertices: usize,
    vertices_mm: *const f64,
    triangles: usize,
    indices: *const u32,
    mesh: *mut *mut LumenmeshMesh,
) -> LumenmeshStatus {
    border(|| {
        check_place("mesh", mesh)?;
        let count = |n: usize| {
            n.checked_mul(3)
                .ok_or_else(|| Failure::argument(format!("sizes: found {n}, which no memory holds")))
        };
        let vertices_mm = unsafe { array("vertices_mm", vertices_mm, count(vertices)?)? };
        let indices = unsafe { array("indices", indices, count(triangles)?)? };
        let made = Surface {
            nodes_mm: vertices_mm.as_chunks::<3>().0.iter().copied().map(DVec3::from_array).collect(),
            triangles: indices.as_chunks::<3>().0.to_vec(),
            arrays: Vec::new(),
        };
        made.check()?;
        unsafe { put("mesh", mesh, MESHES.give(made)) }
    })
}

/// Reads a mesh: .vtp, .ply, .stl, .obj, .mat, .vtk or .vtu.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_read(
    path: *const c_char,
    mesh: *mut *mut LumenmeshMesh,
) -> LumenmeshStatus {
    border(|| {
        check_place("mesh", mesh)?;
        let surface = Surface::read(Path::new(unsafe { text("path", path)? }))?;
        unsafe { put("mesh", mesh, MESHES.give(surface)) }
    })
}

/// Writes a mesh: .vtp, .ply, .stl, .obj or .mat. `space` is "ras" or null for the axes of the tracker, "lps" for x and y
/// negated; the file says which.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_write(
    mesh: *const LumenmeshMesh,
    path: *const c_char,
    space: *const c_char,
) -> LumenmeshStatus {
    border(|| {
        let mesh = MESHES.get(mesh)?;
        let path = Path::new(unsafe { text("path", path)? });
        let space = match space.is_null() {
            true => Space::default(),
            false => unsafe { text("space", space)? }.parse()?,
        };
        mesh.write_in(path, space)?;
        Ok(())
    })
}

/// How many vertices, triangles and arrays a mesh has. Each place may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_sizes(
    mesh: *const LumenmeshMesh,
    vertices: *mut usize,
    triangles: *mut usize,
    arrays: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        let mesh = MESHES.get(mesh)?;
        let sizes = [mesh.nodes_mm.len(), mesh.triangles.len(), mesh.arrays.len()];
        for (to, size) in [vertices, triangles, arrays].into_iter().zip(sizes) {
            if !to.is_null() {
                unsafe { put("sizes", to, size)? };
            }
        }
        Ok(())
    })
}

/// Copies x, y, z of all vertices, in mm; `capacity` counts numbers: three for each vertex.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_copy_vertices(
    mesh: *const LumenmeshMesh,
    buffer: *mut f64,
    capacity: usize,
) -> LumenmeshStatus {
    border(|| {
        let mesh = MESHES.get(mesh)?;
        let numbers: Vec<f64> = mesh.nodes_mm.iter().flat_map(|p| p.to_array()).collect();
        unsafe { copy("vertices", &numbers, buffer, capacity) }
    })
}

/// Copies the vertices of all triangles, counted from 0; `capacity` counts numbers: three for each triangle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_copy_triangles(
    mesh: *const LumenmeshMesh,
    buffer: *mut u32,
    capacity: usize,
) -> LumenmeshStatus {
    border(|| {
        let mesh = MESHES.get(mesh)?;
        unsafe { copy("triangles", mesh.triangles.as_flattened(), buffer, capacity) }
    })
}

/// The name of an array, by its number from 0. `length` receives the size of the text with its zero; `buffer` may be null to
/// ask for that alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_array_name(
    mesh: *const LumenmeshMesh,
    number: usize,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        let mesh = MESHES.get(mesh)?;
        let array = mesh.arrays.get(number).ok_or_else(|| {
            Failure::argument(format!("array {number}: expected a number below {}", mesh.arrays.len()))
        })?;
        unsafe { copy_text("array name", &array.name, buffer, capacity, length) }
    })
}

/// Copies an array by its name, such as "support" or "standard_error_mm": one number for each vertex.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_copy_array(
    mesh: *const LumenmeshMesh,
    name: *const c_char,
    buffer: *mut f64,
    capacity: usize,
) -> LumenmeshStatus {
    border(|| {
        let mesh = MESHES.get(mesh)?;
        let name = unsafe { text("name", name)? };
        let values = mesh.array(name).ok_or_else(|| {
            let names: Vec<&str> = mesh.arrays.iter().map(|array| array.name.as_str()).collect();
            Failure::argument(format!("array {name:?}: expected one of {}", names.join(", ")))
        })?;
        unsafe { copy(name, values, buffer, capacity) }
    })
}

/// Frees a mesh; null is left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_mesh_free(mesh: *mut LumenmeshMesh) -> LumenmeshStatus {
    border(|| MESHES.free(mesh))
}
