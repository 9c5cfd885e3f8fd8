//! `lumenmesh live` and `lumenmesh replay` as a user and other programs run them.

use crate::support::{lumenmesh, names};
use base64::Engine;
use lumenmesh::geometry::Pose;
use lumenmesh::openigtlink::{Content, Message, MessageReader, Step, Timestamp};
use lumenmesh::recording::Recording;
use lumenmesh::simulate::{Insertion, SimulationSettings};
use lumenmesh::surface::Surface;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// How long anything may take before a test gives up.
const PATIENCE: Duration = Duration::from_secs(120);

fn recording() -> Recording {
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    let mut recording = crate::support::vessel::simulated("cylinder", &settings).recording;
    recording.frames.truncate(250);
    recording
}

/// A folder with a recording as `rec.mat` and as `rec.ndjson`.
fn folder() -> (tempfile::TempDir, Recording) {
    let (folder, recording) = (tempfile::tempdir().unwrap(), recording());
    recording.write(&folder.path().join("rec.mat")).unwrap();
    let (status, _, said) = lumenmesh(&["import", "recording", "rec.mat", "-o", "rec.ndjson"], folder.path());
    assert_eq!((status, said.as_str()), (0, ""));
    (folder, recording)
}

/// The command while it runs.
struct Running {
    child: Child,
    said: BufReader<std::process::ChildStderr>,
}

impl Running {
    fn start(arguments: &[&str], folder: &Path, stdin: impl Into<Stdio>) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lumenmesh"));
        command.arg("live").args(arguments).current_dir(folder).stdin(stdin);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let said = BufReader::new(child.stderr.take().unwrap());
        Self { child, said }
    }

    /// The address in the next line on stderr that has one.
    fn address(&mut self) -> SocketAddr {
        let mut line = String::new();
        assert!(self.said.read_line(&mut line).unwrap() > 0, "it ended");
        let end = line.trim_end().trim_end_matches('/');
        end.rsplit(['/', ' ']).next().unwrap().parse().unwrap_or_else(|_| panic!("{line}"))
    }

    fn signal(&self, signal: &str) {
        assert!(
            Command::new("kill").args([signal, &self.child.id().to_string()]).status().unwrap().success()
        );
    }

    /// Exit status (`None` after a kill), stdout and the rest of stderr.
    fn end(mut self) -> (Option<i32>, String, String) {
        let (mut out, mut said) = (String::new(), String::new());
        self.child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
        self.said.read_to_string(&mut said).unwrap();
        (self.child.wait().unwrap().code(), out, said)
    }
}

