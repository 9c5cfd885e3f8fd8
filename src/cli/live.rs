use super::messages::MessageArguments;
use super::reconstruct::{print_cleaning, print_engine, print_left_out};
use super::settings::{SettingsArguments, hidden_if_not_live};
use super::space::SpaceArgument;
use super::{Shown, interrupt, print_json, progress, refuse_inputs};
use crate::engine::EngineDescription;
use crate::openigtlink::{self, Counts, Server, SharedCounts};
use crate::reconstruction::{Live, Work};
use crate::recording::{Cleaning, Finding, LeftOut, Recording, Screening};
use crate::settings::Settings;
use crate::stream::{
    ArrivalsReport, End, Ended, Faults, Files, FrameLog, Outcome, PageServer, Percentiles, Queue, Recorded,
    Sink, Slicer, Source, Stages, TimesReport, WhenFull, connect, listen, peak_memory_bytes, read_lines, run,
    take_messages,
};
use crate::surface::Surface;
use crate::{Error, Result, surface};
use serde::Serialize;
use std::io::BufReader;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Reconstruct while frames come, and show the vessel as it grows
///
/// Frames come from a recording at its own pace, by OpenIGTLink, or as JSON, one frame per line (docs/live.md):
/// {"time_s": 1.25, "pose": [16 numbers, row by row, mm] or null, "contour": [[x, y], …] in mm, null where
/// there is no echo}.
///
/// Frames are taken in the order in which they come. A line that is no frame is skipped, counted and told.
/// Where frames of a network come faster than they can be taken, the oldest one that waits is dropped and
/// counted; recordings and pipes wait.
///
/// Ctrl-C ends in order: mesh, snapshot and summary are written. Exit status: 0 done, 1 the work failed, 2 the
/// usage is wrong, 3 done, but lines were skipped, 130 (or 143) ended by Ctrl-C (or by SIGTERM).
#[derive(clap::Args)]
#[command(mut_args = hidden_if_not_live)]
#[command(after_help = "Examples:
  lumenmesh live pullback.mat --view --hold                          # watch it in a browser, at its own pace
  lumenmesh live pullback.mat --speed 4 -o vessel.vtp --save-every 5s --log frames.csv
  my_tracker | lumenmesh live - -o vessel.vtp --finish               # in the end, the mesh of all frames at once
  lumenmesh live --listen 7000 --view -o vessel.vtp --save-every 5s --snapshot vessel.state
  lumenmesh live --listen 7000 --view -o vessel.vtp --save-every 5s --snapshot vessel.state --resume
  lumenmesh live --igtl-connect 127.0.0.1:18944 --igtl-serve 18945 --view   # from PLUS, to 3D Slicer and a browser
  lumenmesh import recording pullback.mat -o pullback.ndjson && lumenmesh live - -o vessel.vtp < pullback.ndjson")]
