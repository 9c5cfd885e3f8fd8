//! The live sweep beside that of the whole recording, over all kinds of errors.

use super::certainty::{Certainty, RECORDINGS, SEEDS, insertion, summary};
use super::{COVERED_MM, covered, echoes_mm, kinds, replace_table};
use glam::DVec3;
use lumenmesh::Result;
use lumenmesh::evaluate::{Locator, Truth, evaluate};
use lumenmesh::reconstruction::{Live, Reconstructor};
use lumenmesh::recording::Recording;
use lumenmesh::settings::Settings;
use lumenmesh::simulate::FaultKind;
use lumenmesh::surface::Surface;
use rayon::prelude::*;

const BEGIN: &str = "<!-- live: written by `cargo run --release --example accuracy -- --live` -->\n";
const END: &str = "<!-- live: end -->\n";

/// A surface against the truth, and against the other one.
struct Judged {
    /// Mean distance from the truth of the nodes where the other surface has wall too, mm.
    mean_mm: f64,
    /// Share of the wall that was seen within [`COVERED_MM`] of the surface.
    covered: f64,
    certainty: Certainty,
}

/// Measures all kinds and writes the table, or prints those with one of the `wanted`, separated by commas, in their names.
pub(super) fn run(wanted: Option<&str>) -> Result<()> {
    let mut table = format!(
        "Mean: of the nodes within {COVERED_MM} mm of the other surface. Covered: points of the wall that was seen within \
         {COVERED_MM} mm of the surface.\n\n\
         | error | vessel | mean, mm: live | batch | live : batch | covered: live | batch | > 1 mm: live | batch | \
         within 1, 2, 3 s.e.: live | batch | spread: live | batch |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n"
    );
    for (name, kind) in kinds::named(wanted) {
        for (short, vessel, is_steady, seed) in RECORDINGS {
            let all: Vec<[Judged; 2]> = SEEDS
                .into_par_iter()
                .map(|more| both(kind, vessel, is_steady, seed + more))
                .collect::<Result<_>>()?;
            let mean = |of: &dyn Fn(&[Judged; 2]) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
            let [live_mm, batch_mm] = [0, 1].map(|k| mean(&|both| both[k].mean_mm));
            let [covered, batch_covered] = [0, 1].map(|k| 100.0 * mean(&|both| both[k].covered));
            let ratios: Vec<f64> = all.iter().map(|[live, batch]| live.mean_mm / batch.mean_mm).collect();
            let (lives, batches) =
                all.into_iter().map(|[live, batch]| (live.certainty, batch.certainty)).unzip();
            let pooled = [Certainty::pooled(lives), Certainty::pooled(batches)];
            let [[far, shares, _], [batch_far, batch_shares, _]] = pooled.each_ref().map(Certainty::cells);
            let [spread, batch_spread] = pooled.each_ref().map(Certainty::spread);
            let ratios = summary(live_mm / batch_mm, &ratios, 2);
            let row = format!(
                "| {name} | {short} | {live_mm:.3} | {batch_mm:.3} | {ratios} | {covered:.1} % | {batch_covered:.1} % | \
                 {far} | {batch_far} | {shares} | {batch_shares} | {spread:.2} | {batch_spread:.2} |\n",
            );
            print!("{row}");
            table += &row;
        }
    }
    if wanted.is_none() {
        replace_table("", &table, BEGIN, END)?;
    }
    Ok(())
}

/// The live surface and the batch's of a recording.
fn both(kind: Option<FaultKind>, vessel: &str, is_steady: bool, seed: u64) -> Result<[Judged; 2]> {
    let simulation = kinds::simulated(kind, vessel, insertion(is_steady), seed)?;
    let truth = Truth::new(simulation.vessel.surface().clone())?;
    let wall_mm = echoes_mm(&simulation.truth_recording);
    let live = live_surface(&simulation.recording)?;
    let batch = Reconstructor::new(Settings::default()).run(&simulation.recording)?.surface();
    Ok([judged(&live, &batch, &truth, &wall_mm)?, judged(&batch, &live, &truth, &wall_mm)?])
}

/// The vessel after the last frame, as a host has it that takes one frame after the other.
fn live_surface(recording: &Recording) -> Result<Surface> {
    let mut live = Live::new(&Settings::default())?;
    for frame in &recording.frames {
        live.push(frame)?;
    }
    live.flush()?;
    Ok(live.surface())
}

fn judged(surface: &Surface, other: &Surface, truth: &Truth, wall_mm: &[DVec3]) -> Result<Judged> {
    let evaluation = evaluate(surface, truth)?;
    let nearest = Locator::new(other)?.closest_all(&surface.nodes_mm);
    let errors_mm = evaluation.error_mm.iter().zip(&nearest);
    let shared = errors_mm.filter(|(_, nearest)| nearest.distance_mm < COVERED_MM);
    let (sum_mm, count) =
        shared.fold((0.0, 0.0), |(sum, count), (error_mm, _)| (sum + error_mm.abs(), count + 1.0));
    Ok(Judged {
        mean_mm: sum_mm / count,
        covered: covered(surface, wall_mm)?,
        certainty: Certainty::of(surface, &evaluation.error_mm),
    })
}
