use super::settings::SettingsArguments;
use super::space::SpaceArgument;
use super::{Shown, print_json, progress, refuse_inputs};
use crate::anatomy::{VesselTree, check_axis_ending};
use crate::branching::{BranchesReport, CylinderBranchesReport, Dismissed, Mouth};
use crate::cylinders::{CylindersReport, write_cylinders};
use crate::engine::EngineDescription;
use crate::reconstruction::{Lumen, LumenReport, Reconstructor, Summary};
use crate::recording::{Cleaning, LeftOut, Recording, Screening};
use crate::settings::{Calibrate, Method, Settings};
use crate::surface::{self, Topology};
use crate::sweep;
use crate::{Error, Result};
use glam::DVec3;
use serde::Serialize;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// Turn a recording into a lumen mesh
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh reconstruct pullback.mat -o vessel.vtp
  lumenmesh reconstruct pullback.mat -o vessel.vtp --sweep-nodes 128 --keep-unsupported
  lumenmesh reconstruct pullback.mat -o vessel.stl --config settings.toml --json > report.json
  lumenmesh reconstruct pullback.mat -o vessel.vtp --axis axis.vtp
  lumenmesh reconstruct pullback.mat -o vessel.vtp --correct-poses --estimate-offset
  lumenmesh reconstruct pullback.mat -o vessel.vtp --calibrate apply
  lumenmesh reconstruct recording/ -o vessel.vtp --quaternion wxyz --units m
  lumenmesh reconstruct recording/ -o vessel.ply --method cylinders --nodes 24 --levels 8
  lumenmesh reconstruct pullback.mat -o vessel.vtp --method cylinders --cylinders cylinders.csv")]
pub(super) struct Arguments {
    /// Recording: a MATLAB .mat file (v4 to v7.3), a folder of CSV files or a sequence file (.igs.mha, .igs.nrrd, …)
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Mesh to write: .vtp, .ply, .stl or .obj
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    #[command(flatten)]
    space: SpaceArgument,
    /// Also write every deformed cylinder, iteration by iteration, as CSV
    #[arg(long, value_name = "CSV")]
    cylinders: Option<PathBuf>,
    /// Also write the vessel's axis, as polylines that VMTK and ParaView read: .vtp
    #[arg(long, value_name = "VTP")]
    axis: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: SettingsArguments,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Output<'a> {
    recording: Shown<'a>,
    mesh: Shown<'a>,
    #[serde(flatten)]
    summary: Summary<'a>,
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let settings = self.settings.settings()?;
        if self.cylinders.is_some() && settings.method != Method::Cylinders {
            return Err(Error::Setting {
                name: "method".into(),
                found: "sweep".into(),
                expected: "cylinders, where --cylinders asks for them".into(),
            });
        }
        surface::check_ending(&self.output)?;
        self.axis.as_deref().map_or(Ok(()), check_axis_ending)?;
        refuse_inputs(
            [Some(&*self.output), self.cylinders.as_deref(), self.axis.as_deref()],
            [Some(&*self.recording)].into_iter().chain(self.settings.inputs()),
        )?;
        let recording = self.settings.read(&self.recording)?;
        let lumen =
            lumen(&recording, &settings, self.cylinders.is_some()).map_err(|e| e.in_file(&self.recording))?;
        if let Some(path) = &self.cylinders {
            write_cylinders(lumen.fitted_cylinders(), path)?;
        }
        let surface = lumen.surface();
        self.space.write(&surface, &self.output)?;
        if let Some(path) = &self.axis {
            VesselTree::of_lumen(&lumen, &surface)?.write(&surface, path, self.space.name())?;
        }
        let report = lumen.report();
        if self.json {
            let (recording, mesh) = (Shown(&self.recording), Shown(&self.output));
            return print_json(&Output { recording, mesh, summary: lumen.summary() });
        }
        print_report(report);
        if let Some(calibration) = lumen.calibration() {
            print_calibration(calibration, lumen.settings().sweep.calibrate == Calibrate::Apply);
        }
        lumen.motion().into_iter().for_each(print_motion);
        print_mouths(lumen.mouths());
        print_screening(lumen.screening());
        println!("mesh       {}", self.output.display());
        if let Some(path) = &self.axis {
            println!("axis       {}", path.display());
        }
        if let Some(path) = &self.cylinders {
            println!("cylinders  {}", path.display());
        }
        Ok(())
    }
}

