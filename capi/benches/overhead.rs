//! What the C interface adds to a frame: the same frames through it and through the Rust library, in turns; target 0.1 ms.
//!
//! `cargo bench -p lumenmesh-capi --bench overhead`. A difference of two times that vary with the machine's load: the median
//! of the pairs is printed, for both methods. With `-- --test` it runs on few frames.
#![expect(clippy::unwrap_used, reason = "a bench that cannot go on stops there")]
#![expect(
    clippy::undocumented_unsafe_blocks,
    reason = "every call hands on buffers of this program, as large as it says"
)]

use lumenmesh as _;
use lumenmesh_core::reconstruction::Live;
use lumenmesh_core::recording::Frame;
use lumenmesh_core::settings::Settings;
use lumenmesh_core::simulate::{Insertion, Phantom, Shape, Simulation, SimulationSettings};
use std::ffi::{CString, c_char, c_void};
use std::ptr::null_mut;
use std::time::Instant;

unsafe extern "C" {
    fn lumenmesh_settings_new(settings: *mut *mut c_void) -> i32;
    fn lumenmesh_settings_set(settings: *mut c_void, name: *const c_char, value: *const c_char) -> i32;
    fn lumenmesh_settings_free(settings: *mut c_void) -> i32;
    fn lumenmesh_live_new(settings: *const c_void, live: *mut *mut c_void) -> i32;
    fn lumenmesh_live_push(
        live: *mut c_void,
        world_from_sensor: *const f64,
        points: usize,
        contour_mm: *const f64,
        time_s: f64,
        change: *mut c_void,
    ) -> i32;
    fn lumenmesh_live_free(live: *mut c_void) -> i32;
}

fn frames(test: bool) -> Vec<Frame> {
    let vessel = Phantom::from("arch".parse::<Shape>().unwrap()).vessel().unwrap();
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    let mut frames = Simulation::run(vessel, &settings).unwrap().recording.frames;
    frames.truncate(if test { 150 } else { usize::MAX });
    frames
}

/// The numbers of a frame as a host in C has them: the matrix row by row, and x, y of each point.
fn numbers(frame: &Frame) -> ([f64; 16], Vec<f64>) {
    let (rotation, position) = (frame.world_from_sensor.rotation, frame.world_from_sensor.translation_mm);
    let mut matrix = [0.0; 16];
    for row in 0..3 {
        (0..3).for_each(|column| matrix[4 * row + column] = rotation.col(column)[row]);
        matrix[4 * row + 3] = position[row];
    }
    matrix[15] = 1.0;
    (matrix, frame.contour_mm.iter().flat_map(|p| p.to_array()).collect())
}

fn main() {
    let frames = frames(std::env::args().any(|argument| argument == "--test"));
    for method in ["cylinders", "sweep"] {
        let mut settings = Settings::default();
        settings.set("method", method).unwrap();
        let mut rust = Live::new(&settings).unwrap();
        let (mut of_c, mut live) = (null_mut(), null_mut());
        let [name, value] = ["method", method].map(|text| CString::new(text).unwrap());
        unsafe {
            assert!(lumenmesh_settings_new(&raw mut of_c) == 0);
            assert!(lumenmesh_settings_set(of_c, name.as_ptr(), value.as_ptr()) == 0);
            assert!(lumenmesh_live_new(of_c, &raw mut live) == 0);
        }
        let mut added_ms: Vec<f64> = Vec::new();
        for (k, frame) in frames.iter().enumerate() {
            let (matrix, contour) = numbers(frame);
            let mut in_rust = || {
                let start = Instant::now();
                rust.push(frame).unwrap();
                start.elapsed().as_secs_f64() * 1e3
            };
            let in_c = || {
                let start = Instant::now();
                let time_s = frame.time_s.unwrap_or(f64::NAN);
                let (points, contour) = (frame.contour_mm.len(), contour.as_ptr());
                let status = unsafe {
                    lumenmesh_live_push(live, matrix.as_ptr(), points, contour, time_s, null_mut())
                };
                assert!(status == 0);
                start.elapsed().as_secs_f64() * 1e3
            };
            // Who comes second finds the caches warm: they take turns.
            let (rust_ms, c_ms) = if k % 2 == 0 {
                let first = in_rust();
                (first, in_c())
            } else {
                let first = in_c();
                (in_rust(), first)
            };
            added_ms.push(c_ms - rust_ms);
        }
        assert!(rust.rings() > 0, "there is a vessel");
        added_ms.sort_by(f64::total_cmp);
        println!(
            "{method}: C adds {:.4} ms a frame in the median of {}",
            added_ms[added_ms.len() / 2],
            added_ms.len()
        );
        unsafe {
            lumenmesh_live_free(live);
            lumenmesh_settings_free(of_c);
        }
    }
}
