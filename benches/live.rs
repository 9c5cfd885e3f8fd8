//! How long a frame takes while the recording goes on: target L1, p99 of at most 5 ms.
//!
//! `cargo bench --bench live`. Every frame of `recordings/adult_aorta_noisy.mat` in the folder of shared data
//! (`LUMENMESH_SHARED`, default `../shared`), and a catheter that moves on and then rests for 20,000 frames; both
//! methods. CPU time stands beside wall-clock time, and the machine's load is printed. A frame's work depends on the
//! frames alone: its fastest of three runs says how long that takes, without what else the machine did. With `-- --test`
//! everything runs once on little work.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on stops there")]

#[path = "../tests/support/data.rs"]
mod data;
#[path = "../tests/support/percentiles.rs"]
mod percentiles;

use cpu_time::ProcessTime;
use lumenmesh::cylinders::CylinderReconstruction;
use lumenmesh::cylinders::engine;
use lumenmesh::reconstruction::Live;
use lumenmesh::recording::{Frame, Recording};
use lumenmesh::settings::{Method, Settings};
use lumenmesh::simulate::{self, Insertion, Move, Phantom, Shape, Simulation};
use lumenmesh::surface::Surface;
use lumenmesh::sweep::Sweep;
use percentiles::percentiles;
use std::time::Instant;

/// The columns of a frame's times, ms.
const COLUMNS: [&str; 7] = ["wall", "CPU", "fastest", "screening", "axis", "placing", "solving"];

/// The vessel after all frames, and the times of each.
fn pushed(frames: &[Frame], settings: &Settings, test: bool) -> (Live, Vec<[f64; 7]>) {
    let (live, mut times) = pushed_once(frames, settings);
    for _ in 0..if test { 0 } else { 2 } {
        let (again, more) = pushed_once(frames, settings);
        assert!(again.surface().nodes_mm == live.surface().nodes_mm, "every run gives the same");
        times.iter_mut().zip(more).for_each(|(times, more)| times[2] = times[2].min(more[0]));
    }
    (live, times)
}

fn pushed_once(frames: &[Frame], settings: &Settings) -> (Live, Vec<[f64; 7]>) {
    let mut live = Live::new(settings).unwrap();
    let times = frames.iter().map(|frame| {
        let (wall, cpu) = (Instant::now(), ProcessTime::now());
        let stages = live.push(frame).unwrap().times;
        let (wall, cpu) = (wall.elapsed().as_secs_f64(), cpu.elapsed().as_secs_f64());
        [wall, cpu, wall, stages.screening_s, stages.axis_s, stages.placing_s, stages.solving_s]
            .map(|s| s * 1e3)
    });
    let times = times.collect();
    live.flush().unwrap();
    (live, times)
}

fn print(what: &str, times: &[[f64; 7]]) {
    println!("L1 {what}, {} frames", times.len());
    for (k, column) in COLUMNS.iter().enumerate() {
        println!("   {column:9} {}", percentiles(times.iter().map(|t| t[k]).collect()));
    }
    let mut slowest: Vec<usize> = (0..times.len()).collect();
    slowest.sort_by(|&a, &b| times[b][0].total_cmp(&times[a][0]));
    let slowest: Vec<String> = slowest
        .iter()
        .take(3)
        .map(|&k| format!("frame {k} {:.1} ms ({:.1} CPU)", times[k][0], times[k][1]))
        .collect();
    println!("   slowest   {}", slowest.join(", "));
}

/// Mean distance of the nodes from a surface, mm.
fn apart(surface: &Surface, other: &Surface) -> f64 {
    let closest = lumenmesh::evaluate::Locator::new(other).unwrap().closest_all(&surface.nodes_mm);
    closest.iter().map(|c| c.distance_mm).sum::<f64>() / closest.len() as f64
}

fn recording(test: bool) {
    let path = data::shared_path("recordings/adult_aorta_noisy.mat");
    if !path.exists() {
        println!("L1 not measured on adult_aorta_noisy: no {}", path.display());
        return;
    }
    let mut recording = Recording::read(&path).unwrap();
    if test {
        recording.frames.truncate(200);
    }
    let cylinders = Settings::default().with_method(Method::Cylinders);
    let (live, times) = pushed(&recording.frames, &cylinders, test);
    let batch = CylinderReconstruction::of(&recording, &cylinders, &*engine(&cylinders).unwrap()).unwrap();
    assert!(live.surface().nodes_mm == batch.vessel.surface().nodes_mm, "live and batch are one");
    print("adult_aorta_noisy, cylinders", &times);

    let sweep = Settings::default().with_method(Method::Sweep);
    let (live, times) = pushed(&recording.frames, &sweep, test);
    let apart = apart(&live.surface(), &Sweep::of(&recording, &sweep).unwrap().surface(true));
    assert!(apart < 0.2, "live and batch are {apart} mm apart");
    print("adult_aorta_noisy, sweep", &times);
}

fn rest(frames: usize, test: bool) {
    let duration_s = frames as f64 / 12.0;
    let moves =
        vec![Move::Advance { distance_mm: 30.0 }, Move::Bend { angle_deg: 20.0 }, Move::Rest { duration_s }];
    let insertion = Insertion::default().with_moves(moves).with_repeat(false);
    let vessel = Phantom::from("cylinder".parse::<Shape>().unwrap()).vessel().unwrap();
    let settings = simulate::SimulationSettings::default().with_insertion(insertion);
    let simulation = Simulation::run(vessel, &settings).unwrap();
    for method in [Method::Cylinders, Method::Sweep] {
        let settings = Settings::default().with_method(method);
        let (live, times) = pushed(&simulation.recording.frames, &settings, test);
        let apart = apart(&live.surface(), simulation.vessel.surface());
        assert!(apart < 1.5, "live and truth are {apart} mm apart");
        let count = times.len();
        print(&format!("rest, {method:?}, first half"), &times[..count / 2]);
        print(&format!("rest, {method:?}, second half"), &times[count / 2..]);
    }
}

/// A catheter that goes forth and back in an arch: the axis moves while many echoes lie about it.
fn to_and_fro(test: bool) {
    let advance = |distance_mm| Move::Advance { distance_mm };
    let rest = Move::Rest { duration_s: 20.0 };
    let moves = vec![
        advance(30.0),
        Move::Bend { angle_deg: 25.0 },
        Move::Turn { angle_deg: 360.0 },
        rest,
        Move::Bend { angle_deg: 0.0 },
        Move::Withdraw { distance_mm: 15.0 },
        advance(60.0),
        Move::Withdraw { distance_mm: 40.0 },
    ];
    let vessel = Phantom::from("arch".parse::<Shape>().unwrap()).vessel().unwrap();
    let insertion = Insertion::default().with_moves(moves).with_repeat(false);
    let settings = simulate::SimulationSettings::default().with_insertion(insertion);
    let simulation = Simulation::run(vessel, &settings).unwrap();
    for method in [Method::Cylinders, Method::Sweep] {
        let settings = Settings::default().with_method(method);
        let (live, times) = pushed(&simulation.recording.frames, &settings, test);
        let apart = apart(&live.surface(), simulation.vessel.surface());
        assert!(apart < 1.5, "live and truth are {apart} mm apart");
        print(&format!("to and fro in an arch, {method:?}"), &times);
    }
}

fn main() {
    let test = std::env::args().any(|a| a == "--test");
    println!("{} threads", rayon::current_num_threads());
    recording(test);
    to_and_fro(test);
    rest(if test { 200 } else { 20_000 }, test);
    if let Ok(load) = std::fs::read_to_string("/proc/loadavg") {
        println!("load {}", load.trim());
    }
}
