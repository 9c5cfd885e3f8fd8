use super::reconstruct::print_left_out;
use super::settings::SettingsArguments;
use super::space::SpaceArgument;
use super::{Shown, print_json, progress, refuse_inputs};
use crate::reconstruction::{Live, Times, Work};
use crate::recording::{FRAME_INTERVAL_S, Finding, LeftOut, Screening};
use crate::settings::Settings;
use crate::{Error, Result, surface};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Replay a recording frame by frame into a growing vessel and report the time of each frame
///
/// As a program would do that shows the vessel during the intervention: every frame updates the mesh.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  lumenmesh replay pullback.mat -o vessel.vtp
  lumenmesh replay pullback.mat -o vessel.vtp --method sweep
  lumenmesh replay pullback.mat -o vessel.vtp --method sweep --half-life 30 --real-time
  lumenmesh replay pullback.mat -o vessel.vtp --json | jq .push_ms.p99")]
pub(super) struct Arguments {
    /// Recording: a MATLAB .mat file (v4 to v7.3), a folder of CSV files or a sequence file (.igs.mha, .igs.nrrd, …)
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Mesh to write after the last frame: .vtp, .ply, .stl, .obj or .mat
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    #[command(flatten)]
    space: SpaceArgument,
    /// Wait for each frame's time; 12 frames per second where they have none
    #[arg(long)]
    real_time: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: SettingsArguments,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary<'a> {
    recording: Shown<'a>,
    mesh: Shown<'a>,
    settings: &'a Settings,
    frames: usize,
    /// Frames that were left out, and why, in the order in which that was found.
    left_out: Vec<LeftOut>,
    /// Frames at which the vessel began anew.
    restarts: Vec<usize>,
    /// What is suspicious about the recording as a whole.
    suspicions: Vec<Finding>,
    /// Frames too far from the vessel's axis to be used.
    off_axis: usize,
    /// The first frame with a vessel.
    first_frame: Option<usize>,
    push_ms: Percentiles,
    /// The same of each stage.
    stages_ms: Stages,
    /// The longest time of a frame.
    most_work: Work,
    /// Rings after each tenth of the frames.
    rings: Vec<usize>,
    nodes: usize,
    triangles: usize,
}

#[derive(Serialize)]
struct Percentiles {
    p50: f64,
    p95: f64,
    p99: f64,
    max: f64,
}

impl Percentiles {
    /// By nearest rank.
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let rank = (share * values.len() as f64).ceil() as usize;
            values.get(rank.max(1) - 1).copied().unwrap_or(0.0)
        };
        Self { p50: rank(0.5), p95: rank(0.95), p99: rank(0.99), max: rank(1.0) }
    }
}

/// What a frame's time consists of.
#[derive(Serialize)]
struct Stages {
    screening: Percentiles,
    axis: Percentiles,
    placing: Percentiles,
    solving: Percentiles,
}

impl Stages {
    fn of(times: &[Times]) -> Self {
        let each =
            |of: fn(&Times) -> f64| Percentiles::of(times.iter().map(|times| of(times) * 1e3).collect());
        Self {
            screening: each(|times| times.screening_s),
            axis: each(|times| times.axis_s),
            placing: each(|times| times.placing_s),
            solving: each(|times| times.solving_s),
        }
    }
}