pub(super) struct Arguments {
    /// Recording: a .mat file, a folder of CSV files, a sequence or .ndjson file; or - for frames as JSON from
    /// a pipe
    #[arg(value_name = "REC", required_unless_present_any = ["listen", "connect", "igtl_connect", "igtl_listen"])]
    #[arg(conflicts_with_all = ["listen", "connect", "igtl_connect", "igtl_listen"])]
    recording: Option<PathBuf>,
    /// Wait on this port for programs that send frames as JSON; of this machine only, unless an IP address says
    /// otherwise
    #[arg(long, value_name = "[IP:]PORT", value_parser = address)]
    #[arg(conflicts_with_all = ["connect", "igtl_connect", "igtl_listen"])]
    listen: Option<SocketAddr>,
    /// End with the first connection, instead of waiting for the next
    #[arg(long)]
    once: bool,
    /// Connect to a program that sends frames as JSON, and end with the connection
    #[arg(long, value_name = "HOST:PORT", conflicts_with_all = ["igtl_connect", "igtl_listen"])]
    connect: Option<String>,
    /// Connect to a server of OpenIGTLink, such as PLUS, for poses and contours; may be given several times
    #[arg(long, value_name = "HOST:PORT")]
    igtl_connect: Vec<String>,
    /// Wait on this port for clients of OpenIGTLink that send poses and contours; they get the vessel too
    #[arg(long, value_name = "[IP:]PORT")]
    igtl_listen: Option<String>,
    /// How many times faster than it was recorded a recording is played, or max [default: 1]
    #[arg(long, value_name = "X", value_parser = speed, requires = "recording")]
    speed: Option<Speed>,
    /// Frames that may wait to be taken
    #[arg(long, value_name = "FRAMES", default_value_t = 64)]
    queue: usize,
    /// Let a program that sends faster than frames can be taken wait, rather than drop its oldest frame
    #[arg(long)]
    no_drop: bool,
    /// Mesh to write after the last frame: .vtp, .ply, .stl, .obj or .mat
    #[arg(short, long, value_name = "MESH")]
    output: Option<PathBuf>,
    #[command(flatten)]
    space: SpaceArgument,
    /// Write the mesh, and the snapshot, also while frames come, this often, such as 5s or 500ms
    #[arg(long, value_name = "TIME", value_parser = duration)]
    save_every: Option<Duration>,
    /// Write the state to this file, every 5 s unless --save-every says otherwise, so that another run can go
    /// on from there
    #[arg(long, value_name = "FILE")]
    snapshot: Option<PathBuf>,
    /// Go on from the snapshot. Frames of a recording that it has seen are passed over
    #[arg(long, requires = "snapshot")]
    resume: bool,
    /// Write a line for each frame: .csv or .ndjson
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Serve a page that shows the vessel as it grows, to browsers of this machine [default port: 8037]
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8037")]
    view: Option<u16>,
    /// Serve the vessel and the catheter's tip by OpenIGTLink on this port, such as to 3D Slicer
    #[arg(long, value_name = "[IP:]PORT")]
    igtl_serve: Option<String>,
    /// After the last frame, go on serving the page until Ctrl-C
    #[arg(long, requires = "view")]
    hold: bool,
    /// After the last frame, reconstruct from all frames at once, as lumenmesh reconstruct does
    #[arg(long)]
    finish: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    messages: MessageArguments,
    #[command(flatten)]
    settings: SettingsArguments,
}

/// How fast a recording is played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Speed {
    /// So many times faster than it was recorded.
    Times(f64),
    /// As fast as frames are taken.
    Max,
}

fn speed(text: &str) -> Result<Speed, String> {
    match text.parse() {
        _ if text == "max" => Ok(Speed::Max),
        Ok(times) if (1e-3..=1e6).contains(&times) => Ok(Speed::Times(times)),
        _ => Err("expected max, or a number from 0.001 to 1000000".into()),
    }
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let port = text.parse::<u16>().map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    port.or_else(|_| text.parse())
        .map_err(|_| "expected a port, or an IP address and a port such as 0.0.0.0:7000".into())
}

fn duration(text: &str) -> Result<Duration, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit_s = match &text[digits.len()..] {
        "ms" => 1e-3,
        "s" => 1.0,
        "min" => 60.0,
        _ => f64::NAN,
    };
    let seconds = digits.trim().parse::<f64>().unwrap_or(f64::NAN) * unit_s;
    match (0.01..=86_400.0).contains(&seconds) {
        true => Ok(Duration::from_secs_f64(seconds)),
        false => Err("expected a time from 10ms to 1440min, such as 500ms, 5s or 2min".into()),
    }
}

/// Between snapshots where nothing else is asked for.
const EVERY: Duration = Duration::from_secs(5);

