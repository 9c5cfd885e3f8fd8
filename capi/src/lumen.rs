//! From a recording to a lumen.

use crate::handles::Handles;
use crate::memory::{check_place, copy_text, put};
use crate::mesh::{LumenmeshMesh, MESHES};
use crate::recording::{LumenmeshRecording, RECORDINGS};
use crate::settings::{LumenmeshSettings, settings_of};
use crate::status::{Failure, LumenmeshStatus, border};
use lumenmesh_core::reconstruction::{Lumen, Reconstructor};
use std::ffi::c_char;

/// A reconstructed lumen: its mesh, and what was done.
pub struct LumenmeshLumen {
    _private: [u8; 0],
}

static LUMENS: Handles<Lumen> = Handles::new("lumen");

/// Reconstructs the lumen of a recording. `settings` may be null: then all are the defaults.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_reconstruct(
    recording: *const LumenmeshRecording,
    settings: *const LumenmeshSettings,
    lumen: *mut *mut LumenmeshLumen,
) -> LumenmeshStatus {
    border(|| {
        check_place("lumen", lumen)?;
        let recording = RECORDINGS.get(recording)?;
        let made = Reconstructor::new(settings_of(settings)?).run(&recording)?;
        unsafe { put("lumen", lumen, LUMENS.give(made)) }
    })
}

/// The mesh of a lumen, with its node arrays.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_lumen_mesh(
    lumen: *const LumenmeshLumen,
    mesh: *mut *mut LumenmeshMesh,
) -> LumenmeshStatus {
    border(|| {
        check_place("mesh", mesh)?;
        let surface = LUMENS.get(lumen)?.surface();
        unsafe { put("mesh", mesh, MESHES.give(surface)) }
    })
}

/// What was done, as JSON: `settings`, `screening` (frames that were left out, and why; suspicions), and the method's
/// numbers, as `lumenmesh reconstruct --json` prints them. `length` receives the size of the text with its zero; `buffer`
/// may be null to ask for that alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_lumen_report(
    lumen: *const LumenmeshLumen,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        let lumen = LUMENS.get(lumen)?;
        let report = serde_json::to_string_pretty(&lumen.summary())
            .map_err(|e| Failure::argument(format!("report: {e}")))?;
        unsafe { copy_text("report", &report, buffer, capacity, length) }
    })
}

/// Frees a lumen; null is left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_lumen_free(lumen: *mut LumenmeshLumen) -> LumenmeshStatus {
    border(|| LUMENS.free(lumen))
}
