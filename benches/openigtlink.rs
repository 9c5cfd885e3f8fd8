//! Latency over OpenIGTLink on loopback: from a frame's messages to the catheter's tip, and to the vessel
//! that has the frame.
//!
//! `cargo bench --bench openigtlink`. A client sends `TRANSFORM` and `POINT` of the frames of
//! `recordings/adult_aorta_noisy.mat` in the folder of shared data (`LUMENMESH_SHARED`, default `../shared`)
//! at 12, 30 and 60 Hz, after the first 400 at once; it gets a tip and a whole vessel for each. The time
//! begins before the `TRANSFORM` is sent and ends when the answer is decoded: reconstruction (`push`),
//! strips, checksums and both ways are part of it. With `-- --test` everything runs once on little work.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on stops there")]

#[path = "../tests/support/data.rs"]
mod data;
#[path = "../tests/support/percentiles.rs"]
mod percentiles;

use lumenmesh::openigtlink::{
    Content, Message, MessageReader, Server, ServerOptions, Source, SourceOptions, Step, Timestamp,
};
use lumenmesh::reconstruction::Live;
use lumenmesh::recording::{Frame, Recording};
use lumenmesh::settings::{Method, Settings};
use percentiles::percentiles;
use std::io::Write;
use std::net::TcpStream;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Sends a frame whose time is its number, in sixteenths of a second.
fn send(mut stream: &TcpStream, frame: &Frame, k: usize) {
    let time = Timestamp::from_s(1_700_000_000.0).plus_s(k as f64 / 16.0);
    let (r, t) = (frame.world_from_sensor.rotation, frame.world_from_sensor.translation_mm);
    let matrix = [0, 1, 2].map(|k| [r.x_axis[k], r.y_axis[k], r.z_axis[k], t[k]].map(|x| x as f32));
    let points = frame.contour_mm.iter().map(|p| [p.x as f32, p.y as f32, 0.0]).collect();
    for (device, content) in
        [("ProbeToTracker", Content::Transform(matrix)), ("LumenContour", Content::Points(points))]
    {
        let message = Message::new(device, time, content).with_version(2);
        stream.write_all(&message.encode().unwrap()).unwrap();
    }
}

/// The reconstruction: frames in, tips and vessels out. Returns the vessel's nodes, and how long each frame
/// took, ms.
fn reconstruct(source: Source, server: &Server, settings: &Settings) -> (usize, Vec<f64>) {
    let mut live = Live::new(settings).unwrap();
    let mut times_ms = Vec::new();
    for frame in source {
        let frame = frame.unwrap();
        let begun = Instant::now();
        live.push(&frame).unwrap();
        times_ms.push(begun.elapsed().as_secs_f64() * 1e3);
        server.send_tip(frame.world_from_sensor, frame.time_s);
        if server.wants_vessel() {
            server.send_vessel(&live.surface());
        }
    }
    (live.rings() * live.nodes(), times_ms)
}

fn measure(frames: &[Frame], ahead: usize, rate_hz: f64, method: Method) {
    let mut source = Source::new(&SourceOptions::default().with_until_disconnected(true)).unwrap();
    let inlet = source.listen("127.0.0.1:0").unwrap();
    let options = ServerOptions::default().with_vessel_interval_s(0.0);
    let outlet = Arc::new(Server::with_options("127.0.0.1:0", &options).unwrap());
    let stream = TcpStream::connect(inlet.address()).unwrap();
    let viewer = TcpStream::connect(outlet.address()).unwrap();
    viewer.set_nodelay(true).unwrap();
    stream.set_nodelay(true).unwrap();
    let asked = Message::new("bench", Timestamp::now(), Content::GetStatus).with_version(2);
    (&viewer).write_all(&asked.encode().unwrap()).unwrap();
    let mut reader = MessageReader::new(std::io::BufReader::with_capacity(1 << 16, viewer));
    // Before the server has read the request it answers in version 1, which has no `FrameTime`.
    while reader.version() < Some(2) {
        assert!(matches!(reader.step(), Step::Message(_)), "the request is answered");
    }
    let begun = Arc::new(Mutex::new(Vec::new()));
    let answered = Arc::new(AtomicUsize::new(0));
    let receiving = thread::spawn({
        let (begun, answered) = (Arc::clone(&begun), Arc::clone(&answered));
        move || {
            let (mut tips, mut vessels, mut bytes, mut last) = (Vec::new(), Vec::new(), 0, None);
            while let Step::Message(message) = reader.step() {
                let now = Instant::now();
                let waited_ms = |k: Option<usize>| {
                    let sent: Instant = *begun.lock().unwrap().get(k?)?;
                    Some((now - sent).as_secs_f64() * 1e3).filter(|_| k >= Some(ahead))
                };
                match &message.content {
                    Content::Transform(_) => {
                        let time_s: f64 = message.metadata("FrameTime").unwrap().parse().unwrap();
                        last = Some((time_s * 16.0).round() as usize);
                        answered.fetch_max(last.unwrap_or(0), Ordering::Relaxed);
                        tips.extend(waited_ms(last));
                    }
                    // It comes after the tip of the same frame.
                    Content::PolyData(data) => {
                        vessels.extend(waited_ms(last));
                        bytes = data.points_mm.len();
                    }
                    _ => {}
                }
            }
            (tips, vessels, bytes)
        }
    });
    let settings = Settings::default().with_method(method);
    let computing = thread::spawn({
        let outlet = Arc::clone(&outlet);
        move || reconstruct(source, &outlet, &settings)
    });
    let mut due = Instant::now();
    for (k, frame) in frames.iter().enumerate() {
        if k >= ahead {
            if k == ahead {
                // What came at once is done first.
                while answered.load(Ordering::Relaxed) + 1 < ahead {
                    assert!(!receiving.is_finished() && !computing.is_finished(), "no more answers come");
                    thread::sleep(Duration::from_millis(20));
                }
                due = Instant::now();
            }
            due += Duration::from_secs_f64(1.0 / rate_hz);
            thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        begun.lock().unwrap().push(Instant::now());
        send(&stream, frame, k);
    }
    drop(stream);
    let (nodes, mut times_ms) = computing.join().unwrap();
    drop(Arc::into_inner(outlet));
    let (tips, vessels, shown) = receiving.join().unwrap();
    assert!(!tips.is_empty() && !vessels.is_empty() && shown > 0, "answers came");
    println!("{rate_hz} Hz, {method:?}, {nodes} nodes, {} frames", frames.len() - ahead);
    println!("   push    {}", percentiles(times_ms.split_off(ahead)));
    println!("   tip     {}", percentiles(tips));
    let count = vessels.len();
    println!("   vessel  {} ({count} of them)", percentiles(vessels));
}

fn main() {
    let test = std::env::args().any(|a| a == "--test");
    let path = data::shared_path("recordings/adult_aorta_noisy.mat");
    if !path.exists() {
        println!("not measured: no {}", path.display());
        return;
    }
    let recording = Recording::read(&path).unwrap();
    for method in [Method::Sweep, Method::Cylinders] {
        for (rate_hz, seconds) in [(12.0, 30.0), (30.0, 20.0), (60.0, 15.0)] {
            let (ahead, count) = if test { (200, 40) } else { (400, (rate_hz * seconds) as usize) };
            let end = (ahead + count).min(recording.frames.len());
            measure(&recording.frames[..end], ahead, if test { 500.0 } else { rate_hz }, method);
        }
    }
    if let Ok(load) = std::fs::read_to_string("/proc/loadavg") {
        println!("load {}", load.trim());
    }
}