/// What the frames came from.
struct Given<'a> {
    recording: Option<&'a Recording>,
    /// What people call it.
    name: &'a Path,
    /// Frames that the snapshot had seen.
    resumed_from: Option<usize>,
    /// What came by OpenIGTLink.
    messages: Option<Counts>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary<'a> {
    /// The recording, `-`, or an address.
    recording: Shown<'a>,
    /// `null` where none was asked for, or where there is no vessel.
    mesh: Option<Shown<'a>>,
    /// Whether the mesh is that of all frames at once.
    finished: bool,
    /// Whether Ctrl-C or a signal ended the run.
    interrupted: bool,
    /// Frames that the snapshot had seen before.
    resumed_from: Option<usize>,
    settings: &'a Settings,
    /// Where frames were computed, and why there; `null` where there is no vessel.
    engine: Option<EngineDescription>,
    /// Frames that were taken in this run.
    frames: usize,
    arrivals: &'a ArrivalsReport,
    /// Of OpenIGTLink, what came.
    messages: Option<Counts>,
    /// Frames that were dropped for newer ones.
    dropped: usize,
    /// Lines and messages that are no frames.
    skipped: usize,
    /// The first of them.
    skipped_first: &'a [String],
    /// Frames that were left out, and why, in the order in which that was found.
    left_out: &'a [LeftOut],
    /// Frames at which the vessel began anew.
    restarts: &'a [usize],
    /// What was done to the points of contours.
    #[serde(flatten)]
    cleaning: &'a Cleaning,
    /// What is suspicious about a recording as a whole.
    suspicions: Vec<Finding>,
    /// Frames outside of the vessel's lumen when they came.
    off_axis: usize,
    /// Branches that have a wall, with the first.
    branches: usize,
    /// The first frame with a vessel.
    first_frame: Option<usize>,
    #[serde(flatten)]
    times: TimesReport,
    most_work: Work,
    /// Rings after each tenth of the frames.
    rings: Vec<usize>,
    nodes: usize,
    triangles: usize,
    /// The most memory at a time, where the system says.
    peak_memory_bytes: Option<u64>,
}

impl Arguments {
    /// What `lumenmesh replay` does.
    pub(super) fn replay(
        recording: PathBuf,
        output: PathBuf,
        space: SpaceArgument,
        speed: Speed,
        json: bool,
        settings: SettingsArguments,
    ) -> Self {
        Self {
            recording: Some(recording),
            output: Some(output),
            space,
            speed: Some(speed),
            json,
            settings,
            listen: None,
            once: false,
            connect: None,
            igtl_connect: Vec::new(),
            igtl_listen: None,
            messages: MessageArguments::default(),
            igtl_serve: None,
            queue: 1,
            no_drop: false,
            save_every: None,
            snapshot: None,
            resume: false,
            log: None,
            view: None,
            hold: false,
            finish: false,
        }
    }

    pub(super) fn run(self) -> Result<ExitCode> {
        self.check()?;
        let mut live = self.vessel()?;
        if self.finish {
            live.keep_frames().map_err(|e| e.in_file(self.snapshot.as_deref().unwrap_or(Path::new("-"))))?;
        }
        let resumed_from = self.resume.then_some(live.frames());
        let recording = self.recording()?.map(Arc::new);
        let mut log = self.log.as_deref().map(FrameLog::create).transpose()?;
        let mut name = self.recording.clone().unwrap_or_default();
        let mut sinks = self.sinks(&live, &name)?;
        let mut counts = None;
        interrupt::end_in_order();
        let mut source =
            self.source(recording.as_ref(), live.frames(), &mut name, &mut sinks, &mut counts)?;

        let start = Instant::now();
        let count =
            recording.as_ref().map_or(0, |recording| recording.frames.len().saturating_sub(live.frames()));
        let bar = progress::bar("playing frames", count);
        let is_ended = || interrupt::asked().is_some();
        let done = run(&mut live, &mut source, &mut sinks, log.as_mut(), &is_ended, &mut || bar.inc(1));
        bar.finish_and_clear();
        let mut outcome = done.map_err(|e| e.in_file(&name))?;
        if let Source::Queued(queue) = &source {
            queue.close();
        }
        if let Some(recording) = &recording {
            outcome.left_out.iter_mut().for_each(|one| one.name(recording));
        }
        let (mesh, failed) = self.mesh(&live, &outcome, &name);
        let text = format!("{} frames in {:.0} s.", outcome.times.len(), start.elapsed().as_secs_f64());
        let end = End { mesh: mesh.as_ref(), is_finished: self.finish, text: &text };
        sinks.iter_mut().for_each(|sink| sink.end(&end));
        let messages = counts.map(|counts| counts.now());
        let given = Given { recording: recording.as_deref(), name: &name, resumed_from, messages };
        self.print(&live, &outcome, mesh.as_ref(), given)?;
        failed?;
        if self.hold {
            eprintln!("lumenmesh: the page stays until Ctrl-C");
            while !is_ended() {
                std::thread::sleep(Duration::from_millis(50));
            }
        }
        drop(sinks);
        Ok(match (outcome.ended, interrupt::asked()) {
            _ if outcome.failure.is_some() => ExitCode::FAILURE,
            (Ended::Interrupted, Some(signal)) => ExitCode::from(128 + signal),
            _ if outcome.faults.count > 0 => ExitCode::from(3),
            _ => ExitCode::SUCCESS,
        })
    }

