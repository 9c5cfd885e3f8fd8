//! Errors that laboratories meet: all kinds, in several vessels, by all methods, beside Poisson reconstruction.

use super::certainty::Certainty;
use super::{COVERED_MM, echoes_mm, poisson, python, replace_table, simulated_vessel};
use glam::DVec3;
use lumenmesh::Result;
use lumenmesh::evaluate::{Distances, Locator, Truth, evaluate};
use lumenmesh::reconstruction::Reconstructor;
use lumenmesh::recording::Recording;
use lumenmesh::settings::{Backend, Merge, Method, Settings};
use lumenmesh::simulate::{self, FaultKind, Insertion, Noise, Probe, Simulation};
use lumenmesh::surface::Surface;

const BEGIN: &str = "<!-- kinds: written by `cargo run --release --example accuracy -- --kinds` -->\n";
const END: &str = "<!-- kinds: end -->\n";

/// The vessels, and how fast the catheter advances in them, mm/s.
const VESSELS: [(&str, &str, f64); 2] =
    [("arch", "arch", 2.4), ("iliac", "aorto_iliac_bifurcation_vmtk", 2.4)];

/// Measures all kinds and writes the table, or prints those with `wanted` in their names.
pub(super) fn run(wanted: Option<&str>) -> Result<()> {
    let python = python();
    let mut table = String::from(
        "| error | vessel | stitched | blended | sweep | > 1 mm | within 1, 2, 3 s.e. | rank | Poisson, best depth | \
         sweep : Poisson |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, kind) in named(wanted) {
        for (short, vessel, speed_mm_s) in VESSELS {
            let row = row(name, kind, (short, vessel, speed_mm_s), python.as_deref())?;
            print!("{row}");
            table += &row;
        }
    }
    if wanted.is_none() {
        replace_table("", &table, BEGIN, END)?;
    }
    Ok(())
}

/// Independent noise alone, and all kinds of errors: those with one of the `wanted`, separated by commas, in their names.
pub(super) fn named(wanted: Option<&str>) -> impl Iterator<Item = (&'static str, Option<FaultKind>)> {
    let is_wanted =
        move |name: &str| wanted.is_none_or(|parts| parts.split(',').any(|part| name.contains(part)));
    let kinds = FaultKind::ALL.map(|kind| (kind.name, Some(kind)));
    std::iter::once(("none", None)).chain(kinds).filter(move |(name, _)| is_wanted(name))
}

/// A recording with these kinds of errors, or with independent noise only, of 72 rays in a frame.
pub(super) fn simulated(
    kinds: impl IntoIterator<Item = FaultKind>,
    vessel: &str,
    insertion: Insertion,
    seed: u64,
) -> Result<Simulation> {
    Ok(simulated_with(kinds, vessel, insertion, seed)?.0)
}

/// The same, and the settings that it was simulated with.
pub(super) fn simulated_with(
    kinds: impl IntoIterator<Item = FaultKind>,
    vessel: &str,
    insertion: Insertion,
    seed: u64,
) -> Result<(Simulation, simulate::SimulationSettings)> {
    let vessel = simulated_vessel(vessel)?;
    let radius_mm = vessel.branches()[0].median_radius_mm();
    let noise = Noise::default().with_seed(seed).with_contour_sd_mm(radius_mm / 10.0);
    let mut settings = simulate::SimulationSettings::default()
        .with_insertion(insertion)
        .with_probe(Probe::default().with_rays(72))
        .with_noise(noise.with_position_sd_mm(0.03 * radius_mm));
    kinds.into_iter().for_each(|kind| kind.apply(&mut settings, radius_mm));
    Ok((Simulation::run(vessel, &settings)?, settings))
}

fn row(
    name: &str,
    kind: Option<FaultKind>,
    (short, vessel, speed_mm_s): (&str, &str, f64),
    python: Option<&str>,
) -> Result<String> {
    let simulation = simulated(kind, vessel, Insertion::steady().with_speed_mm_s(speed_mm_s), 7)?;
    let truth = Truth::new(simulation.vessel.surface().clone())?;
    let wall_mm = echoes_mm(&simulation.truth_recording);
    let recording = &simulation.recording;
    let cylinders = Settings::default().with_method(Method::Cylinders).with_backend(Backend::Cpu);
    let [stitched, blended] = [Merge::Stitch, Merge::Blend]
        .map(|merge| cell(reconstructed(recording, cylinders.clone().with_merge(merge)), &truth, &wall_mm));
    let swept = reconstructed(recording, Settings::default());
    let evaluated = swept.as_ref().ok().map(|surface| evaluate(surface, &truth)).transpose()?;
    let certain = swept.as_ref().ok().zip(evaluated.as_ref()).map(|(s, e)| Certainty::of(s, &e.error_mm));
    let swept_mean_mm = evaluated.as_ref().map(|e| e.mesh_to_truth.mean_mm);
    let mut best: Option<(u32, Distances)> = None;
    if let Some(python) = python {
        for (depth, surface) in poisson(python, recording)? {
            let Ok(found) = evaluate(&surface, &truth) else { continue };
            let found = found.mesh_to_truth;
            if best.as_ref().is_none_or(|(_, best)| found.mean_mm < best.mean_mm) {
                best = Some((depth, found));
            }
        }
    }
    let [far, shares, rank] = certain.map_or([(); 3].map(|()| "-".into()), |c| c.cells());
    let poisson = best
        .as_ref()
        .map_or("not run".into(), |(depth, d)| format!("{depth}: {:.3}; {:.2}", d.mean_mm, d.p95_mm));
    let ratio =
        swept_mean_mm.zip(best).map_or("-".into(), |(sweep, (_, d))| format!("{:.2}", sweep / d.mean_mm));
    let swept = cell(swept, &truth, &wall_mm);
    Ok(format!(
        "| {name} | {short} | {stitched} | {blended} | {swept} | {far} | {shares} | {rank} | {poisson} | {ratio} |\n"
    ))
}

fn reconstructed(recording: &Recording, settings: Settings) -> Result<Surface> {
    Ok(Reconstructor::new(settings).run(recording)?.surface())
}

/// Mean and 95th percentile, mm, and the share of the wall that is covered; or that the recording was refused.
fn cell(surface: Result<Surface>, truth: &Truth, wall_mm: &[DVec3]) -> String {
    let measured = surface.and_then(|surface| {
        let distances = evaluate(&surface, truth)?.mesh_to_truth;
        let closest = Locator::new(&surface)?.closest_all(wall_mm);
        let covered =
            closest.iter().filter(|c| c.distance_mm < COVERED_MM).count() as f64 / wall_mm.len() as f64;
        Ok(format!("{:.3}; {:.2}; {:.1} %", distances.mean_mm, distances.p95_mm, 100.0 * covered))
    });
    measured.unwrap_or_else(|_| "refused".into())
}