/// What a screening found, for people.
pub(super) fn print_screening(screening: &Screening) {
    print_cleaning(&screening.cleaning);
    let left_out = &screening.left_out;
    if !left_out.is_empty() {
        println!(
            "left out   {} of {} frames (--strict refuses such a recording, --keep uses them where they have numbers)",
            left_out.len(),
            screening.frames
        );
    }
    print_left_out(left_out);
    screening.suspicions.iter().for_each(|finding| print!("{finding}"));
}

/// What was done to the points of contours, for people.
pub(super) fn print_cleaning(cleaning: &Cleaning) {
    for (label, found) in cleaning.lines() {
        println!("{label:<11}{found}");
    }
}

/// The first ten runs of these frames, and why they are left out.
pub(super) fn print_left_out(left_out: &[LeftOut]) {
    const LISTED: usize = 10;
    let runs = LeftOut::runs(left_out);
    for run in runs.iter().take(LISTED) {
        println!("           {}: {}: {}", LeftOut::frames_of(run), run[0].field, run[0].found);
    }
    let more: usize = runs.iter().skip(LISTED).map(|run| run.len()).sum();
    if more > 0 {
        println!("           and {more} more");
    }
}

/// Reconstructs with a progress bar.
pub(super) fn lumen(recording: &Recording, settings: &Settings, history: bool) -> Result<Lumen> {
    let bar = progress::bar("reconstructing", 0);
    let lumen = Reconstructor::new(settings.clone())
        .history(history)
        .on_progress(|progress| {
            bar.set_message(progress.stage);
            bar.set_length(progress.total as u64);
            bar.set_position(progress.done as u64);
            ControlFlow::Continue(())
        })
        .run(recording);
    bar.finish_and_clear();
    if let Err(Error::Frame { .. } | Error::Recording { .. }) = &lumen {
        // What is suspicious may be why.
        let screening = Screening::of(&settings.conventions.apply(recording));
        screening.suspicions.iter().for_each(|finding| eprint!("{finding}"));
    }
    lumen
}

/// The report for people.
pub(super) fn print_report(report: LumenReport) {
    match report {
        LumenReport::Cylinders(report) => print_cylinders(report),
        LumenReport::CylinderBranches(report) => print_cylinder_branches(report),
        LumenReport::Sweep(report) => print_sweep(report),
        LumenReport::Branches(report) => print_branches(report),
    }
}

/// The report of a sweep for people.
fn print_sweep(report: &sweep::SweepReport) {
    let sweep::SweepReport { seconds, .. } = report;
    println!("method     sweep");
    print_engine(&report.engine, report.threads);
    print!("frames     {}", report.frames);
    match report.folded_frames[..] {
        [] => println!(),
        [first, ..] => println!(
            ", {} left out: their contours turn back about their centres (the first is frame {first})",
            report.folded_frames.len()
        ),
    }
    println!(
        "axis       {:.1} mm long, contours of {:.2} mm radius",
        report.length_mm, report.contour_radius_mm
    );
    println!(
        "echoes     {} recorded, {} missing, {} off the wall, {} beyond the ends",
        report.echoes, report.missing, report.off_wall, report.beyond_ends
    );
    println!(
        "noise      {:.3} mm across the wall, {:.3} mm along it; smoothed by {:.3} mm²",
        report.noise_mm, report.tangential_noise_mm, report.smoothness_mm2
    );
    if let Some(errors) = &report.errors {
        print_errors(errors);
    }
    println!(
        "vessel     {} rings, {} nodes, {} of them supported; {} iterations, {} solver steps",
        report.rings, report.nodes, report.supported, report.iterations, report.solver_steps
    );
    if !report.converged {
        println!("           the fit has not converged within its limit of iterations and steps");
    }
    if let Some(tracker) = &report.tracker {
        print_tracker(tracker);
    }
    print!(
        "time       {:.1} ms axis, {:.1} ms placing echoes, {:.1} ms fitting, ",
        seconds.axis * 1e3,
        seconds.place * 1e3,
        seconds.fit * 1e3
    );
    if report.tracker.is_some() {
        print!("{:.1} ms correcting poses, ", seconds.tracker * 1e3);
    }
    println!(
        "{:.1} ms estimating errors and fitting again, {:.1} ms weighing support",
        seconds.errors * 1e3,
        seconds.support * 1e3
    );
}