    /// Refuses what cannot work before anything is done.
    fn check(&self) -> Result<()> {
        self.output.as_deref().map_or(Ok(()), surface::check_ending)?;
        self.log.as_deref().map_or(Ok(()), FrameLog::check_ending)?;
        if let (Some(every), None, None) = (self.save_every, &self.output, &self.snapshot) {
            return Err(Error::setting("--save-every", format!("{every:?}"), "-o or --snapshot with it"));
        }
        if self.once && self.listen.is_none() && self.igtl_listen.is_none() {
            return Err(Error::setting("--once", "no port to wait on", "--listen or --igtl-listen with it"));
        }
        let is_igtl = !self.igtl_connect.is_empty() || self.igtl_listen.is_some();
        if self.messages.is_given() && !is_igtl {
            return Err(Error::setting(
                "--pose-device and its like",
                "no OpenIGTLink",
                "--igtl-connect or --igtl-listen with them",
            ));
        }
        if self.speed.is_some() && self.recording.as_deref() == Some(Path::new("-")) {
            return Err(Error::setting("--speed", "a pipe, which has its own pace", "a recording"));
        }
        let outputs = [self.output.as_deref(), self.log.as_deref(), self.snapshot.as_deref()];
        for (k, output) in outputs.iter().enumerate() {
            if output.is_some() && outputs[..k].contains(output) {
                return Err(Error::input(
                    output.unwrap_or(Path::new("")),
                    "output",
                    "another output's name",
                    "a file of its own",
                ));
            }
        }
        refuse_inputs(outputs, [self.recording.as_deref()].into_iter().chain(self.settings.inputs()))
    }

    /// The vessel of no frames, or that of the snapshot.
    fn vessel(&self) -> Result<Live> {
        let settings = self.settings.settings()?;
        let Some(path) = self.snapshot.as_deref().filter(|_| self.resume) else {
            return Live::new(&settings);
        };
        let live = Live::restore(path)?;
        if settings != Settings::default() && settings != *live.settings() {
            return Err(Error::input(
                path,
                "settings",
                "others than the command line's",
                "the same, or no settings beside --resume",
            ));
        }
        Ok(live)
    }

    fn recording(&self) -> Result<Option<Recording>> {
        let path = self.recording.as_deref().filter(|path| *path != Path::new("-"));
        path.map(|path| self.settings.read(path)).transpose()
    }

    fn sinks(&self, live: &Live, name: &Path) -> Result<Vec<Box<dyn Sink>>> {
        let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
        let mesh =
            self.output.clone().filter(|_| self.save_every.is_some()).map(|path| (path, self.space.name()));
        if mesh.is_some() || self.snapshot.is_some() {
            sinks.push(Box::new(Files::new(self.save_every.unwrap_or(EVERY), mesh, self.snapshot.clone())));
        }
        if let Some(port) = self.view {
            let title = match name.file_name() {
                Some(file) if file != "-" => file.to_string_lossy().into_owned(),
                _ => "live".into(),
            };
            let page = PageServer::start(port, &title, live)?;
            eprintln!("lumenmesh: page http://{}/", page.address());
            sinks.push(Box::new(page));
        }
        if let Some(address) = &self.igtl_serve {
            let server = Server::start(address)?;
            eprintln!("lumenmesh: OpenIGTLink on {}", server.address());
            sinks.push(Box::new(Slicer::new(Arc::new(server))));
        }
        Ok(sinks)
    }

