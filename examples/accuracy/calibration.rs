//! Self-calibration: what is found of a wrong calibration, whether the standard errors hold, and what the wall gains.

use super::certainty::RECORDINGS;
use super::{kinds, replace_table};
use lumenmesh::Result;
use lumenmesh::evaluate::{Truth, evaluate};
use lumenmesh::reconstruction::{Lumen, Reconstructor};
use lumenmesh::settings::{Calibrate, Settings, SweepSettings};
use lumenmesh::simulate::{FaultKind, Insertion, SimulationSettings};
use lumenmesh::sweep::CalibrationParameter;

const BEGIN: &str =
    "<!-- calibration: written by `cargo run --release --example accuracy -- --calibration` -->\n";
const END: &str = "<!-- calibration: end -->\n";
const KINDS: [&str; 5] = ["none", "calibration-offset", "calibration-rotation", "sound-speed", "latency"];

/// Measures all vessels with the tip turned, and a steady catheter, and writes the table; or prints the rows with `wanted` in
/// their vessel's name or kind.
pub(super) fn run(wanted: Option<&str>) -> Result<()> {
    let mut table = String::from(
        "| vessel | error | what the calibration lacks | found | told | wall, mm | wall corrected, mm |\n|---|---|---|---|---|---|---|\n",
    );
    let mut scores: Vec<f64> = Vec::new();
    let turned = RECORDINGS.map(|(short, vessel, _, seed)| {
        (short.replace(", tip turned", ""), vessel, Insertion::default(), seed)
    });
    let steady = ("arch, steady".into(), "arch", Insertion::steady().with_speed_mm_s(2.4), 7);
    for (short, vessel, insertion, seed) in turned.into_iter().chain([steady]) {
        for kind in KINDS {
            if wanted.is_some_and(|part| !format!("{short} {kind}").contains(part)) {
                continue;
            }
            let row = row((&short, vessel), kind, &insertion, seed, &mut scores)?;
            print!("{row}");
            table += &row;
        }
    }
    let count = scores.len().max(1) as f64;
    let within =
        |errors: f64| 100.0 * scores.iter().filter(|score| score.abs() <= errors).count() as f64 / count;
    let said = format!(
        "Of {} estimates that are told, {:.0}, {:.0} and {:.0} % lie within one, two and three standard errors of the truth; the \
         root mean square of their distances from it is {:.2} standard errors, the largest {:.1}.\n",
        scores.len(),
        within(1.0),
        within(2.0),
        within(3.0),
        (scores.iter().map(|score| score * score).sum::<f64>() / count).sqrt(),
        scores.iter().fold(0.0, |most: f64, score| most.max(score.abs()))
    );
    print!("{said}");
    if wanted.is_none() {
        replace_table("", &format!("{table}\n{said}"), BEGIN, END)?;
    }
    Ok(())
}

/// What the calibration of a recording with that kind of error lacks, in the order and the units of the estimate.
fn lacks(settings: &SimulationSettings) -> [f64; 8] {
    let calibration = &settings.faults.calibration;
    // The inverse of a single error.
    let [x, y, z] = calibration.offset_mm.map(|mm| -mm);
    let [a, b, c] = calibration.rotation_deg.map(|deg| -deg);
    [x, y, z, a, b, c, 100.0 * (1.0 / calibration.sound_speed - 1.0), settings.noise.latency_s]
}

fn row(
    (short, vessel): (&str, &str),
    kind: &str,
    insertion: &Insertion,
    seed: u64,
    scores: &mut Vec<f64>,
) -> Result<String> {
    let fault = FaultKind::named(kind);
    let (simulation, settings) = kinds::simulated_with(fault, vessel, insertion.clone(), seed)?;
    let truth = Truth::new(simulation.vessel.surface().clone())?;
    let reconstructed = |calibrate: Calibrate| -> Result<(f64, Lumen)> {
        let sweep = SweepSettings::default().with_calibrate(calibrate);
        let lumen = Reconstructor::new(Settings::default().with_sweep(sweep)).run(&simulation.recording)?;
        Ok((evaluate(&lumen.surface(), &truth)?.mesh_to_truth.mean_mm, lumen))
    };
    let (before_mm, _) = reconstructed(Calibrate::Off)?;
    let (after_mm, lumen) = reconstructed(Calibrate::Apply)?;
    let Some(found) = lumen.calibration() else { return Ok(String::new()) };
    let (mut lacking, mut told) = (Vec::new(), Vec::new());
    for (parameter, truth) in found.parameters.iter().zip(lacks(&settings)) {
        let CalibrationParameter { name, unit, estimate, standard_error, told: is_told, correction, .. } =
            *parameter;
        if is_told {
            scores.push((estimate - truth) / standard_error);
        }
        if truth != 0.0 {
            lacking.push(format!("{name} {truth:+.2} {unit}"));
        }
        if correction != 0.0 {
            told.push(format!(
                "{name} {estimate:+.2} ± {standard_error:.2}, corrected {correction:+.2} {unit}"
            ));
        } else if truth != 0.0 && is_told {
            told.push(format!("{name} {estimate:+.2} ± {standard_error:.2} {unit}"));
        } else if truth != 0.0 {
            told.push(format!("{name} not told (± {standard_error:.2} {unit})"));
        }
    }
    let count = found.parameters.iter().filter(|parameter| parameter.told).count();
    let or_nothing = |cells: &[String]| if cells.is_empty() { "nothing".into() } else { cells.join("; ") };
    Ok(format!(
        "| {short} | {kind} | {} | {} | {count} | {before_mm:.3} | {after_mm:.3} |\n",
        or_nothing(&lacking),
        or_nothing(&told)
    ))
}
