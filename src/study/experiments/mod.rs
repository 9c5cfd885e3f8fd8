//! The experiments of the thesis (chapters 4 and 5) on a vessel of known geometry.
//!
//! One simulated insertion gives two recordings, with noise and without, and a second one without bending the tip a
//! third; each is reconstructed and measured against the wall. [`Experiments`] holds every number that the report shows;
//! [`DEFINITIONS`] defines them.

mod primitive;
mod series;
pub mod thesis;

pub use primitive::{Convergence, Iteration, frustum, larger_cylinder};
pub use series::{Merged, Series, Spread};

use crate::Result;
use crate::cylinders::fit::engine;
use crate::evaluate::{Coverage, Truth};
use crate::geometry::Pose;
use crate::recording::Recording;
use crate::settings::{Backend, Method, Settings};
use crate::simulate::{self, Insertion, Noise, Probe, SimulatedVessel, Simulation};
use crate::surface::Surface;
use serde::Serialize;
use std::ops::ControlFlow;
use std::time::Instant;
use thesis::Thesis;

/// What the numbers of [`Experiments`] mean, beside [`crate::evaluate::DEFINITIONS`].
pub const DEFINITIONS: [(&str, &str); 5] = [
    (
        "error of a cylinder",
        "mean over the nodes of one cylinder of the distance to the nearest point of the truth's triangles",
    ),
    ("median fitting error", "median over the cylinders of the error of a cylinder (nearest rank)"),
    ("original, deformed", "the cylinders before the fit, and after its last iteration"),
    (
        "not merged",
        "mean over all nodes of all cylinders, each cylinder whole, so that most places count many times",
    ),
    ("merged", "mean over the nodes of the stitched mesh"),
];

/// The plan of the experiments.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Plan {
    /// What to call the vessel.
    pub vessel_name: String,
    /// How the recordings are reconstructed.
    pub settings: Settings,
    /// How they are simulated. Its noise is that of the noisy recording; the other has none.
    pub simulation: simulate::SimulationSettings,
}

impl Plan {
    /// The experiments of the thesis: its insertion along the whole of branch 0 and its noise, the published method
    /// on the CPU.
    pub fn new(vessel_name: impl Into<String>, seed: u64) -> Self {
        Self {
            vessel_name: vessel_name.into(),
            // The choice of a device must not change the numbers.
            settings: Settings { method: Method::Cylinders, backend: Backend::Cpu, ..Settings::default() },
            simulation: simulate::SimulationSettings {
                noise: Noise { seed, ..Noise::default() },
                ..simulate::SimulationSettings::default()
            },
        }
    }

    /// The same on the first 60 mm with a coarser probe: seconds instead of a minute, and not for comparison.
    #[must_use]
    pub fn quick(mut self) -> Self {
        let Insertion { start_mm, end_mm, .. } = &mut self.simulation.insertion;
        *end_mm = Some(end_mm.unwrap_or(f64::INFINITY).min(*start_mm + 55.0));
        self.simulation.probe = Probe { rays: 60, ..self.simulation.probe };
        self
    }
}

/// Every number of the experiments.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Experiments {
    /// The crate's version.
    pub version: &'static str,
    /// The vessel.
    pub vessel: VesselFacts,
    /// The settings of the reconstruction.
    pub settings: Settings,
    /// The settings of the simulation.
    pub simulation: simulate::SimulationSettings,
    /// Table 1.
    pub larger_cylinder: Convergence,
    /// Tables 2 and 3: ten iterations, of which Table 2 shows three.
    pub frustum: Convergence,
    /// The recording without noise.
    pub noiseless: Series,
    /// The recording with noise.
    pub noisy: Series,
    /// A recording with the same noise along the same way, but the tip is never bent.
    pub noisy_steady: Series,
    /// The thesis's numbers.
    pub thesis: Thesis,
}

/// The vessel of the experiments.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct VesselFacts {
    /// What it is called.
    pub name: String,
    /// Triangles of its wall.
    pub triangles: usize,
    /// Length of the branch that the catheter went along, mm.
    pub branch_length_mm: f64,
    /// What was repaired.
    pub notes: Vec<String>,
    /// How many bends of the tip were reduced to keep it in the lumen.
    pub reduced_bends: usize,
}

