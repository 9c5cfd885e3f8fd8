//! The largest job that WebGPU's usual 128 MiB a binding hold. It takes a minute and some memory:
//!
//! ```sh
//! cargo test --release --test gpu large -- --ignored --nocapture
//! ```

use crate::cylinders::assert_agree;
use crate::device::device;
use crate::sections::{RADIUS_MM, wall};
use lumenmesh::fit::{CpuEngine, Engine};
use lumenmesh::settings::Settings;
use std::time::Instant;

/// Most memory that the process has had, in bytes, where the system tells.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(1024 * line.trim().trim_end_matches(" kB").parse::<u64>().ok()?)
}

#[test]
#[ignore = "takes a minute; run it optimised"]
fn ten_million_points_and_four_million_faces_within_8_gib() {
    let Some(device) = device() else { return };
    let settings = Settings { nodes: 2048, levels: 2048, ..Settings::default() };
    let section = wall(10_000_000, 167);
    device.engine.warm_up().unwrap();
    let start = Instant::now();
    let found = device.engine.fit_section(&section, RADIUS_MM, &settings).unwrap();
    println!("device: {:.2} s", start.elapsed().as_secs_f64());
    if let Some(bytes) = peak_memory() {
        println!("peak memory: {} MiB", bytes >> 20);
        assert!(bytes <= 8 << 30);
    }
    let start = Instant::now();
    let expected = CpuEngine::<f32>::new().fit_section(&section, RADIUS_MM, &settings).unwrap();
    println!("CPU: {:.2} s", start.elapsed().as_secs_f64());
    assert_agree(device, &found, &expected);
}