    /// Where frames come from; `name` becomes what people call it. Who sends by OpenIGTLink to a port gets the
    /// vessel there.
    fn source(
        &self,
        recording: Option<&Arc<Recording>>,
        first: usize,
        name: &mut PathBuf,
        sinks: &mut Vec<Box<dyn Sink>>,
        counts: &mut Option<SharedCounts>,
    ) -> Result<Source> {
        if let Some(recording) = recording {
            let speed = match self.speed.unwrap_or(Speed::Times(1.0)) {
                Speed::Times(times) => Some(times),
                Speed::Max => None,
            };
            return Ok(Source::Recorded(Recorded::new(Arc::clone(recording), first, speed)));
        }
        // A pipe waits: what is in it may well be a file.
        let is_pipe = self.recording.is_some();
        let when_full = if self.no_drop || is_pipe { WhenFull::Wait } else { WhenFull::DropOldest };
        let queue = Queue::new(self.queue, when_full);
        match (self.listen, &self.connect) {
            (Some(address), _) => {
                let bound = listen(address, self.once, &queue)?;
                eprintln!("lumenmesh: waiting for frames on {bound}");
                *name = bound.to_string().into();
            }
            (_, Some(address)) => {
                connect(address, &queue)?;
                *name = address.into();
            }
            _ if is_pipe => read_lines(BufReader::new(std::io::stdin()), "stdin", &queue),
            _ => {
                let mut messages = openigtlink::Source::new(&self.messages.options(self.once))?;
                *counts = Some(messages.counts());
                let mut names = Vec::new();
                for address in &self.igtl_connect {
                    names.push(messages.connect(address)?.to_string());
                }
                if let Some(address) = &self.igtl_listen {
                    let server = messages.listen(address)?;
                    eprintln!("lumenmesh: waiting for OpenIGTLink on {}", server.address());
                    names.push(server.address().to_string());
                    sinks.push(Box::new(Slicer::new(server)));
                }
                *name = names.join(", ").into();
                take_messages(messages, &queue);
            }
        }
        Ok(Source::Queued(queue))
    }

    /// The final mesh, written where one is asked for, or why there is none.
    fn mesh(&self, live: &Live, outcome: &Outcome, name: &Path) -> (Option<Surface>, Result<()>) {
        let mesh = match self.finish {
            true => live.finish().map(|lumen| lumen.surface()).map_err(|e| e.in_file(name)),
            false => Ok(live.surface()),
        };
        let mesh = match mesh {
            Ok(mesh) => mesh,
            Err(error) => return (None, Err(error)),
        };
        if mesh.triangles.is_empty() {
            let found = format!("{} that show no vessel", outcome.times.len());
            let failed = Error::input(name, "frames", found, "contours along a vessel");
            return (None, if self.output.is_some() { Err(failed) } else { Ok(()) });
        }
        let written = self.output.as_deref().map_or(Ok(()), |path| self.space.write(&mesh, path));
        (Some(mesh), written)
    }

    fn print(&self, live: &Live, outcome: &Outcome, mesh: Option<&Surface>, given: Given) -> Result<()> {
        let Given { recording, name, resumed_from, messages } = given;
        let settings = live.settings();
        let Faults { count: skipped, first: skipped_first } = &outcome.faults;
        let frames = outcome.times.len();
        let tenth = |k: &usize| (k + 1) * 10 / frames > k * 10 / frames;
        let suspicions =
            recording.map(|recording| Screening::of(&settings.conventions.apply(recording)).suspicions);
        let summary = Summary {
            recording: Shown(name),
            mesh: self.output.as_deref().filter(|_| mesh.is_some()).map(Shown),
            finished: self.finish && mesh.is_some(),
            interrupted: outcome.ended == Ended::Interrupted,
            resumed_from,
            settings,
            engine: live.engine(),
            frames,
            arrivals: &outcome.arrivals,
            messages,
            dropped: outcome.dropped,
            skipped: *skipped,
            skipped_first,
            left_out: &outcome.left_out,
            restarts: &outcome.restarts,
            cleaning: live.cleaning(),
            suspicions: suspicions.unwrap_or_default(),
            off_axis: outcome.off_axis,
            branches: live.branches(),
            first_frame: outcome.first_frame,
            times: TimesReport::of(&outcome.times),
            most_work: outcome.most_work,
            rings: (0..frames).filter(tenth).map(|k| outcome.rings[k]).collect(),
            nodes: mesh.map_or(0, |mesh| mesh.nodes_mm.len()),
            triangles: mesh.map_or(0, |mesh| mesh.triangles.len()),
            peak_memory_bytes: peak_memory_bytes(),
        };
        if self.json {
            return print_json(&summary);
        }
        summary.print();
        Ok(())
    }
}