/// The results.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Outcome {
    /// The numbers. The same plan and vessel give the same ones, whatever the number of threads.
    pub experiments: Experiments,
    /// The stitched mesh of the noiseless recording, with `error_mm`.
    pub noiseless_mesh: Surface,
    /// The stitched mesh of the noisy recording, with `error_mm`.
    pub noisy_mesh: Surface,
    /// How long it took.
    pub seconds: Seconds,
}

/// Wall-clock times, s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Seconds {
    /// Simulating the insertion.
    pub simulate: f64,
    /// Reconstructing and measuring the noiseless recording.
    pub noiseless: f64,
    /// Reconstructing and measuring the noisy one.
    pub noisy: f64,
    /// Simulating, reconstructing and measuring the noisy one whose tip is never bent.
    pub noisy_steady: f64,
    /// Everything.
    pub total: f64,
}

/// Runs the experiments in a vessel. `tell(stage, done, all)` is called with the progress of a stage, from any thread.
///
/// # Errors
/// Where the simulation, the reconstruction or the evaluation fails.
pub fn run(
    vessel: SimulatedVessel,
    plan: &Plan,
    tell: &(dyn Fn(&'static str, usize, usize) + Sync),
) -> Result<Outcome> {
    let start = Instant::now();
    plan.settings.validate()?;
    let mut simulation = plan.simulation.clone();
    let branch_length_mm =
        vessel.branches().get(simulation.insertion.branch).map_or(0.0, simulate::Centreline::length_mm);
    // A short vessel has no first 60 mm.
    let end_mm = simulation.insertion.end_mm.map(|end| end.min(branch_length_mm - 5.0));
    simulation.insertion.end_mm = end_mm;

    let truth = Truth::new(vessel.surface().clone())?;
    let larger_cylinder = larger_cylinder(&plan.settings, 3)?;
    let frustum = frustum(&plan.settings, 10)?;
    let simulated =
        Simulation::run_and_tell(vessel, &simulation, &|done, all| tell("simulating", done, all))?;
    let coverage = coverage_of(&simulated, &truth)?;
    let simulate_seconds = start.elapsed().as_secs_f64();

    let engine = engine(&plan.settings)?;
    let measure = |stage, recording: &Recording, coverage: &Coverage| -> Result<(Series, Surface, f64)> {
        let start = Instant::now();
        let progress = |done, all| {
            tell(stage, done, all);
            ControlFlow::Continue(())
        };
        let (series, mesh) =
            Series::measure(recording, (&truth, coverage), &plan.settings, &*engine, &progress)?;
        Ok((series, mesh, start.elapsed().as_secs_f64()))
    };
    let (noiseless, noiseless_mesh, noiseless_seconds) =
        measure("without noise", &simulated.truth_recording, &coverage)?;
    let (noisy, noisy_mesh, noisy_seconds) = measure("with noise", &simulated.recording, &coverage)?;

    let steady_start = Instant::now();
    let insertion =
        Insertion { moves: Insertion::steady().moves, repeat: true, ..simulation.insertion.clone() };
    let steady_settings = simulate::SimulationSettings { insertion, ..simulation.clone() };
    let steady = Simulation::run(simulated.vessel.clone(), &steady_settings)?;
    let coverage = coverage_of(&steady, &truth)?;
    let (noisy_steady, ..) = measure("with noise, never bent", &steady.recording, &coverage)?;
    let steady_seconds = steady_start.elapsed().as_secs_f64();
    let experiments = Experiments {
        version: env!("CARGO_PKG_VERSION"),
        vessel: VesselFacts {
            name: plan.vessel_name.clone(),
            triangles: simulated.vessel.surface().triangles.len(),
            branch_length_mm,
            notes: simulated.vessel.notes().to_vec(),
            reduced_bends: simulated.reduced_bends.len(),
        },
        settings: plan.settings.clone(),
        simulation,
        larger_cylinder,
        frustum,
        noiseless,
        noisy,
        noisy_steady,
        thesis: thesis::THESIS,
    };
    let seconds = Seconds {
        simulate: simulate_seconds,
        noiseless: noiseless_seconds,
        noisy: noisy_seconds,
        noisy_steady: steady_seconds,
        total: start.elapsed().as_secs_f64(),
    };
    Ok(Outcome { experiments, noiseless_mesh, noisy_mesh, seconds })
}

/// The part of the truth that the recording covers, the same with noise and without.
fn coverage_of(simulation: &Simulation, truth: &Truth) -> Result<Coverage> {
    Coverage::of(&simulation.truth_recording, Pose::IDENTITY, truth.surface(), Coverage::WITHIN_MM)
}
