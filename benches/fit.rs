//! How fast the CPU fits: targets C1 (against a tuned C++ program) and C3 (a whole recording).
//!
//! `cargo bench --bench fit`. The C++ peer is `peers/peer_fit.py` in the folder of shared data (`LUMENMESH_SHARED`,
//! default `../shared`); it needs g++ and a Python with NumPy (`LUMENMESH_PYTHON`, default `python3`). Both sides
//! take turns in one run; medians, spread and the machine's load are printed. With `-- --test` everything runs once
//! on little work.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on stops there")]

#[path = "../tests/support/data.rs"]
mod data;

use cpu_time::ProcessTime;
use lumenmesh::cylinders::{CpuEngine, Engine, FitRequest, Track, merged_frames};
use lumenmesh::recording::Recording;
use lumenmesh::settings::Settings;
use lumenmesh::study::bench::{Case, Parity};
use std::path::PathBuf;
use std::process::Command;
use std::time::Instant;

const RADIUS_MM: f64 = 12.0;

/// Wall-clock and CPU time of something, in ms.
fn timed<R>(work: impl FnOnce() -> R) -> ([f64; 2], R) {
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    let done = work();
    ([wall.elapsed().as_secs_f64() * 1e3, cpu.elapsed().as_secs_f64() * 1e3], done)
}

/// Median, least and greatest.
fn spread(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    format!("{:.3} ({:.3} to {:.3})", values[values.len() / 2], values[0], values[values.len() - 1])
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn shared(name: &str) -> Option<PathBuf> {
    let path = data::shared_path(name);
    path.exists().then_some(path)
}

/// Seconds of wall-clock and CPU time that the C++ peer says it takes for a case, in ms.
fn peer(case: &Case) -> Option<[f64; 2]> {
    let python = std::env::var("LUMENMESH_PYTHON").unwrap_or_else(|_| "python3".into());
    let output = Command::new(python)
        .arg(shared("peers/peer_fit.py")?)
        .args(["--lib", "cpp", "--reps", "3", "--iters", "3"])
        .args(["--n", &case.nodes.to_string(), "--levels", &case.levels.to_string()])
        .args(["--points", &case.points.to_string()])
        .output()
        .ok()?;
    let line: serde_json::Value = serde_json::from_slice(&output.stdout).ok()?;
    Some([line["s"].as_f64()? * 1e3, line["cpu_s"].as_f64()? * 1e3])
}

fn against_peer(case: &Case, rounds: usize) {
    let (section, settings) = (case.section(1), case.settings());
    let engine = CpuEngine::<f32>::new();
    let fit = || engine.fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    let reference = CpuEngine::<f64>::new().fit_section(&section, RADIUS_MM, &settings).unwrap().tube;
    let parity = Parity::check(["reference", "cpu"], &reference, &fit()).unwrap();
    let (mut ours, mut theirs, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..rounds {
        // Three fits a turn, like the peer; the median is the turn's time.
        let turn: Vec<[f64; 2]> = (0..3).map(|_| timed(fit).0).collect();
        let [wall, cpu] = [0, 1].map(|k| median(&turn.iter().map(|t| t[k]).collect::<Vec<_>>()));
        ours.push([wall, cpu]);
        if let Some([peer_wall, peer_cpu]) = peer(case) {
            theirs.push([peer_wall, peer_cpu]);
            ratios.push(peer_cpu / cpu);
        }
    }
    let column = |rows: &[[f64; 2]], k: usize| spread(rows.iter().map(|r| r[k]).collect());
    println!("C1 {case}: reference and cpu apart by {:.1e} mm in the median", parity.median_mm);
    println!("   ours   wall {} ms, CPU {} ms", column(&ours, 0), column(&ours, 1));
    if theirs.is_empty() {
        println!("   peer   not measured: no peers/peer_fit.py, NumPy or g++");
    } else {
        println!("   C++    wall {} ms, CPU {} ms", column(&theirs, 0), column(&theirs, 1));
        println!("   per CPU-second {} times as fast as C++", spread(ratios));
    }
}

fn whole_recording(rounds: usize) {
    let Some(path) = shared("recordings/adult_aorta_noisy.mat") else {
        println!("C3 not measured: no recordings/adult_aorta_noisy.mat");
        return;
    };
    let recording = Recording::read(&path).unwrap();
    let settings = Settings::default();
    let frames = merged_frames(recording.frames.len(), &settings);
    let fit = || {
        let track = Track::of(&recording, &settings).unwrap();
        CpuEngine::<f32>::new().fit(&FitRequest::new(&track, &frames, &settings)).unwrap().cylinders
    };
    let track = Track::of(&recording, &settings).unwrap();
    let reference =
        CpuEngine::<f64>::new().fit(&FitRequest::new(&track, &frames, &settings)).unwrap().cylinders;
    for (ours, truth) in fit().iter().zip(&reference) {
        Parity::check(["reference", "cpu"], &truth.tube, &ours.tube).unwrap();
    }
    let times: Vec<[f64; 2]> = (0..rounds).map(|_| timed(fit).0).collect();
    let column = |k: usize| spread(times.iter().map(|t| t[k]).collect());
    println!(
        "C3 adult_aorta_noisy, {} cylinders, loading apart: wall {} ms, CPU {} ms",
        frames.len(),
        column(0),
        column(1)
    );
}

fn main() {
    let test = std::env::args().any(|a| a == "--test");
    let (sizes, rounds): (&[&str], usize) = match test {
        true => (&["12x5x1e3"], 1),
        false => (&["12x5x1e4", "12x5x1e6", "512x512x1e6", "512x512x1e7"], 5),
    };
    println!("{} threads", rayon::current_num_threads());
    for size in sizes {
        against_peer(&size.parse().unwrap(), rounds);
    }
    whole_recording(if test { 1 } else { 21 });
    if let Ok(load) = std::fs::read_to_string("/proc/loadavg") {
        println!("load {}", load.trim());
    }
}
