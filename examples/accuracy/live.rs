//! The live sweep beside that of the whole recording, over all kinds of errors.

use super::certainty::{Certainty, RECORDINGS, insertion};
use super::{COVERED_MM, Measured, echoes_mm, kinds, measured, replace_table};
use glam::DVec3;
use lumenmesh::Result;
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::reconstruction::{Live, Reconstructor};
use lumenmesh::recording::Recording;
use lumenmesh::settings::Settings;
use lumenmesh::surface::Surface;

const BEGIN: &str = "<!-- live: written by `cargo run --release --example accuracy -- --live` -->\n";
const END: &str = "<!-- live: end -->\n";

/// A surface against the truth.
struct Judged {
    measured: Measured,
    certainty: Certainty,
}

/// Measures all kinds and writes the table, or prints those with one of the `wanted`, separated by commas, in their names.
pub(super) fn run(wanted: Option<&str>) -> Result<()> {
    let mut table = format!(
        "Covered: points of the wall that was seen within {COVERED_MM} mm of the surface.\n\n\
         | error | vessel | mean, mm: live | batch | live : batch | covered: live | batch | > 1 mm: live | batch | \
         within 1, 2, 3 s.e.: live | batch | spread: live | batch |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n"
    );
    for (name, kind) in kinds::named(wanted) {
        for (short, vessel, is_steady, seed) in RECORDINGS {
            let simulation = kinds::simulated(kind, vessel, insertion(is_steady), seed)?;
            let truth = Truth::new(simulation.vessel.surface().clone())?;
            let wall_mm = echoes_mm(&simulation.truth_recording);
            let live = judged(live_surface(&simulation.recording)?, &truth, &wall_mm)?;
            let batch = match Reconstructor::new(Settings::default()).run(&simulation.recording) {
                Ok(lumen) => judged(lumen.surface(), &truth, &wall_mm)?,
                Err(error) => {
                    println!("| {name} | {short} | refused: {error} |");
                    continue;
                }
            };
            let both = [&live, &batch];
            let [live_mm, batch_mm] = both.map(|judged| judged.measured.distances.mean_mm);
            let [covered, batch_covered] = both.map(|judged| 100.0 * judged.measured.covered);
            let [[far, shares, _], [batch_far, batch_shares, _]] =
                both.map(|judged| judged.certainty.cells());
            let [spread, batch_spread] = both.map(|judged| judged.certainty.spread());
            let row = format!(
                "| {name} | {short} | {live_mm:.3} | {batch_mm:.3} | {:.2} | {covered:.1} % | {batch_covered:.1} % | \
                 {far} | {batch_far} | {shares} | {batch_shares} | {spread:.2} | {batch_spread:.2} |\n",
                live_mm / batch_mm
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

/// The vessel after the last frame, as a host has it that takes one frame after the other.
fn live_surface(recording: &Recording) -> Result<Surface> {
    let mut live = Live::new(&Settings::default())?;
    for frame in &recording.frames {
        live.push(frame)?;
    }
    live.flush()?;
    Ok(live.surface())
}

fn judged(surface: Surface, truth: &Truth, wall_mm: &[DVec3]) -> Result<Judged> {
    let error_mm = evaluate(&surface, truth)?.error_mm;
    let certainty = Certainty::of(&surface, &error_mm);
    Ok(Judged { measured: measured(&surface, truth, wall_mm)?, certainty })
}