/// The report of a vessel that branches for people.
fn print_branches(report: &BranchesReport) {
    println!("method     sweep of {} branches", report.branches.len());
    if let Some(first) = report.branches.first() {
        print_engine(&first.sweep.engine, first.sweep.threads);
    }
    print_frames(report.frames, &report.frames_left_out);
    for (number, branch) in report.branches.iter().enumerate() {
        let sweep = &branch.sweep;
        print_branch(number, branch.parent, branch.parting_mm, &branch.reason);
        println!(
            "           {:.1} mm long, contours of {:.2} mm radius; {} frames, {} echoes, {} off the wall; noise {:.3} mm",
            sweep.length_mm,
            sweep.contour_radius_mm,
            sweep.frames,
            sweep.echoes,
            sweep.off_wall,
            sweep.noise_mm
        );
        if !sweep.converged {
            println!("           the fit has not converged within its limit of iterations and steps");
        }
        if let Some(errors) = &sweep.errors {
            print_errors(errors);
        }
        if let Some(tracker) = &sweep.tracker {
            print_tracker(tracker);
        }
    }
    print_dismissed(&report.dismissed);
    print_joined(report.nodes, report.supported, report.topology, report.unsewn);
    let seconds = report.seconds;
    println!(
        "time       {:.1} ms finding the branches, {:.1} ms sweeping them, {:.1} ms joining, {:.1} ms fitting where they meet",
        seconds.tree * 1e3,
        seconds.branches * 1e3,
        seconds.join * 1e3,
        seconds.fit * 1e3
    );
}

/// The report of a vessel of cylinders that branches for people.
fn print_cylinder_branches(report: &CylinderBranchesReport) {
    println!("method     cylinders in {} branches", report.branches.len());
    if let Some(first) = report.branches.first() {
        print_engine(&first.cylinders.engine, first.cylinders.threads);
    }
    print_frames(report.frames, &report.frames_left_out);
    for (number, branch) in report.branches.iter().enumerate() {
        print_branch(number, branch.parent, branch.parting_mm, &branch.reason);
        println!("           {:.1} mm long", branch.length_mm);
        print_fits(&branch.cylinders);
    }
    print_dismissed(&report.dismissed);
    print_joined(report.nodes, report.supported, report.topology, report.unsewn);
    if report.tunnels() > 0 || report.crossings > 0 {
        println!(
            "           {} tunnels and {} pairs of triangles that cross: branches touch again beside their parting",
            report.tunnels(),
            report.crossings
        );
    }
    let seconds = report.seconds;
    println!(
        "time       {:.1} ms finding the branches, {:.1} ms for their cylinders, {:.1} ms joining, {:.1} ms fitting where they meet",
        seconds.tree * 1e3,
        seconds.branches * 1e3,
        seconds.join * 1e3,
        seconds.fit * 1e3
    );
}

/// The number of frames, and those that belong to no branch.
fn print_frames(frames: usize, left_out: &[usize]) {
    print!("frames     {frames}");
    match left_out {
        [] => println!(),
        [first, ..] => println!(
            ", {} left out: their contours turn back about their centres or enclose no area (the first is frame {first})",
            left_out.len()
        ),
    }
}

/// Where a branch was entered, and why it is taken for one.
fn print_branch(number: usize, parent: Option<usize>, parting_mm: Option<DVec3>, reason: &str) {
    match (parent, parting_mm) {
        (Some(parent), Some(at)) => {
            println!(
                "branch {number:<4}entered from branch {parent} at ({:.1}, {:.1}, {:.1}) mm",
                at.x, at.y, at.z
            );
            println!("           {reason}");
        }
        _ => println!("branch {number:<4}{reason}"),
    }
}

/// What looked like a branch and is none.
fn print_dismissed(dismissed: &[Dismissed]) {
    for Dismissed { tip_mm: at, depth_mm, frames, reason, .. } in dismissed {
        println!(
            "no branch  at ({:.1}, {:.1}, {:.1}) mm, {depth_mm:.1} mm beyond the wall, {frames} frames: {reason}",
            at.x, at.y, at.z
        );
    }
}

/// The surface of joined branches.
fn print_joined(nodes: usize, supported: usize, topology: Topology, unsewn: usize) {
    println!(
        "vessel     {nodes} nodes, {supported} of them supported; {} part{}, {} openings",
        topology.components,
        if topology.components == 1 { "" } else { "s" },
        topology.boundary_loops
    );
    if unsewn > 0 {
        println!("           open at {unsewn} rings near partings, which could not be joined");
    }
}