impl Arguments {
    pub(super) fn run(self) -> Result<()> {
        let settings = self.settings.settings()?;
        surface::check_ending(&self.output)?;
        refuse_inputs(
            [Some(&*self.output)],
            [Some(&*self.recording)].into_iter().chain(self.settings.inputs()),
        )?;
        let recording = self.settings.read(&self.recording)?;
        let mut live = Live::new(&settings)?;
        let frames = &recording.frames;
        let (mut left_out, mut restarts, mut times, mut rings) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut first_frame, mut most_work, mut off_axis) = (None, Work::default(), 0);
        let bar = progress::bar("playing frames", frames.len());
        let start = Instant::now();
        let mut due_s = 0.0;
        for (k, frame) in frames.iter().enumerate() {
            if self.real_time {
                std::thread::sleep(Duration::from_secs_f64(due_s).saturating_sub(start.elapsed()));
                let next = frames.get(k + 1).and_then(|next| Some(next.time_s? - frame.time_s?));
                due_s +=
                    next.filter(|s| s.is_finite()).unwrap_or(FRAME_INTERVAL_S).clamp(0.0, LONGEST_WAIT_S);
            }
            let change = live.push(frame).map_err(|e| e.in_file(&self.recording))?;
            times.push(change.times);
            off_axis += usize::from(change.off_axis);
            if change.restarted {
                restarts.push(k);
                first_frame = None;
            }
            first_frame = first_frame.or((change.rings > 0).then_some(k));
            most_work.echoes = most_work.echoes.max(change.work.echoes);
            most_work.rings = most_work.rings.max(change.work.rings);
            left_out.extend(change.left_out);
            if (k + 1) * 10 / frames.len() > k * 10 / frames.len() {
                rings.push(live.rings());
            }
            bar.inc(1);
        }
        left_out.extend(live.flush().map_err(|e| e.in_file(&self.recording))?.left_out);
        left_out.iter_mut().for_each(|one| one.name(&recording));
        bar.finish_and_clear();
        let vessel = live.surface();
        if vessel.triangles.is_empty() {
            return Err(Error::input(
                &self.recording,
                "frames",
                format!("{} that show no vessel", frames.len()),
                "contours along a vessel",
            ));
        }
        self.space.write(&vessel, &self.output)?;
        let summary = Summary {
            recording: Shown(&self.recording),
            mesh: Shown(&self.output),
            settings: &settings,
            frames: frames.len(),
            left_out,
            restarts,
            suspicions: Screening::of(&settings.conventions.apply(&recording)).suspicions,
            off_axis,
            first_frame,
            push_ms: Percentiles::of(times.iter().map(|times| times.total_s * 1e3).collect()),
            stages_ms: Stages::of(&times),
            most_work,
            rings,
            nodes: vessel.nodes_mm.len(),
            triangles: vessel.triangles.len(),
        };
        if self.json {
            return print_json(&summary);
        }
        summary.print();
        Ok(())
    }
}

/// Longest wait for a frame, s: gaps in the recording's times are shortened to it.
const LONGEST_WAIT_S: f64 = 5.0;

impl Summary<'_> {
    fn print(&self) {
        let Percentiles { p50, p95, p99, max } = self.push_ms;
        println!(
            "frames     {}, {} left out, {} too far from the axis",
            self.frames,
            self.left_out.len(),
            self.off_axis
        );
        print_left_out(&self.left_out);
        for frame in &self.restarts {
            println!(
                "           the vessel began anew at frame {frame}: those before lie off the path of the others"
            );
        }
        self.suspicions.iter().for_each(|finding| print!("{finding}"));
        if let Some(frame) = self.first_frame {
            println!(
                "vessel     from frame {frame} on; {} nodes, {} triangles in the end",
                self.nodes, self.triangles
            );
        }
        let rings: Vec<String> = self.rings.iter().map(usize::to_string).collect();
        println!("rings      {} after each tenth of the frames", rings.join(", "));
        println!(
            "a frame    {p50:.2} ms in the median, 95 % {p95:.2}, 99 % {p99:.2}, the longest {max:.2} ms"
        );
        let Stages { screening, axis, placing, solving } = &self.stages_ms;
        println!(
            "           of which at 99 %: screening {:.2}, axis {:.2}, placing {:.2}, solving {:.2} ms",
            screening.p99, axis.p99, placing.p99, solving.p99
        );
        println!(
            "at most    {} echoes looked at and {} rings computed for a frame",
            self.most_work.echoes, self.most_work.rings
        );
        println!("mesh       {}", self.mesh.display());
    }
}
