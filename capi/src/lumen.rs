//! From a recording to a lumen.

use crate::handles::Handles;
use crate::memory::{check_place, copy_json, put};
use crate::mesh::{LumenmeshMesh, MESHES};
use crate::recording::{LumenmeshRecording, RECORDINGS};
use crate::settings::{LumenmeshSettings, settings_of};
use crate::status::{LumenmeshStatus, border};
use lumenmesh_core::reconstruction::{Lumen, Progress, Reconstructor};
use std::ffi::{CString, c_char, c_void};
use std::ops::ControlFlow;

/// A reconstructed lumen: its mesh, and what was done.
pub struct LumenmeshLumen {
    _private: [u8; 0],
}

pub static LUMENS: Handles<Lumen> = Handles::new("lumen");

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

/// Called when a step is done: the stage, the steps of it that are done and their number, and the host's own pointer. It
/// returns 0 to go on, and anything else to end the reconstruction.
pub type LumenmeshProgress =
    Option<unsafe extern "C" fn(stage: *const c_char, done: usize, total: usize, data: *mut c_void) -> i32>;

/// What the host gets back with every call.
struct HostData(*mut c_void);

// SAFETY: it is handed on and never looked at; the header says that calls come from any thread.
unsafe impl Send for HostData {}
// SAFETY: as above.
unsafe impl Sync for HostData {}

impl HostData {
    fn get(&self) -> *mut c_void {
        self.0
    }
}

/// As `lumenmesh_reconstruct`, and calls `progress` whenever a step is done, with `data`: from any thread, and from several at
/// the same time. Once it has returned something other than 0, the reconstruction ends soon with
/// LUMENMESH_STATUS_CANCELLED. `progress` must not block, nor throw or jump out.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_reconstruct_with(
    recording: *const LumenmeshRecording,
    settings: *const LumenmeshSettings,
    progress: LumenmeshProgress,
    data: *mut c_void,
    lumen: *mut *mut LumenmeshLumen,
) -> LumenmeshStatus {
    border(|| {
        check_place("lumen", lumen)?;
        let recording = RECORDINGS.get(recording)?;
        let data = HostData(data);
        let tell = |Progress { stage, done, total, .. }: Progress| {
            let (Some(progress), Ok(stage)) = (progress, CString::new(stage)) else {
                return ControlFlow::Continue(());
            };
            match unsafe { progress(stage.as_ptr(), done, total, data.get()) } {
                0 => ControlFlow::Continue(()),
                _ => ControlFlow::Break(()),
            }
        };
        let made = Reconstructor::new(settings_of(settings)?).on_progress(tell).run(&recording)?;
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
        let report = serde_json::to_string_pretty(&lumen.summary());
        unsafe { copy_json("report", report, buffer, capacity, length) }
    })
}

/// Frees a lumen; null is left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_lumen_free(lumen: *mut LumenmeshLumen) -> LumenmeshStatus {
    border(|| LUMENS.free(lumen))
}
