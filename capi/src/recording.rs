//! Recordings from arrays and files.

use crate::handles::Handles;
use crate::memory::{array, check_place, put, text};
use crate::status::{Failure, LumenmeshStatus, border};
use lumenmesh_core::glam::DVec2;
use lumenmesh_core::recording::Recording;
use std::ffi::c_char;
use std::path::Path;

/// What the probe saw: for each frame the pose of the sensor and the contour of the wall.
pub struct LumenmeshRecording {
    _private: [u8; 0],
}

pub static RECORDINGS: Handles<Recording> = Handles::new("recording");

/// A recording from arrays.
///
/// `world_from_sensor` has 16 numbers for each frame: the 4x4 matrix of the tracker's sensor in the world, row by row, with
/// the translation in mm in the last column; a NaN in it marks a pose that the tracker did not measure. `points` has the
/// number of contour points of each frame, and `contours_mm` x and y of all of them, frame after frame, in the probe's
/// plane; NaN where a ray has no echo. `times_s` has the frames' times, or is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_recording_new(
    frames: usize,
    world_from_sensor: *const f64,
    points: *const usize,
    contours_mm: *const f64,
    times_s: *const f64,
    recording: *mut *mut LumenmeshRecording,
) -> LumenmeshStatus {
    border(|| {
        check_place("recording", recording)?;
        let too_many = || Failure::argument(format!("frames: found {frames}, which no memory holds"));
        let numbers = frames.checked_mul(16).ok_or_else(too_many)?;
        let matrices = unsafe { array("world_from_sensor", world_from_sensor, numbers)? };
        let matrices: Vec<[[f64; 4]; 4]> = matrices.as_chunks::<16>().0.iter().map(matrix).collect();
        let points = unsafe { array("points", points, frames)? };
        let all = points.iter().try_fold(0_usize, |sum, &count| sum.checked_add(count));
        let coordinates = all.and_then(|all| all.checked_mul(2)).ok_or_else(too_many)?;
        let contours_mm = contour(unsafe { array("contours_mm", contours_mm, coordinates)? });
        let mut rest = contours_mm.as_slice();
        let contours = points.iter().map(|&count| {
            let (own, after) = rest.split_at(count);
            rest = after;
            own.to_vec()
        });
        let mut made = Recording::from_matrices(&matrices, contours)?;
        if !times_s.is_null() {
            let times_s = unsafe { array("times_s", times_s, frames)? };
            for (frame, &time_s) in made.frames.iter_mut().zip(times_s) {
                frame.time_s = Some(time_s).filter(|t| !t.is_nan());
            }
        }
        unsafe { put("recording", recording, RECORDINGS.give(made)) }
    })
}

/// Sixteen numbers as rows.
pub fn matrix(numbers: &[f64; 16]) -> [[f64; 4]; 4] {
    std::array::from_fn(|r| std::array::from_fn(|c| numbers[4 * r + c]))
}

/// Pairs of numbers as points.
pub fn contour(numbers: &[f64]) -> Vec<DVec2> {
    numbers.as_chunks::<2>().0.iter().copied().map(DVec2::from_array).collect()
}

/// Reads a recording: a MATLAB .mat file (v4 to v7.3) or a folder of CSV files. Frames that no reconstruction can use are
/// read too.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_recording_read(
    path: *const c_char,
    recording: *mut *mut LumenmeshRecording,
) -> LumenmeshStatus {
    border(|| {
        check_place("recording", recording)?;
        let read = Recording::read_unchecked(Path::new(unsafe { text("path", path)? }))?;
        unsafe { put("recording", recording, RECORDINGS.give(read)) }
    })
}

/// Writes a recording: a .mat file by that ending, else a folder of CSV files. It must have no frame that no reconstruction
/// can use.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_recording_write(
    recording: *const LumenmeshRecording,
    path: *const c_char,
) -> LumenmeshStatus {
    border(|| {
        let recording = RECORDINGS.get(recording)?;
        recording.write(Path::new(unsafe { text("path", path)? }))?;
        Ok(())
    })
}

/// How many frames a recording has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_recording_frames(
    recording: *const LumenmeshRecording,
    frames: *mut usize,
) -> LumenmeshStatus {
    border(|| {
        let recording = RECORDINGS.get(recording)?;
        unsafe { put("frames", frames, recording.frames.len()) }
    })
}

/// Frees a recording; null is left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lumenmesh_recording_free(recording: *mut LumenmeshRecording) -> LumenmeshStatus {
    border(|| RECORDINGS.free(recording))
}
