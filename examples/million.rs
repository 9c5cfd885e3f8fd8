//! Memory and time of a live vessel over very many frames: the catheter goes forth and back without end.
//!
//! ```sh
//! cargo run --release --example million -- 1000000 sweep
//! ```

use lumenmesh::geometry::Pose;
use lumenmesh::glam::{DMat3, DVec2, DVec3};
use lumenmesh::reconstruction::Live;
use lumenmesh::recording::Frame;
use lumenmesh::settings::Settings;
use std::f64::consts::TAU;
use std::time::Instant;

const RAYS: usize = 32;
const RADIUS_MM: f64 = 8.0;
/// The catheter's way, and its step, mm.
const LENGTH_MM: f64 = 60.0;
const STEP_MM: f64 = 0.37;

/// Frame `k` of a catheter in a straight tube; the noise is a few fractions of irrational numbers.
fn frame(k: usize) -> Frame {
    let way = (STEP_MM * k as f64) % (2.0 * LENGTH_MM);
    let z = if way < LENGTH_MM { way } else { 2.0 * LENGTH_MM - way };
    let noise = |i: usize| ((k * RAYS + i) as f64 * 0.618_033_988_749_895).fract() - 0.5;
    let contour_mm = (0..RAYS)
        .map(|ray| DVec2::from_angle(TAU * ray as f64 / RAYS as f64) * (RADIUS_MM + 0.6 * noise(ray)))
        .collect();
    let translation_mm = DVec3::new(0.2 * noise(7), 0.2 * noise(13), z + 0.05 * noise(19));
    Frame::new(Pose { rotation: DMat3::IDENTITY, translation_mm }, contour_mm)
}

/// Memory that the process holds, MB; `None` where the system does not say.
fn resident_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix(" kB")?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let frames: usize = arguments.next().map_or(Ok(1_000_000), |count| count.parse())?;
    let mut settings = Settings::default();
    settings.set("method", &arguments.next().unwrap_or("sweep".into()))?;
    let mut live = Live::new(&settings)?;
    let start = Instant::now();
    for k in 0..frames {
        live.push(&frame(k))?;
        if (k + 1) % (frames / 10).max(1) == 0 {
            let memory = resident_mb().map_or("memory not known".into(), |mb| format!("{mb:.1} MB"));
            let mean_ms = start.elapsed().as_secs_f64() * 1e3 / (k + 1) as f64;
            println!("{} frames: {memory}, {} rings, {mean_ms:.2} ms a frame", k + 1, live.rings());
        }
    }
    Ok(())
}
