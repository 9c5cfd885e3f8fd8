//! Measures all methods against known truth, beside Poisson reconstruction, and writes the table of
//! `docs/accuracy.md` anew.
//!
//! ```sh
//! cargo run --release --example accuracy            # all rows; writes the table
//! cargo run --release --example accuracy aorta      # rows with that in their names; prints only
//! cargo run --release --example accuracy -- --kinds       # errors that laboratories meet; writes their table
//! cargo run --release --example accuracy -- --kinds ring  # kinds with that in their names; prints only
//! cargo run --release --example accuracy -- --standard-errors       # whether standard errors hold, all kinds
//! cargo run --release --example accuracy -- --standard-errors drift # those kinds; prints only
//! cargo run --release --example accuracy -- --live                  # the live sweep beside the whole recording's, all kinds
//! cargo run --release --example accuracy -- --live none,glitch      # those kinds; prints only
//! cargo run --release --example accuracy -- --motion                # vessels that breathe and beat; writes their table
//! cargo run --release --example accuracy -- --motion heart          # motions with that in their names; prints only
//! ```
//!
//! `LUMENMESH_SHARED` names the folder with `recordings/` and `data/` (default: `../shared`), `LUMENMESH_PYTHON` a
//! Python with Open3D (default: `python3`); without it Poisson is not run. Exit status: 0 where the sweep's mean
//! distance is at most 0.8 times Poisson's in every row, else 1.

mod calibration;
mod certainty;
#[path = "../../tests/support/data.rs"]
mod data;
mod kinds;
mod live;
mod motion;

use data::shared_path as shared;
use glam::DVec3;
use lumenmesh::Result;
use lumenmesh::cylinders::CylinderReconstruction;
use lumenmesh::cylinders::engine;
use lumenmesh::evaluate::{Distances, Locator, Truth, evaluate};
use lumenmesh::output::write_atomically;
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Backend, Merge, Settings};
use lumenmesh::simulate::{
    self, Centreline, Insertion, Move, Noise, Phantom, Shape, SimulatedVessel, Simulation,
};
use lumenmesh::surface::Surface;
use lumenmesh::sweep::Sweep;
use std::path::Path;
use std::process::{Command, ExitCode};

const TABLE: &str = "docs/accuracy.md";
const BEGIN: &str = "<!-- accuracy: written by `cargo run --release --example accuracy` -->\n";
const END: &str = "<!-- accuracy: end -->\n";
/// What the sweep may have of Poisson's mean distance.
const GATE: f64 = 0.8;
/// Wall points this near to a surface are covered, mm.
const COVERED_MM: f64 = 1.0;