fn live(arguments: &[&str], folder: &Path, stdin: &[u8]) -> (i32, String, String) {
    std::fs::write(folder.join("stdin.tmp"), stdin).unwrap();
    let stdin = std::fs::File::open(folder.join("stdin.tmp")).unwrap();
    let (status, out, said) = Running::start(arguments, folder, stdin).end();
    std::fs::remove_file(folder.join("stdin.tmp")).unwrap();
    (status.unwrap(), out, said)
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

fn until(what: &str, condition: impl Fn() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

#[test]
fn a_replay_is_a_live_run_at_full_speed() {
    let (folder, recording) = folder();
    let folder = folder.path();
    let (status, replayed, said) = lumenmesh(&["replay", "rec.mat", "-o", "a.vtp", "--json"], folder);
    assert_eq!((status, said.as_str()), (0, ""));
    let (status, out, said) = live(&["rec.mat", "--speed", "max", "-o", "b.vtp", "--json"], folder, b"");
    assert_eq!((status, said.as_str()), (0, ""));
    assert!(bytes(folder, "a.vtp") == bytes(folder, "b.vtp"));
    let (replayed, lived) = (json(&replayed), json(&out));
    for name in [
        "recording",
        "mesh",
        "settings",
        "frames",
        "left_out",
        "restarts",
        "suspicions",
        "off_axis",
        "first_frame",
        "push_ms",
        "stages_ms",
        "most_work",
        "rings",
        "nodes",
        "triangles",
    ] {
        assert!(replayed.get(name).is_some(), "{name}");
        if !["mesh", "push_ms", "stages_ms"].contains(&name) {
            assert_eq!(replayed[name], lived[name]);
        }
    }
    assert_eq!(
        (&lived["frames"], lived["rings"].as_array().unwrap().len()),
        (&recording.frames.len().into(), 10)
    );
    for name in ["waiting", "screening", "axis", "placing", "solving", "showing"] {
        let times = &lived["stages_ms"][name];
        let of = |rank: &str| times[rank].as_f64().unwrap();
        assert!(
            0.0 <= of("p50") && of("p50") <= of("p95") && of("p95") <= of("p99") && of("p99") <= of("max")
        );
    }
    let missed = |rate: &str| lived["missed_deadlines"][rate].as_u64().unwrap();
    assert!(missed("12_hz") <= missed("30_hz") && missed("30_hz") <= missed("60_hz"));
    let lower = lived["latency_ms"]["max"].as_f64().unwrap() >= lived["push_ms"]["max"].as_f64().unwrap();
    assert!(lower, "{lived}");
    let shown = lumenmesh(&["replay", "rec.mat", "-o", "a.vtp"], folder).1;
    for start in [
        "frames     250, ",
        "vessel     from frame ",
        "a frame    ",
        "deadlines  missed by ",
        "mesh       a.vtp",
    ] {
        assert!(shown.lines().any(|line| line.starts_with(start)), "{start}: {shown}");
    }
}

/// Its own pace, and a faster one.
#[test]
fn a_recording_is_played_at_its_own_pace() {
    let (folder, mut recording) = folder();
    recording.frames.truncate(37);
    recording.write(&folder.path().join("short.mat")).unwrap();
    let lasts = |speed: &str| {
        let start = Instant::now();
        let (status, _, said) = live(&["short.mat", "--speed", speed], folder.path(), b"");
        assert_eq!((status, said.as_str()), (0, ""));
        start.elapsed().as_secs_f64()
    };
    // 36 intervals at 12 Hz.
    assert!(lasts("1") >= 3.0 && lasts("2") >= 1.5);
}

#[test]
fn a_stream_that_is_finished_gives_the_bytes_of_the_batch() {
    let (folder, _) = folder();
    let folder = folder.path();
    let stream = bytes(folder, "rec.ndjson");
    for method in ["sweep", "cylinders"] {
        let (status, ..) =
            lumenmesh(&["reconstruct", "rec.mat", "-o", "batch.vtp", "--method", method], folder);
        assert_eq!(status, 0);
        let common = ["--finish", "--json", "--method", method];
        let (status, out, said) = live(&[&["-", "-o", "pipe.vtp"], &common[..]].concat(), folder, &stream);
        assert_eq!((status, said.as_str()), (0, ""));
        assert_eq!((&json(&out)["finished"], &json(&out)["dropped"]), (&true.into(), &0.into()));
        let network = ["--listen", "0", "--once", "--no-drop", "--queue", "3", "-o", "net.vtp"];
        let mut running = Running::start(&[&network[..], &common].concat(), folder, Stdio::null());
        TcpStream::connect(running.address()).unwrap().write_all(&stream).unwrap();
        assert_eq!(running.end().0, Some(0));
        let batch = bytes(folder, "batch.vtp");
        assert!(bytes(folder, "pipe.vtp") == batch && bytes(folder, "net.vtp") == batch, "{method}");
        let fewer: Vec<u8> = stream.split_inclusive(|b| *b == b'\n').skip(1).flatten().copied().collect();
        live(&[&["-", "-o", "pipe.vtp"], &common[..]].concat(), folder, &fewer);
        assert!(bytes(folder, "pipe.vtp") != batch, "the comparison sees differences");
    }
}

#[test]
fn a_bad_line_is_skipped_counted_and_told() {
    let (folder, _) = folder();
    let folder = folder.path();
    let stream = String::from_utf8(bytes(folder, "rec.ndjson")).unwrap();
    let mut lines: Vec<&str> = stream.lines().collect();
    let (status, out, _) = live(&["-", "-o", "good.vtp"], folder, stream.as_bytes());
    assert!(status == 0 && !out.contains("skipped"), "{out}");
    lines.insert(100, "{\"pose\": [1, 2], \"contour\": [], \"when_s\": 3}");
    lines.insert(200, "half a li");
    let (status, out, said) = live(&["-", "-o", "bad.vtp", "--json"], folder, lines.join("\n").as_bytes());
    assert_eq!((status, said.as_str()), (3, ""));
    assert!(bytes(folder, "good.vtp") == bytes(folder, "bad.vtp"), "the vessel is that of the good lines");
    let summary = json(&out);
    assert_eq!((&summary["skipped"], &summary["frames"]), (&2.into(), &250.into()));
    let first = summary["skipped_first"][0].as_str().unwrap();
    for part in ["stdin: line 101: found ", "the unknown member \"when_s\"", "pose: 2 numbers, not 16"] {
        assert!(first.contains(part), "{first}");
    }
    assert!(summary["skipped_first"][1].as_str().unwrap().contains("line 201: found no JSON"), "{summary}");
    let (status, out, _) = live(&["-"], folder, lines.join("\n").as_bytes());
    assert!(status == 3 && out.contains("2 lines or messages skipped that are no frames"), "{out}");
}

#[test]
fn what_is_irregular_is_counted_and_taken_as_it_comes() {
    let (folder, mut recording) = folder();
    let folder = folder.path();
    let frames = &mut recording.frames;
    frames[100].world_from_sensor = Pose::LOST;
    frames.swap(120, 121);
    let again = frames[140].clone();
    frames.insert(141, again);
    // Half a second is missing.
    frames.drain(160..166);
    recording.write(&folder.join("odd.ndjson")).unwrap();
    let (status, out, said) = live(&["-", "-o", "pipe.vtp", "--json"], folder, &bytes(folder, "odd.ndjson"));
    assert_eq!((status, said.as_str()), (0, ""));
    let summary = json(&out);
    let count = |name: &str| summary["arrivals"][name].as_u64().unwrap();
    let counts = ["frames", "without_pose", "out_of_order", "repeated", "gaps"].map(count);
    assert_eq!(counts, [245, 1, 1, 1, 1]);
    assert!((summary["arrivals"]["longest_gap_s"].as_f64().unwrap() - 7.0 / 12.0).abs() < 1e-6);
    let left_out: Vec<u64> =
        summary["left_out"].as_array().unwrap().iter().map(|one| one["frame"].as_u64().unwrap()).collect();
    assert_eq!(left_out, [100, 141], "without a pose, and the same again");
    // A file of the same frames is the same to it.
    live(&["odd.ndjson", "--speed", "max", "-o", "file.vtp"], folder, b"");
    assert!(bytes(folder, "pipe.vtp") == bytes(folder, "file.vtp"));
}

#[test]
fn a_run_without_frames_says_so_and_prints_no_times() {
    let folder = tempfile::tempdir().unwrap();
    for (sent, status, says) in
        [("", 0, ""), ("no frame\n", 3, "           1 lines or messages skipped that are no frames:\n")]
    {
        let path = folder.path().join("sent");
        std::fs::write(&path, sent).unwrap();
        let running = Running::start(&["-"], folder.path(), std::fs::File::open(&path).unwrap());
        let output = running.child.wait_with_output().unwrap();
        let printed = String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(status), "{printed}");
        let rest = printed.strip_prefix("frames     none came from -: there is no vessel\n").unwrap();
        assert!(rest.starts_with(says) && !rest.contains(" ms"), "{printed}");
    }
}

#[test]
fn a_network_that_is_too_fast_loses_its_oldest_frames() {
    let (folder, _) = folder();
    let folder = folder.path();
    let arguments = ["--listen", "0", "--once", "--queue", "1", "--json", "--log", "log.ndjson"];
    let mut running = Running::start(&arguments, folder, Stdio::null());
    TcpStream::connect(running.address()).unwrap().write_all(&bytes(folder, "rec.ndjson").repeat(3)).unwrap();
    let (status, out, _) = running.end();
    let summary = json(&out);
    let (frames, dropped) = (summary["frames"].as_u64().unwrap(), summary["dropped"].as_u64().unwrap());
    assert_eq!((status, frames + dropped), (Some(0), 750));
    assert!(dropped > 0 && frames > 0, "{frames} {dropped}");
    let log = String::from_utf8(bytes(folder, "log.ndjson")).unwrap();
    assert_eq!(log.lines().map(json).count() as u64, frames);
}

#[test]
fn the_log_has_a_line_for_each_frame() {
    let (folder, mut recording) = folder();
    let folder = folder.path();
    recording.frames[30].world_from_sensor = Pose::LOST;
    recording.write(&folder.join("lost.ndjson")).unwrap();
    for name in ["log.csv", "log.ndjson"] {
        let (status, ..) = live(&["lost.ndjson", "--speed", "max", "--log", name], folder, b"");
        assert_eq!(status, 0);
    }
    let csv = String::from_utf8(bytes(folder, "log.csv")).unwrap();
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines.len(), 251);
    assert!(
        lines[0].starts_with("frame,time_s,waiting_ms,") && lines[0].ends_with(",left_out"),
        "{}",
        lines[0]
    );
    let columns = lines[0].split(',').count();
    assert!(lines.iter().all(|line| line.split(',').count() == columns), "{csv}");
    assert!(lines[31].starts_with("30,2.5,") && lines[31].ends_with(",\"30: pose: none\""), "{}", lines[31]);
    let all = String::from_utf8(bytes(folder, "log.ndjson")).unwrap();
    let all: Vec<Value> = all.lines().map(json).collect();
    assert_eq!(
        (all.len(), &all[249]["frame"], &all[30]["left_out"]),
        (250, &249.into(), &"30: pose: none".into())
    );
    assert!(all[249]["rings"].as_u64().unwrap() > 10 && all[249]["latency_ms"].as_f64().unwrap() > 0.0);
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_ends_in_order() {
    let (folder, _) = folder();
    let folder = folder.path();
    let arguments = [
        "--listen",
        "0",
        "--no-drop",
        "-o",
        "vessel.vtp",
        "--snapshot",
        "state",
        "--log",
        "log.csv",
        "--json",
    ];
    for (signal, expected) in [("-INT", 130), ("-TERM", 143)] {
        let mut running = Running::start(&arguments, folder, Stdio::null());
        let address = running.address();
        // Two senders, one after the other: the run waits for more.
        let stream = bytes(folder, "rec.ndjson");
        let lines: Vec<&[u8]> = stream.split_inclusive(|b| *b == b'\n').collect();
        let log = || std::fs::read_to_string(folder.join("log.csv")).unwrap_or_default();
        for (k, half) in lines.chunks(125).enumerate() {
            TcpStream::connect(address).unwrap().write_all(&half.concat()).unwrap();
            until("all frames are taken", || log().lines().count() == 1 + 125 * (k + 1));
        }
        running.signal(signal);
        let (status, out, _) = running.end();
        let summary = json(&out);
        assert_eq!(status, Some(expected), "{out}");
        assert_eq!((&summary["interrupted"], &summary["frames"]), (&true.into(), &250.into()));
        lumenmesh(&["replay", "rec.mat", "-o", "whole.vtp"], folder);
        assert!(bytes(folder, "vessel.vtp") == bytes(folder, "whole.vtp"));
        assert!(names(folder).iter().all(|name| !name.starts_with('.')), "{:?}", names(folder));
        ["vessel.vtp", "state", "log.csv"]
            .iter()
            .for_each(|name| std::fs::remove_file(folder.join(name)).unwrap());
    }
}

#[cfg(unix)]
#[test]
fn a_killed_run_leaves_a_whole_mesh_and_a_snapshot_to_go_on_from() {
    let (folder, recording) = folder();
    let folder = folder.path();
    lumenmesh(&["replay", "rec.mat", "-o", "whole.vtp"], folder);
    let start =
        ["rec.mat", "--speed", "4", "-o", "vessel.vtp", "--save-every", "100ms", "--snapshot", "state"];
    let running = Running::start(&start, folder, Stdio::null());
    let exists = |name: &str| folder.join(name).exists();
    until("a mesh and a snapshot", || exists("vessel.vtp") && exists("state"));
    std::thread::sleep(Duration::from_millis(500));
    running.signal("-KILL");
    assert_eq!(running.end().0, None);
    let mesh = Surface::read(&folder.join("vessel.vtp")).unwrap();
    mesh.check().unwrap();
    assert!(!mesh.triangles.is_empty() && bytes(folder, "vessel.vtp") != bytes(folder, "whole.vtp"));
    let resume =
        ["rec.mat", "--speed", "max", "-o", "vessel.vtp", "--snapshot", "state", "--resume", "--json"];
    let (status, out, said) = live(&resume, folder, b"");
    assert_eq!((status, said.as_str()), (0, ""));
    let count = |name: &str| json(&out)[name].as_u64().unwrap();
    assert_eq!(count("resumed_from") + count("frames"), recording.frames.len() as u64);
    assert!(count("resumed_from") > 0 && count("frames") > 0, "{out}");
    assert!(bytes(folder, "vessel.vtp") == bytes(folder, "whole.vtp"), "as if it had never ended");
    let (status, _, said) = live(&[&resume[..], &["--method", "cylinders"]].concat(), folder, b"");
    assert!(status == 1 && said.contains("state: settings: found others than the command line's"), "{said}");
}

#[test]
fn what_cannot_work_is_refused_before_anything_is_written() {
    let (folder, mut recording) = folder();
    let folder = folder.path();
    recording.frames.iter_mut().for_each(|frame| frame.world_from_sensor = Pose::LOST);
    recording.write(&folder.join("lost.ndjson")).unwrap();
    std::fs::write(folder.join("state"), "no snapshot").unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let view = format!("--view={port}");
    let before = names(folder);
    for (arguments, expected_status, expected) in [
        (&[][..], 2, "required"),
        (&["rec.mat", "--listen", "7000"], 2, "cannot be used with"),
        (&["rec.mat", "--speed", "0"], 2, "expected max, or a number from 0.001"),
        (&["rec.mat", "-o", "a.vtp", "--save-every", "5"], 2, "such as 500ms, 5s or 2min"),
        (&["--listen", "seven"], 2, "expected a port, or an IP address and a port"),
        (&["rec.mat", "--hold"], 2, "--view"),
        (&["rec.mat", "--resume"], 2, "--snapshot"),
        (&["rec.mat", "--save-every", "5s"], 1, "setting --save-every: found 5s, expected -o or --snapshot"),
        (&["-", "--speed", "2"], 1, "setting --speed: found a pipe"),
        (&["rec.mat", "-o", "a.txt"], 1, "a.txt: unknown ending"),
        (&["rec.mat", "--log", "a.txt"], 1, "a.txt: unknown ending \"txt\", expected one of .csv"),
        (&["rec.mat", "--log", "a.csv", "--snapshot", "a.csv"], 1, "found another output's name"),
        (&["rec.ndjson", "--log", "rec.ndjson"], 1, "found an input of the same command"),
        (&["rec.mat", "--snapshot", "state", "--resume"], 1, "state: content: found another kind of file"),
        (&["rec.mat", &view], 1, "port"),
        (&["--listen", &port], 1, &format!("127.0.0.1:{port}: ")),
        (&["--connect", "127.0.0.1:1"], 1, "127.0.0.1:1: "),
        (&["--igtl-connect", "127.0.0.1:1"], 1, "127.0.0.1:1: "),
        (&["rec.mat", "--igtl-listen", "0"], 2, "cannot be used with"),
        (&["rec.mat", "--once"], 1, "setting --once: found no port"),
        (&["rec.mat", "--pose-device", "A"], 1, "setting --pose-device and its like: found no OpenIGTLink"),
        (&["rec.mat", "-o", "a.vtp", "--correct-poses"], 1, "setting sweep.correct_poses"),
        (&["none.mat", "-o", "a.vtp"], 1, "none.mat: cannot read"),
        (&["lost.ndjson", "--speed", "max", "-o", "a.vtp"], 1, "frames: found 250 that show no vessel"),
        (
            &["lost.ndjson", "--speed", "max", "-o", "a.vtp", "--strict"],
            1,
            "lost.ndjson: frame 0: pose: found none",
        ),
    ] {
        let (status, _, said) = live(arguments, folder, b"");
        assert_eq!(status, expected_status, "{arguments:?}: {said}");
        assert!(said.contains(expected), "{arguments:?}: {said}");
        assert_eq!(names(folder), before, "{arguments:?}");
    }
}

/// Frames as texts have all their digits. Who sends gets the vessel on the same connection, and so does who
/// only looks.
#[test]
fn frames_by_openigtlink_give_the_bytes_of_the_batch_and_the_vessel_goes_back() {
    let (folder, recording) = folder();
    let folder = folder.path();
    let arguments = [
        "--igtl-listen",
        "0",
        "--once",
        "--no-drop",
        "--finish",
        "--igtl-serve",
        "0",
        "-o",
        "net.vtp",
        "--json",
    ];
    let mut running = Running::start(&arguments, folder, Stdio::null());
    let looker = TcpStream::connect(running.address()).unwrap();
    let mut stream = TcpStream::connect(running.address()).unwrap();
    for frame in &recording.frames {
        let text = Content::Text(frame.to_json());
        stream.write_all(&Message::new("Frames", Timestamp::now(), text).encode().unwrap()).unwrap();
    }
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    // The last vessel of each.
    let last_vessel = |stream: TcpStream| {
        std::thread::spawn(move || {
            let (mut reader, mut nodes, mut tips) = (MessageReader::new(stream), 0, 0);
            loop {
                match reader.step() {
                    Step::Message(message) => match message.content {
                        Content::PolyData(mesh) => nodes = mesh.points_mm.len(),
                        Content::Transform(_) => tips += 1,
                        _ => {}
                    },
                    Step::Closed(_) => return (nodes, tips),
                    Step::Unknown | Step::Silent => {}
                    other => panic!("{other:?}"),
                }
            }
        })
    };
    let (looked, sent) = (last_vessel(looker), last_vessel(stream));
    let (status, out, said) = running.end();
    assert_eq!((status, said.as_str()), (Some(0), ""));
    let nodes = json(&out)["nodes"].as_u64().unwrap() as usize;
    assert_eq!(json(&out)["messages"]["messages"], recording.frames.len());
    let (looked, sent) = (looked.join().unwrap(), sent.join().unwrap());
    assert_eq!(looked.0, nodes, "the final mesh");
    assert!(sent.0 == nodes || sent.0 == 0, "{} of {nodes}", sent.0);
    assert!(looked.1 > 0);
    assert_eq!(lumenmesh(&["reconstruct", "rec.mat", "-o", "batch.vtp"], folder).0, 0);
    assert!(bytes(folder, "net.vtp") == bytes(folder, "batch.vtp"));
}

// ---- the page

/// An answer: its status, headers and body.
fn request(address: SocketAddr, text: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(text.replace('\n', "\r\n").as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let answer = String::from_utf8(answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{text}: {answer:?}"));
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head.to_ascii_lowercase(), body.to_owned())
}

/// A page's connection for events.
struct Events(BufReader<TcpStream>);

impl Events {
    fn of(address: SocketAddr) -> Self {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        write!(stream, "GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
        let mut reader = BufReader::new(stream);
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            assert!(reader.read_line(&mut head).unwrap() > 0);
        }
        assert!(
            head.starts_with("HTTP/1.1 200 OK\r\n") && head.contains("Content-Type: text/event-stream\r\n"),
            "{head}"
        );
        Self(reader)
    }

    /// The next event; `None` at the end.
    fn next(&mut self) -> Option<Value> {
        loop {
            let mut line = String::new();
            if self.0.read_line(&mut line).unwrap() == 0 {
                return None;
            }
            match line.trim_end() {
                "" | ":" | "retry: 1000" => {}
                line => return Some(json(line.strip_prefix("data: ").unwrap_or_else(|| panic!("{line}")))),
            }
        }
    }
}

fn floats(value: &Value) -> Vec<f32> {
    let bytes = base64::engine::general_purpose::STANDARD.decode(value.as_str().unwrap()).unwrap();
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// The vessel as a page has it: its rings, each with positions and supports.
#[derive(Default)]
struct Shown {
    nodes: usize,
    rings: Vec<(Vec<f32>, Vec<f32>)>,
    frames: usize,
    end: Option<String>,
}

impl Shown {
    fn take(&mut self, event: &Value) {
        let number = |name: &str| event[name].as_u64().unwrap() as usize;
        let rings = |part: &Value, nodes: usize| -> Vec<(Vec<f32>, Vec<f32>)> {
            let (positions, support) =
                (floats(&part["positions_mm"]), part["arrays"].get("support").map(floats));
            let support = support.unwrap_or_default();
            assert_eq!(positions.len(), 3 * support.len());
            match nodes {
                0 => Vec::new(),
                _ => positions
                    .chunks(3 * nodes)
                    .zip(support.chunks(nodes))
                    .map(|(p, s)| (p.to_vec(), s.to_vec()))
                    .collect(),
            }
        };
        match event["type"].as_str().unwrap() {
            "vessel" => {
                self.nodes = number("nodes");
                self.rings = rings(event, self.nodes);
                assert_eq!(self.rings.len(), number("rings"));
                self.frames = event["frames"].as_array().unwrap().len();
            }
            "change" => {
                let nothing = || (Vec::new(), Vec::new());
                self.rings.splice(0..0, (0..number("before")).map(|_| nothing()));
                self.rings.resize_with(number("rings"), nothing);
                for part in event["changed"].as_array().unwrap() {
                    let range =
                        part["from"].as_u64().unwrap() as usize..part["to"].as_u64().unwrap() as usize;
                    let new = rings(part, self.nodes);
                    assert_eq!(new.len(), range.len());
                    self.rings.splice(range, new);
                }
                assert!(self.rings.iter().all(|(positions, _)| positions.len() == 3 * self.nodes));
                self.frames += usize::from(event.get("frame").is_some());
            }
            "end" => self.end = Some(event["text"].as_str().unwrap().to_owned()),
            "message" => {}
            other => panic!("{other}"),
        }
    }

    fn follow(&mut self, events: &mut Events) {
        while self.end.is_none() {
            self.take(&events.next().unwrap());
        }
    }
}

#[test]
fn several_pages_see_the_vessel_grow_and_only_what_changed_is_sent() {
    let (folder, recording) = folder();
    let arguments = ["rec.mat", "--speed", "12", "--view=0", "--hold", "--json"];
    let mut running = Running::start(&arguments, folder.path(), Stdio::null());
    let address = running.address();
    // One from the beginning, one that comes later, and one that never reads.
    let mut first = Events::of(address);
    let silent = Events::of(address);
    let (mut one, mut two) = (Shown::default(), Shown::default());
    let (mut sizes, mut kinds) = (Vec::new(), Vec::new());
    while one.rings.len() < 20 {
        let event = first.next().unwrap();
        sizes.push(event.to_string().len());
        kinds.push(event["type"].as_str().unwrap().to_owned());
        one.take(&event);
    }
    assert_eq!(kinds[0], "vessel", "the first event of a connection");
    let mut second = Events::of(address);
    two.follow(&mut second);
    one.follow(&mut first);
    assert!(one.rings == two.rings && one.nodes == two.nodes && one.rings.len() > 20);
    assert_eq!((one.frames, two.frames), (recording.frames.len(), recording.frames.len()));
    assert_eq!(one.end.as_deref(), two.end.as_deref());
    assert!(one.end.unwrap().starts_with("250 frames in "));
    assert!(first.next().is_none(), "the connection ends with the recording");
    // A page that comes back gets all again, and the end.
    let mut again = Shown::default();
    again.follow(&mut Events::of(address));
    assert!(again.rings == one.rings && again.frames == 250);
    // A change is smaller than the vessel in the end.
    let whole = Events::of(address).next().unwrap().to_string().len();
    let median = {
        sizes.sort_unstable();
        sizes[sizes.len() / 2]
    };
    assert!(median < whole / 2, "{median} of {whole}");
    drop(silent);
    running.signal("-INT");
    let (status, out, said) = running.end();
    assert_eq!(status, Some(0), "{said}");
    assert_eq!((&json(&out)["frames"], &json(&out)["interrupted"]), (&250.into(), &false.into()));
}

#[test]
fn a_page_that_does_not_read_blocks_nobody() {
    let (folder, _) = folder();
    let folder = folder.path();
    // Far more than the buffers of a connection hold.
    let long: Vec<u8> = bytes(folder, "rec.ndjson").repeat(4);
    std::fs::write(folder.join("long.ndjson"), &long).unwrap();
    let arguments = ["long.ndjson", "--speed", "max", "--view=0", "--json", "-o", "vessel.vtp"];
    let mut running = Running::start(&arguments, folder, Stdio::null());
    let address = running.address();
    let silent: Vec<Events> = (0..5).map(|_| Events::of(address)).collect();
    let (status, out, _) = running.end();
    assert_eq!((status, &json(&out)["frames"]), (Some(0), &1000.into()));
    drop(silent);
    let (status, alone, _) =
        live(&["long.ndjson", "--speed", "max", "--json", "-o", "alone.vtp"], folder, b"");
    assert_eq!((status, &json(&alone)["frames"]), (0, &1000.into()));
    assert!(bytes(folder, "vessel.vtp") == bytes(folder, "alone.vtp"), "what is shown changes nothing");
}

#[test]
fn the_server_answers_its_own_pages_only() {
    let (folder, _) = folder();
    let mut running = Running::start(&["rec.mat", "--view=0"], folder.path(), Stdio::null());
    let address = running.address();
    let port = address.port();
    let (status, head, body) = request(address, &format!("GET / HTTP/1.1\nHost: localhost:{port}\n\n"));
    assert_eq!(status, 200);
    assert!(
        head.contains("content-type: text/html; charset=utf-8") && head.contains("cache-control: no-store"),
        "{head}"
    );
    assert!(body.starts_with("<!DOCTYPE html>") && body.contains("new EventSource(\"events\")"));
    assert!(!body.contains("/*vessel*/"));
    for (line, host, expected) in [
        ("GET / HTTP/1.1", "evil.example".to_owned(), 403),
        ("GET /events HTTP/1.1", format!("evil.example:{port}"), 403),
        ("GET / HTTP/1.1", "127.0.0.1:1".to_owned(), 403),
        ("GET /vessel HTTP/1.1", format!("127.0.0.1:{port}"), 404),
        ("POST / HTTP/1.1", format!("127.0.0.1:{port}"), 405),
        ("HEAD /events HTTP/1.1", format!("[::1]:{port}"), 405),
        ("nonsense", format!("127.0.0.1:{port}"), 400),
    ] {
        let (status, head, _) = request(address, &format!("{line}\nHost: {host}\n\n"));
        assert_eq!(status, expected, "{line} {host}");
        assert!(!head.contains("access-control"), "{head}");
    }
    let (status, head, _) = request(
        address,
        &format!("POST / HTTP/1.1\nHost: 127.0.0.1:{port}\nContent-Length: 50000\n\n{}", "x".repeat(50_000)),
    );
    assert!(status == 405 && head.contains("allow: get"), "{head}");
    // A request without end, and one that is too long, are let go of.
    let mut endless = TcpStream::connect(address).unwrap();
    for _ in 0..20 {
        if endless.write_all(&[b'x'; 1024]).is_err() {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    endless.set_read_timeout(Some(PATIENCE)).unwrap();
    let ended = endless.read(&mut [0; 16]);
    assert!(matches!(ended, Ok(0)) || ended.is_err_and(|e| e.kind() == std::io::ErrorKind::ConnectionReset));
    running.signal("-KILL");
    running.end();
}

#[test]
fn the_help_of_live_commands_leaves_out_what_they_refuse() {
    let help = |command: &str| lumenmesh(&[command, "--help"], Path::new(".")).1;
    for flag in ["--calibrate", "--correct-poses", "--estimate-offset", "--motion", "--phase-window"] {
        let is_shown = |command: &str| help(command).lines().any(|line| line.trim_start().starts_with(flag));
        assert_eq!(["reconstruct", "live", "replay"].map(is_shown), [true, false, false], "{flag}");
    }
}