/// The mouths of branches that were seen but not entered.
pub(super) fn print_mouths(mouths: &[Mouth]) {
    for mouth in mouths {
        let (at, to) = (mouth.centre_mm, mouth.direction);
        println!(
            "mouth      at ({:.1}, {:.1}, {:.1}) ± {:.1} mm in branch {}, {:.0} ± {:.0} mm²; not entered",
            at.x,
            at.y,
            at.z,
            mouth.centre_standard_error_mm,
            mouth.branch,
            mouth.area_mm2,
            mouth.area_standard_error_mm2
        );
        println!(
            "           leads to ({:.2}, {:.2}, {:.2}) ± {:.0}°, seen {:.1} mm deep in {} frames",
            to.x, to.y, to.z, mouth.direction_standard_error_deg, mouth.depth_mm, mouth.frames
        );
    }
}

/// Errors of the tracker.
fn print_errors(errors: &sweep::RecordingErrors) {
    print!("errors     {:.3} mm of each echo for itself", errors.rays_mm);
    for shift in &errors.shifts {
        print!("; frames shifted by {:.3} mm an axis{}", shift.sd_mm, forgotten(shift.correlation_s));
    }
    for contour in &errors.contours {
        let width_deg = contour.width_deg.unwrap_or(0.0);
        print!(
            "; contours off by {:.3} mm over {width_deg:.0}°{}",
            contour.sd_mm,
            forgotten(contour.correlation_s)
        );
    }
    for beat in &errors.beats {
        let what = if beat.is_shift { "frames shifted an axis" } else { "the lumen's radius changed" };
        print!("; {what} by {:.3} mm at {:.2} Hz", beat.sd_mm, beat.frequency_hz);
    }
    println!();
    if let Some(corrected) = errors.corrected {
        println!(
            "           {} frames moved by {:.3} mm an axis (root mean square): their shifts against those about them",
            corrected.frames, corrected.rms_mm
        );
    }
    if let Some(mm) = errors.rest_mm() {
        println!(
            "           the wall is that of the mean place; at the ends of the beat it lies {mm:.3} mm an axis beside"
        );
    }
    println!(
        "           errors that stay the same for longer than {:.1} s do not show: so long was a place seen (median)",
        errors.seen_for_s
    );
    println!("           the wall is as rough as {:.3}, measured as --roughness is", errors.roughness);
}

/// The motion of the vessel.
fn print_motion(motion: &sweep::Motion) {
    let sweep::Motion { cycles, noise_before_mm, noise_mm, .. } = motion;
    let frames = format!("{} frames of the window of phases are used", motion.frames);
    if cycles.is_empty() && motion.shown.is_none() {
        println!("motion     {frames}");
        return;
    }
    if cycles.is_empty() {
        println!("motion     none that is significant: the vessel is as without --motion");
        return;
    }
    for (number, cycle) in cycles.iter().enumerate() {
        let sweep::Cycle { frequency_hz, frequency_standard_error_hz, .. } = cycle;
        print!("{}", if number == 0 { "motion     " } else { "           " });
        print!("at {frequency_hz:.4} ± {frequency_standard_error_hz:.4} Hz");
        if cycle.way_mm > 0.0 {
            print!(", over {:.2} ± {:.2} mm", cycle.way_mm, cycle.way_standard_error_mm);
        }
        if cycle.size_change > 0.0 {
            let [change, error] = [cycle.size_change, cycle.size_change_standard_error].map(|x| 100.0 * x);
            print!(", radius by {change:.1} ± {error:.1} %");
        }
        println!("; rests longest at phase {:.2}", cycle.rest_phase);
        if motion.shown.is_some() {
            println!(
                "           the farthest of its states is {:.2} mm and {:.1} % of the radius from the one that is shown",
                cycle.farthest_mm,
                100.0 * cycle.largest_difference
            );
        }
    }
    match motion.shown {
        Some(state) => {
            let [x, y, z] = motion.place_standard_error_mm;
            println!(
                "           shown at {state}; standard errors of the place ({x:.3}, {y:.3}, {z:.3}) mm, of the radius {:.2} %",
                100.0 * motion.size_standard_error
            );
            println!("           noise of {noise_before_mm:.3} mm with the motion, {noise_mm:.3} mm without");
        }
        None => println!("           {frames}"),
    }
}

