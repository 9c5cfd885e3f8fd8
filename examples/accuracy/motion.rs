//! Vessels that breathe and beat: as they are reconstructed without regard to that, and in the state of the first frame.

use super::certainty::{Certainty, RECORDINGS, insertion};
use super::{kinds, replace_table};
use lumenmesh::Result;
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::reconstruction::{Lumen, Reconstructor};
use lumenmesh::recording::Recording;
use lumenmesh::settings::{MotionSettings, MotionState, Settings};
use lumenmesh::simulate::FaultKind;
use lumenmesh::sweep::Cycle;

const BEGIN: &str = "<!-- motion: written by `cargo run --release --example accuracy -- --motion` -->\n";
const END: &str = "<!-- motion: end -->\n";

/// What moves: the kinds of errors that it consists of.
const MOTIONS: [(&str, &[&str]); 6] = [
    ("none", &[]),
    ("breathing", &["breathing"]),
    ("heart-beat", &["heart-beat"]),
    ("pulsation", &["pulsation"]),
    ("breathing, heart-beat", &["breathing", "heart-beat"]),
    ("all three", &["breathing", "heart-beat", "pulsation"]),
];

/// Measures all motions and writes the table, or prints those with `wanted` in their names.
pub(super) fn run(wanted: Option<&str>) -> Result<()> {
    let mut table = String::from(
        "| motion | vessel | without: mean, mm | within 1, 2, 3 s.e. | `--motion 0`: mean, mm | within 1, 2, 3 s.e. | found |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for (name, names) in MOTIONS {
        if wanted.is_some_and(|part| !name.contains(part)) {
            continue;
        }
        for (short, vessel, is_steady, seed) in RECORDINGS {
            let of_motion = names.iter().filter_map(|name| FaultKind::named(name));
            let simulation = kinds::simulated(of_motion, vessel, insertion(is_steady), seed)?;
            let truth = Truth::new(simulation.vessel.surface().clone())?;
            let without = lumen(&simulation.recording, None)?;
            // The simulated vessel is at rest in the first frame.
            let at_rest = lumen(&simulation.recording, Some(MotionState::Phase(0.0)))?;
            let [without, with] = [judged(&without, &truth)?, judged(&at_rest, &truth)?];
            let cycles = at_rest.motion().map_or(&[][..], |motion| &motion.cycles);
            let found: Vec<String> = cycles.iter().map(found).collect();
            let found = if found.is_empty() { "-".into() } else { found.join("; ") };
            let row = format!("| {name} | {short} | {without} | {with} | {found} |\n");
            print!("{row}");
            table += &row;
        }
    }
    if wanted.is_none() {
        replace_table("", &table, BEGIN, END)?;
    }
    Ok(())
}

fn lumen(recording: &Recording, shown: Option<MotionState>) -> Result<Lumen> {
    let motion = MotionSettings::default().with_shown(shown);
    Reconstructor::new(Settings::default().with_motion(motion)).run(recording)
}

/// The mean distance to the truth, and the shares of nodes within some standard errors.
fn judged(lumen: &Lumen, truth: &Truth) -> Result<String> {
    let surface = lumen.surface();
    let evaluation = evaluate(&surface, truth)?;
    let [_, shares, _] = Certainty::of(&surface, &evaluation.error_mm).cells();
    Ok(format!("{:.3} | {shares}", evaluation.mesh_to_truth.mean_mm))
}

fn found(cycle: &Cycle) -> String {
    let mut found = format!("{:.4} ± {:.4} Hz", cycle.frequency_hz, cycle.frequency_standard_error_hz);
    if cycle.way_mm > 0.0 {
        found += &format!(", {:.2} ± {:.2} mm", cycle.way_mm, cycle.way_standard_error_mm);
    }
    if cycle.size_change > 0.0 {
        let [change, error] = [cycle.size_change, cycle.size_change_standard_error].map(|x| 100.0 * x);
        found += &format!(", {change:.1} ± {error:.1} %");
    }
    found
}
