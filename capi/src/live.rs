//! A vessel that grows frame by frame.

use crate::handles::Handles;
use crate::lumen::{LUMENS, LumenmeshLumen};
use crate::memory::{array, check_place, copy, copy_json, put, text};
use crate::mesh::{LumenmeshMesh, MESHES};
use crate::recording::{contour, matrix};
use crate::settings::{LumenmeshSettings, settings_of};
use crate::status::{Failure, LumenmeshStatus, border};
use lumenmesh_core::reconstruction::{Change, Live};
use lumenmesh_core::recording::Frame;
use std::ffi::c_char;
use std::sync::{Arc, Mutex, MutexGuard};

/// A vessel that grows frame by frame.
pub struct LumenmeshLive {
    _private: [u8; 0],
}

/// The vessel, and what the last frame changed.
struct State {
    live: Live,
    change: Change,
}

static LIVES: Handles<Mutex<State>> = Handles::new("live");

/// What a frame changed. Rings are numbered along the vessel; ring k has the nodes from k times `nodes` on.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct LumenmeshChange {
    /// The frame's number: how many were taken before it.
    pub frame: usize,
    /// New rings in front of all others: what was ring k is ring k + `before` now.
    pub before: usize,
    /// Rings of the vessel now.
    pub rings: usize,
    /// Nodes of each ring; 0 as long as there is none.
    pub nodes: usize,
    /// Ranges of rings that changed or are new: `lumenmesh_live_changed` copies them.
    pub changed: usize,
    /// Frames that were found unfit now: `lumenmesh_live_left_out` says why.
    pub left_out: usize,
    /// Frames that wait: they jump off the path of the others, and later ones decide; or the vessel began anew, and it is not
    /// their turn yet.
    pub waiting: usize,
    /// 1 where the frame lies outside of the vessel's lumen: its echoes wait.
    pub off_axis: i32,
    /// 1 where the vessel began anew, because what was shown before came from frames that are left out now, or from points that
    /// are no wall. Frames follow from the first on, some with each call.
    pub restarted: i32,
    /// How long the frame took, s of wall-clock time: judging whether it is fit for use;
    pub screening_s: f64,
    /// drawing the axis of a swept vessel anew, and placing older echoes about it;
    pub axis_s: f64,
    /// placing the frame and its echoes;
    pub placing_s: f64,
    /// solving for the wall, or fitting a cylinder;
    pub solving_s: f64,
    /// all of it.
    pub total_s: f64,
}

impl State {
    fn summary(&self) -> LumenmeshChange {
        let change = &self.change;
        LumenmeshChange {
            frame: change.frame,
            before: change.before,
            rings: change.rings,
            nodes: self.live.nodes(),
            changed: change.changed.len(),
            left_out: change.left_out.len(),
            waiting: change.waiting,
            off_axis: i32::from(change.off_axis),
            restarted: i32::from(change.restarted),
            screening_s: change.times.screening_s,
            axis_s: change.times.axis_s,
            placing_s: change.times.placing_s,
            solving_s: change.times.solving_s,
            total_s: change.times.total_s,
        }
    }
}

fn locked(state: &Arc<Mutex<State>>) -> Result<MutexGuard<'_, State>, Failure> {
    state
        .lock()
        .map_err(|_| Failure::argument("live: an earlier call failed within lumenmesh; begin a new one"))
}

/// Puts the change of a frame where the host wants it.
unsafe fn tell(state: &State, change: *mut LumenmeshChange) -> Result<(), Failure> {
    match change.is_null() {
        true => Ok(()),
        false => unsafe { put("change", change, state.summary()) },
    }
}

/// A vessel of no frames yet. `settings` may be null: then all are the defaults.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_new(
    settings: *const LumenmeshSettings,
    live: *mut *mut LumenmeshLive,
) -> LumenmeshStatus {
    border(|| {
        check_place("live", live)?;
        let state = State { live: Live::new(&settings_of(settings)?)?, change: Change::default() };
        unsafe { put("live", live, LIVES.give(Mutex::new(state))) }
    })
}

/// Keeps all frames from now on for `lumenmesh_live_finish`: 16 bytes for each contour point, and some 200 for each frame.
/// Otherwise memory grows with the vessel's length only. It is refused where frames have come already.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_keep_frames(live: *mut LumenmeshLive) -> LumenmeshStatus {
    border(|| {
        let state = LIVES.get(live)?;
        Ok(locked(&state)?.live.keep_frames()?)
    })
}

/// The lumen of all frames at once, as `lumenmesh_reconstruct` makes it of a recording of them. The frames must have been kept.
/// The live vessel stays as it is.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_finish(
    live: *const LumenmeshLive,
    lumen: *mut *mut LumenmeshLumen,
) -> LumenmeshStatus {
    border(|| {
        check_place("lumen", lumen)?;
        let state = LIVES.get(live)?;
        let made = locked(&state)?.live.finish()?;
        unsafe { put("lumen", lumen, LUMENS.give(made)) }
    })
}

/// Writes the whole state of a live vessel as a file, complete or not at all: `lumenmesh_live_restore` goes on from there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_snapshot(
    live: *const LumenmeshLive,
    path: *const c_char,
) -> LumenmeshStatus {
    border(|| {
        let path = unsafe { text("path", path)? };
        let state = LIVES.get(live)?;
        Ok(locked(&state)?.live.snapshot(path.as_ref())?)
    })
}

