//! The largest fit within WebGPU's default of 128 MiB per binding. It takes a minute and some memory:
//!
//! ```sh
//! cargo test --release --test gpu large -- --ignored --nocapture
//! ```

use crate::cylinders::assert_agree;
use crate::device::device;
use crate::sections::{RADIUS_MM, wall};
use lumenmesh::Error;
use lumenmesh::cylinders::{CpuEngine, Engine};
use lumenmesh::gpu::GpuError;
use lumenmesh::settings::Settings;
use std::time::Instant;

/// Peak memory of the process, in bytes, on systems that report it.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(1024 * line.trim().trim_end_matches(" kB").parse::<u64>().ok()?)
}

#[test]
#[ignore = "takes a minute; run it optimised"]
fn ten_million_points_and_four_million_faces_within_8_gib() {
    let Some(device) = device() else { return };
    let settings = Settings::default().with_nodes(2048).with_levels(2048);
    let section = wall(10_000_000, 167);
    device.engine.warm_up().unwrap();
    let start = Instant::now();
    let found = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    println!("device: {:.2} s", start.elapsed().as_secs_f64());
    if let Some(bytes) = peak_memory() {
        println!("peak memory: {} MiB", bytes >> 20);
        assert!(bytes <= 8 << 30);
    }
    let start = Instant::now();
    let expected = CpuEngine::<f32>::new().fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    println!("CPU: {:.2} s", start.elapsed().as_secs_f64());
    assert_agree(device, &found, &expected, &section, &settings);
}

/// llvmpipe ends an invocation's loops after 65,535 rounds in all, without an error of its own.
#[test]
fn a_face_with_more_points_than_a_driver_s_loops_allow_is_never_a_wrong_result() {
    let Some(device) = device() else { return };
    let settings = Settings::default().with_nodes(3).with_levels(1).with_iterations(1);
    let section = wall(8_300_000, 168);
    match device.engine.fit_section(&section, RADIUS_MM, &settings) {
        Ok(found) => {
            let expected = CpuEngine::<f32>::new().fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
            assert_agree(device, &found.tube, &expected, &section, &settings);
        }
        Err(Error::Gpu(GpuError::Unfinished { finished, expected, .. })) => {
            assert!(finished < expected && expected == 3, "{finished} of {expected}");
        }
        Err(other) => panic!("{other}"),
    }
}