/// How long errors stay alike.
fn forgotten(correlation_s: f64) -> String {
    if correlation_s > 0.0 { format!(", alike for {correlation_s:.2} s") } else { String::new() }
}

fn print_tracker(tracker: &sweep::Tracker) {
    let sweep::Tracker { noise_mm, shift_mm, turn_deg, .. } = tracker;
    print!("tracker    noise of {noise_mm:.3} mm an axis; {shift_mm:.3} mm and {turn_deg:.3}° ");
    // An offset alone leaves the poses as they are.
    let done = tracker.poses_corrected || *shift_mm == 0.0;
    println!(
        "{} (root mean square)",
        if done {
            "taken off"
        } else {
            "estimated, not taken off: implausible, or not confirmed by rays held out"
        }
    );
    if let (Some(offset_s), Some(error_s)) = (tracker.offset_s, tracker.offset_standard_error_s) {
        let done =
            if tracker.offset_corrected { "corrected" } else { "left: not significant, or implausible" };
        println!("           poses {offset_s:.4} ± {error_s:.4} s older than contours: {done}");
    }
}

/// What a calibration lacks, and what of it was corrected.
fn print_calibration(calibration: &sweep::SelfCalibration, apply: bool) {
    println!(
        "calibrate  {}",
        match calibration.mirror {
            Some(sweep::Mirror::No) => "images are not mirrored",
            Some(sweep::Mirror::Y) => "images are mirrored: y stands for -y",
            Some(sweep::Mirror::X) => "images are mirrored: x stands for -x",
            None => "whether images are mirrored cannot be told from this recording",
        }
    );
    for parameter in &calibration.parameters {
        let sweep::CalibrationParameter { name, unit, estimate, standard_error, told, correction, .. } =
            *parameter;
        if !told {
            println!("           {name}: cannot be told from this recording");
            continue;
        }
        print!("           {name} {estimate:+.3} ± {standard_error:.3} {unit} from the calibration: ");
        match (correction != 0.0, apply) {
            (false, _) => println!("not significant"),
            (true, true) => println!("corrected by {correction:+.3} {unit}"),
            (true, false) => println!("--calibrate apply corrects {correction:+.3} {unit}"),
        }
    }
    if !calibration.converged {
        println!("           the estimate has not converged, and nothing is corrected");
    }
}

/// The engine, and the reason where it was chosen automatically.
pub(super) fn print_engine(engine: &EngineDescription, threads: usize) {
    match &engine.adapter {
        Some(adapter) => println!("engine     {} on {adapter}", engine.name),
        None => println!("engine     {} on {threads} threads", engine.name),
    }
    if let Some(why) = &engine.why {
        println!("           chosen because {why}");
    }
}

/// The report of cylinders for people.
fn print_cylinders(report: &CylindersReport) {
    let CylindersReport { seconds, .. } = report;
    print_engine(&report.engine, report.threads);
    print_fits(report);
    println!("vessel     {} rings, {} nodes, {} triangles", report.rings, report.nodes, report.triangles);
    println!(
        "time       {:.1} ms placing frames, {:.1} ms fitting, {:.1} ms merging",
        seconds.track * 1e3,
        seconds.fit * 1e3,
        seconds.merge * 1e3
    );
}

/// The cylinders that were fitted, and to what.
fn print_fits(report: &CylindersReport) {
    let CylindersReport { points, .. } = report;
    print!("frames     {}, {} cylinders fitted", report.frames, report.cylinders);
    match report.estimated_cylinders {
        0 => println!(),
        n => println!(", {n} cylinder models estimated (the recording has none)"),
    }
    if !report.cylinders_left_out.is_empty() {
        println!("           {} of the cylinders left out:", report.cylinders_left_out.len());
        print_left_out(&report.cylinders_left_out);
    }
    println!("echoes     {} recorded, {} missing", points.recorded, points.missing);
    println!(
        "fitted to  {} points, {} rejected as outliers, {} outside the gate (summed over the cylinders)",
        points.used, points.rejected, points.gated
    );
    let travel: Vec<String> = report.mean_travel_mm.iter().map(|t| format!("{t:.3}")).collect();
    println!("travel     {} mm (mean |travel| of a node, iteration by iteration)", travel.join(", "));
}