/// A live vessel as it was when the file was written, with its settings: what follows is the same to the last bit. The file
/// must be whole and of this version.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_restore(
    path: *const c_char,
    live: *mut *mut LumenmeshLive,
) -> LumenmeshStatus {
    border(|| {
        check_place("live", live)?;
        let path = unsafe { text("path", path)? };
        let state = State { live: Live::restore(path.as_ref())?, change: Change::default() };
        unsafe { put("live", live, LIVES.give(Mutex::new(state))) }
    })
}

/// Takes the next frame: the 4x4 matrix of the tracker's sensor in the world, row by row, with the translation in mm in the
/// last column; x and y of each contour point in the probe's plane, mm, NaN where a ray has no echo; and the time, NaN where
/// it is not known. `change` may be null. Where the frame is refused, the vessel is as before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_push(
    live: *mut LumenmeshLive,
    world_from_sensor: *const f64,
    points: usize,
    contour_mm: *const f64,
    time_s: f64,
    change: *mut LumenmeshChange,
) -> LumenmeshStatus {
    border(|| {
        let state = LIVES.get(live)?;
        let numbers = unsafe { array("world_from_sensor", world_from_sensor, 16)? };
        let numbers: &[f64; 16] = numbers.try_into().map_err(|_| Failure::argument("world_from_sensor"))?;
        let coordinates = points
            .checked_mul(2)
            .ok_or_else(|| Failure::argument(format!("points: found {points}, which no memory holds")))?;
        let contour_mm = contour(unsafe { array("contour_mm", contour_mm, coordinates)? });
        let frame = Frame::from_matrix(&matrix(numbers), contour_mm)?
            .with_time_s(Some(time_s).filter(|t| !t.is_nan()));
        let mut state = locked(&state)?;
        state.change = state.live.push(&frame)?;
        unsafe { tell(&state, change) }
    })
}

/// After the last frame: ends the waiting of frames that jump off the path of the others. They are left out.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_flush(
    live: *mut LumenmeshLive,
    change: *mut LumenmeshChange,
) -> LumenmeshStatus {
    border(|| {
        let state = LIVES.get(live)?;
        let mut state = locked(&state)?;
        state.change = state.live.flush()?;
        unsafe { tell(&state, change) }
    })
}

/// Forgets all frames: the next one begins a new vessel with the same settings.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_reset(live: *mut LumenmeshLive) -> LumenmeshStatus {
    border(|| {
        let state = LIVES.get(live)?;
        let mut state = locked(&state)?;
        state.live.reset();
        state.change = Change::default();
        Ok(())
    })
}

/// Copies the ranges of rings that the last frame changed: for each the first ring and the one after the last; `capacity`
/// counts numbers, two for each range.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_changed(
    live: *const LumenmeshLive,
    buffer: *mut usize,
    capacity: usize,
) -> LumenmeshStatus {
    border(|| {
        let state = LIVES.get(live)?;
        let ranges: Vec<usize> =
            locked(&state)?.change.changed.iter().flat_map(|range| [range.start, range.end]).collect();
        unsafe { copy("changed", &ranges, buffer, capacity) }
    })
}

/// The frames that were found unfit with the last one, and why, as a JSON array. `length` receives the size of the text with
/// its zero; `buffer` may be null to ask for that alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_left_out(
    live: *const LumenmeshLive,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        let state = LIVES.get(live)?;
        let state = locked(&state)?;
        unsafe {
            copy_json("left_out", serde_json::to_string(&state.change.left_out), buffer, capacity, length)
        }
    })
}

/// Where frames are computed, and why there, as a JSON object; "null" before the first cylinder. `length` receives the size of
/// the text with its zero; `buffer` may be null to ask for that alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_engine(
    live: *const LumenmeshLive,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        let state = LIVES.get(live)?;
        let state = locked(&state)?;
        unsafe { copy_json("engine", serde_json::to_string(&state.live.engine()), buffer, capacity, length) }
    })
}

/// The vessel so far; a mesh without vertices as long as it has not begun.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_surface(
    live: *const LumenmeshLive,
    mesh: *mut *mut LumenmeshMesh,
) -> LumenmeshStatus {
    border(|| {
        check_place("mesh", mesh)?;
        let state = LIVES.get(live)?;
        let surface = locked(&state)?.live.surface();
        unsafe { put("mesh", mesh, MESHES.give(surface)) }
    })
}

/// The rings from `first` up to, not with, `end`, all of their nodes in order and the triangles between them; also what no
/// echo supports, as the array "supported" says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_part(
    live: *const LumenmeshLive,
    first: usize,
    end: usize,
    mesh: *mut *mut LumenmeshMesh,
) -> LumenmeshStatus {
    border(|| {
        check_place("mesh", mesh)?;
        let state = LIVES.get(live)?;
        let part = locked(&state)?.live.part(first..end);
        unsafe { put("mesh", mesh, MESHES.give(part)) }
    })
}

/// Frees a live vessel; null is left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_live_free(live: *mut LumenmeshLive) -> LumenmeshStatus {
    border(|| LIVES.free(live))
}