impl Summary<'_> {
    fn print(&self) {
        if self.frames == 0 {
            println!("frames     none came from {}: there is no vessel", self.recording.display());
            return self.print_arrivals();
        }
        println!(
            "frames     {}, {} left out, {} outside the lumen when they came",
            self.frames,
            self.left_out.len(),
            self.off_axis
        );
        print_cleaning(self.cleaning);
        print_left_out(self.left_out);
        if let Some(engine) = &self.engine {
            print_engine(engine, rayon::current_num_threads());
        }
        self.print_arrivals();
        for frame in self.restarts {
            println!(
                "           the vessel began anew at frame {frame}, without frames that are left out and points that are no wall"
            );
        }
        self.suspicions.iter().for_each(|finding| print!("{finding}"));
        if let Some(frame) = self.first_frame {
            let branches =
                if self.branches > 1 { format!("{} branches, ", self.branches) } else { String::new() };
            println!(
                "vessel     from frame {frame} on; {branches}{} nodes, {} triangles in the end",
                self.nodes, self.triangles
            );
        }
        if !self.rings.is_empty() {
            let rings: Vec<String> = self.rings.iter().map(usize::to_string).collect();
            println!("rings      {} after each tenth of the frames", rings.join(", "));
        }
        let TimesReport { push_ms, stages_ms, latency_ms, missed_deadlines: missed } = &self.times;
        let line = |Percentiles { p50, p95, p99, max }: &Percentiles| {
            format!("{p50:.2} ms in the median, 95 % {p95:.2}, 99 % {p99:.2}, the longest {max:.2} ms")
        };
        println!("a frame    {}", line(push_ms));
        let Stages { waiting, screening, axis, placing, solving, showing } = stages_ms;
        println!(
            "           of which at 99 %: screening {:.2}, axis {:.2}, placing {:.2}, solving {:.2} ms",
            screening.p99, axis.p99, placing.p99, solving.p99
        );
        println!(
            "           beside it at 99 %: waiting {:.2} before, handing on {:.2} ms after",
            waiting.p99, showing.p99
        );
        println!("latency    {}, from the frame's arrival", line(latency_ms));
        println!(
            "deadlines  missed by {} frames at 12 Hz, {} at 30 Hz, {} at 60 Hz",
            missed.at_12_hz, missed.at_30_hz, missed.at_60_hz
        );
        println!(
            "at most    {} echoes looked at and {} rings computed for a frame",
            self.most_work.echoes, self.most_work.rings
        );
        if let Some(bytes) = self.peak_memory_bytes {
            println!("           {:.0} MiB of memory", bytes as f64 / f64::from(1 << 20));
        }
        if let Some(mesh) = &self.mesh {
            let how = if self.finished { ", of all frames at once" } else { "" };
            println!("mesh       {}{how}", mesh.display());
        }
    }

    /// What was irregular about the frames.
    fn print_arrivals(&self) {
        if let Some(frames) = self.resumed_from {
            println!("           after {frames} that the snapshot had seen");
        }
        let ArrivalsReport {
            without_pose,
            without_echoes,
            out_of_order,
            repeated,
            gaps,
            longest_gap_s,
            late,
            ..
        } = self.arrivals;
        let gap = format!("gaps in their times, the longest of {longest_gap_s:.2} s");
        for (count, what) in [
            (*without_pose, "without a pose"),
            (*without_echoes, "without an echo"),
            (*out_of_order, "with a time before that of an earlier one"),
            (*repeated, "the same as the one before, or with the same time"),
            (*late, "came late, by more than 0.25 s"),
            (*gaps, gap.as_str()),
            (self.dropped, "dropped for newer ones"),
            (self.skipped, "lines or messages skipped that are no frames:"),
        ] {
            if count > 0 {
                println!("           {count} {what}");
            }
        }
        if let Some(messages) = &self.messages {
            println!("           {messages}");
        }
        for fault in self.skipped_first {
            println!("           {fault}");
        }
        if self.interrupted {
            println!("           the run was interrupted");
        }
    }
}