/// Where a row's recording comes from.
enum Source {
    /// A recording of the shared data in the adult aorta.
    Recorded(&'static str),
    /// A simulated one; with noise, or without any.
    Simulated { vessel: &'static str, way: Way, noise_mm: Option<[f64; 2]>, seed: u64 },
}

/// How the catheter goes.
enum Way {
    /// The thesis's: forward, tip bent, turned, straightened.
    Thesis,
    /// The same from so far along that branch of the vessel.
    Branch(usize, f64),
    Steady,
    /// Forward and part of the way back, resting and circling.
    ThereAndBack,
}

struct Input {
    recording: Recording,
    /// Points on the wall that the probe saw, without noise.
    wall_mm: Vec<DVec3>,
    truth: Truth,
}

/// One method's result in a row.
struct Measured {
    distances: Distances,
    covered: f64,
}

fn main() -> ExitCode {
    let (first, second) = (std::env::args().nth(1), std::env::args().nth(2));
    let done = match first.as_deref() {
        Some("--kinds") => kinds::run(second.as_deref()).map(|()| true),
        Some("--standard-errors") => certainty::run(second.as_deref()).map(|()| true),
        Some("--calibration") => calibration::run(second.as_deref()).map(|()| true),
        Some("--live") => live::run(second.as_deref()).map(|()| true),
        Some("--motion") => motion::run(second.as_deref()).map(|()| true),
        wanted => run(wanted),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("accuracy: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(wanted: Option<&str>) -> Result<bool> {
    let python = python();
    let mut table = String::from(
        "| recording | R, mm | stitched | blended | sweep | Poisson, best depth | sweep : Poisson |\n|---|---|---|---|---|---|---|\n",
    );
    let mut passed = true;
    for (name, source) in rows() {
        if wanted.is_some_and(|part| !name.contains(part)) {
            continue;
        }
        let Input { recording, wall_mm, truth } = input(&source)?;
        let measure = |surface: &Surface| measured(surface, &truth, &wall_mm);
        let [stitched, blended] = [Merge::Stitch, Merge::Blend].map(|merge| {
            let settings = Settings::default().with_backend(Backend::Cpu).with_merge(merge);
            let done = CylinderReconstruction::of(&recording, &settings, &*engine(&settings)?)?;
            measure(&done.vessel.surface())
        });
        let sweep = Sweep::of(&recording, &Settings::default())?;
        let swept = measure(&sweep.surface(false))?;
        let mut best: Option<(u32, Measured)> = None;
        if let Some(python) = &python {
            for (depth, surface) in poisson(python, &recording)? {
                let found = measure(&surface)?;
                if best.as_ref().is_none_or(|(_, b)| found.distances.mean_mm < b.distances.mean_mm) {
                    best = Some((depth, found));
                }
            }
        }
        let (poisson, ratio) = match best {
            None => ("not run".into(), "-".into()),
            Some((depth, found)) => {
                let ratio = swept.distances.mean_mm / found.distances.mean_mm;
                passed &= ratio <= GATE;
                let verdict = if ratio <= GATE { "PASS" } else { "FAIL" };
                (format!("{depth}: {}", found.cell()), format!("{ratio:.2} {verdict}"))
            }
        };
        let row = format!(
            "| {name} | {:.1} | {} | {} | {} | {poisson} | {ratio} |\n",
            sweep.report.contour_radius_mm,
            stitched?.cell(),
            blended?.cell(),
            swept.cell()
        );
        print!("{row}");
        table += &row;
    }
    let passed = passed && python.is_some();
    println!("{}", if passed { "PASS" } else { "FAIL" });
    if python.is_none() {
        println!("Poisson was not run: {TABLE} stays as it is");
    } else if wanted.is_none() {
        replace_table("; the seed of each recording is in its name", &table, BEGIN, END)?;
        println!("wrote {TABLE}");
    }
    Ok(passed)
}

/// The Python that runs Poisson reconstruction, if there is one.
fn python() -> Option<String> {
    let python = std::env::var("LUMENMESH_PYTHON").unwrap_or_else(|_| "python3".into());
    let check = Command::new(&python).args(["scripts/poisson.py", "--check"]).output();
    let python = check.is_ok_and(|o| o.status.success()).then_some(python);
    if python.is_none() {
        eprintln!("no Python with Open3D (LUMENMESH_PYTHON names one): Poisson is not run");
    }
    python
}

/// The rows. Noise: contour and position, mm; rotation 0.5° where there is any.
fn rows() -> Vec<(String, Source)> {
    const THESIS: Option<[f64; 2]> = Some([1.0, 0.3]);
    let mut rows = vec![
        ("`adult_aorta_clean`".into(), Source::Recorded("adult_aorta_clean")),
        ("`adult_aorta_noisy`".into(), Source::Recorded("adult_aorta_noisy")),
    ];
    let mut add = |what: &str, vessel, way, noise_mm: Option<[f64; 2]>, seed| {
        let noise = match noise_mm {
            None => "clean".into(),
            THESIS => format!("noisy, seed {seed}"),
            Some([contour, position]) => format!("{contour} and {position} mm, seed {seed}"),
        };
        rows.push((format!("{what}; {noise}"), Source::Simulated { vessel, way, noise_mm, seed }));
    };
    add("aorta", "aorta", Way::Thesis, THESIS, 7);
    add("aorta, never bent", "aorta", Way::Steady, None, 7);
    add("aorta, never bent", "aorta", Way::Steady, THESIS, 11);
    add("aorta, there and back", "aorta", Way::ThereAndBack, THESIS, 5);
    add("stenosis", "stenosis", Way::Thesis, None, 7);
    add("stenosis", "stenosis", Way::Thesis, THESIS, 7);
    add("aneurysm", "aneurysm", Way::Thesis, THESIS, 11);
    add("bifurcation", "bifurcation", Way::Thesis, THESIS, 7);
    add("side branch", "side_branch", Way::Thesis, THESIS, 11);
    add("adult aorta, branch 1 from 300 mm", "aorta_adult_full_steve", Way::Branch(1, 300.0), THESIS, 5);
    add("arch with coarctation", "aorta_arch_coarctation_bpm120", Way::Thesis, None, 7);
    add("arch with coarctation", "aorta_arch_coarctation_bpm120", Way::Thesis, Some([0.3, 0.1]), 7);
    add("aorto-iliac", "aorto_iliac_bifurcation_vmtk", Way::Thesis, Some([0.5, 0.2]), 11);
    add("coronary", "coronary_tree_phantom_vukicevic", Way::Steady, Some([0.2, 0.1]), 5);
    add("coronary", "coronary_tree_phantom_vukicevic", Way::Thesis, Some([0.2, 0.1]), 7);
    rows
}

fn input(source: &Source) -> Result<Input> {
    match source {
        Source::Recorded(name) => Ok(Input {
            recording: Recording::read(&shared(&format!("recordings/{name}.mat")))?,
            wall_mm: echoes_mm(&Recording::read(&shared("recordings/adult_aorta_clean.mat"))?),
            truth: Truth::new(Surface::read(&shared("data/aorta_adult_full_steve.stl"))?)?,
        }),
        Source::Simulated { vessel, way, noise_mm, seed } => {
            let vessel = simulated_vessel(vessel)?;
            let noise = match *noise_mm {
                None => Noise::none(),
                Some([contour_sd_mm, position_sd_mm]) => Noise::default()
                    .with_contour_sd_mm(contour_sd_mm)
                    .with_position_sd_mm(position_sd_mm)
                    .with_seed(*seed),
            };
            let settings =
                simulate::SimulationSettings::default().with_insertion(way.insertion()).with_noise(noise);
            let simulation = Simulation::run(vessel, &settings)?;
            Ok(Input {
                recording: simulation.recording,
                wall_mm: echoes_mm(&simulation.truth_recording),
                truth: Truth::new(simulation.vessel.surface().clone())?,
            })
        }
    }
}

/// A phantom by name, or a surface of the shared data.
fn simulated_vessel(name: &str) -> Result<SimulatedVessel> {
    let stl = shared(&format!("data/{name}.stl"));
    match name.parse::<Shape>() {
        Ok(shape) => Phantom::from(shape).vessel(),
        Err(_) => {
            let centreline = shared(&format!("data/{name}_centreline.csv"));
            SimulatedVessel::new(Surface::read(&stl)?, Centreline::read_branches(&centreline)?)
        }
    }
}

impl Way {
    fn insertion(&self) -> Insertion {
        match *self {
            Way::Thesis => Insertion::default(),
            Way::Branch(branch, start_mm) => Insertion::default().with_branch(branch).with_start_mm(start_mm),
            Way::Steady => Insertion::steady().with_repeat(true),
            Way::ThereAndBack => Insertion::default().with_start_mm(20.0).with_moves(vec![
                Move::Advance { distance_mm: 30.0 },
                Move::Withdraw { distance_mm: 15.0 },
                Move::Rest { duration_s: 5.0 },
                Move::Bend { angle_deg: 20.0 },
                Move::Turn { angle_deg: 360.0 },
                Move::Bend { angle_deg: 0.0 },
            ]),
        }
    }
}

fn echoes_mm(recording: &Recording) -> Vec<DVec3> {
    let frames = recording.frames.iter();
    frames.flat_map(|f| f.echoes_mm().map(|p| f.world_from_sensor.transform_point(p.extend(0.0)))).collect()
}

fn measured(surface: &Surface, truth: &Truth, wall_mm: &[DVec3]) -> Result<Measured> {
    let distances = evaluate(surface, truth)?.mesh_to_truth;
    Ok(Measured { distances, covered: covered(surface, wall_mm)? })
}

/// Share of the wall points that are covered by a surface.
fn covered(surface: &Surface, wall_mm: &[DVec3]) -> Result<f64> {
    let closest = Locator::new(surface)?.closest_all(wall_mm);
    Ok(closest.iter().filter(|c| c.distance_mm < COVERED_MM).count() as f64 / wall_mm.len() as f64)
}

impl Measured {
    fn cell(&self) -> String {
        let Distances { mean_mm, p95_mm, max_mm, .. } = self.distances;
        format!("{mean_mm:.4}; {p95_mm:.3}; {max_mm:.2}; {:.1} %", 100.0 * self.covered)
    }
}

/// Poisson reconstructions of a recording's echoes by depth.
fn poisson(python: &str, recording: &Recording) -> Result<Vec<(u32, Surface)>> {
    let folder = std::env::temp_dir().join(format!("lumenmesh-accuracy-{}", std::process::id()));
    let failed = |source| lumenmesh::Error::write(&folder, source);
    std::fs::create_dir_all(&folder).map_err(failed)?;
    let echoes = folder.join("echoes.f64");
    write_atomically(&echoes, |out| {
        for frame in &recording.frames {
            let Some(centre) = frame.centroid_mm() else { continue };
            let to_world = |p: glam::DVec2| frame.world_from_sensor.transform_point(p.extend(0.0));
            for echo in frame.echoes_mm() {
                for number in [to_world(echo), to_world(centre)].iter().flat_map(DVec3::to_array) {
                    out.write_all(&number.to_le_bytes())?;
                }
            }
        }
        Ok(())
    })?;
    let status =
        Command::new(python).args(["scripts/poisson.py".as_ref(), echoes.as_path(), &folder]).status();
    if !status.map_err(failed)?.success() {
        return Err(failed(std::io::Error::other("scripts/poisson.py failed")));
    }
    let meshes = (6..=9).map(|depth| Ok((depth, Surface::read(&folder.join(format!("depth_{depth}.ply")))?)));
    let meshes = meshes.collect();
    std::fs::remove_dir_all(&folder).map_err(failed)?;
    meshes
}

/// Writes a table between its marks, behind a line with the version and a note on it.
fn replace_table(note: &str, table: &str, begin: &str, end: &str) -> Result<()> {
    let path = Path::new(TABLE);
    let page = std::fs::read_to_string(path).map_err(|source| lumenmesh::Error::read(path, source))?;
    let Some(((before, _), (_, after))) = page.split_once(begin).zip(page.split_once(end)) else {
        return Err(lumenmesh::Error::read(
            path,
            std::io::Error::other("the marks of the table are missing"),
        ));
    };
    let version = env!("CARGO_PKG_VERSION");
    let new = format!("{before}{begin}\nlumenmesh {version}{note}.\n\n{table}\n{end}{after}");
    write_atomically(path, |out| out.write_all(new.as_bytes()))
}
