//! OpenIGTLink over real connections, against libOpenIGTLink, against pyigtl, and against itself.

use crate::support::vessel::simulated;
use crate::support::{Python, python_with, shared, skipped, tube};
use glam::{DMat3, DVec2, DVec3};
use lumenmesh::Error;
use lumenmesh::geometry::Pose;
use lumenmesh::openigtlink::{
    AssemblerOptions, Content, Header, MAX_CLIENTS, Message, MessageReader, PolyData, Server, ServerOptions,
    Source, SourceOptions, Step, Timestamp,
};
use lumenmesh::reconstruction::Reconstructor;
use lumenmesh::recording::{Frame, MaskOptions, Recording};
use lumenmesh::settings::Settings;
use lumenmesh::simulate::{Insertion, SimulationSettings};
use lumenmesh::surface::Surface;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

/// When the first message of a test was made.
fn start() -> Timestamp {
    Timestamp::from_s(1_700_000_000.0)
}

fn rows(pose: &Pose) -> [[f32; 4]; 3] {
    let (r, t) = (pose.rotation, pose.translation_mm);
    [0, 1, 2].map(|k| [r.x_axis[k], r.y_axis[k], r.z_axis[k], t[k]].map(|x| x as f32))
}

fn points(contour_mm: &[DVec2]) -> Vec<[f32; 3]> {
    contour_mm.iter().map(|p| [p.x as f32, p.y as f32, 0.0]).collect()
}

/// The messages of a frame: its pose, or that there is none, and its contour.
fn messages_of(frame: &Frame, time: Timestamp) -> [Message; 2] {
    let pose = frame.world_from_sensor;
    let transform = match pose.is_finite() {
        true => Message::new("ProbeToTracker", time, Content::Transform(rows(&pose))),
        false => Message::new("ProbeToTracker", time, Content::Transform(rows(&Pose::IDENTITY)))
            .with_metadata("TransformStatus", "OUT_OF_VIEW"),
    };
    [transform, Message::new("LumenContour", time, Content::Points(points(&frame.contour_mm)))]
}

fn send(mut stream: &TcpStream, message: &Message) {
    stream.write_all(&message.encode().unwrap()).unwrap();
}

/// A source that ends with its last client, and the address of its server.
fn listening(options: AssemblerOptions) -> (Source, std::sync::Arc<Server>) {
    let options = SourceOptions::default().with_assembler(options).with_until_disconnected(true);
    let mut source = Source::new(&options).unwrap();
    let server = source.listen("127.0.0.1:0").unwrap();
    assert!(server.address().ip().is_loopback());
    (source, server)
}

/// The frames of a source that has no faults.
fn frames_of(source: Source) -> Vec<Frame> {
    source.map(|frame| frame.unwrap()).collect()
}

fn bits(frame: &Frame) -> Vec<u64> {
    let pose = frame.world_from_sensor;
    let numbers = pose.rotation.to_cols_array().into_iter().chain(pose.translation_mm.to_array());
    let numbers = numbers.chain(frame.contour_mm.iter().flat_map(|p| p.to_array())).chain(frame.time_s);
    // All NaN are one.
    numbers.map(|x| if x.is_nan() { u64::MAX } else { x.to_bits() }).collect()
}

fn recordings() -> Vec<Recording> {
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    let mut recordings = vec![simulated("arch", &settings).recording];
    recordings[0].frames[7].world_from_sensor = Pose::LOST;
    recordings[0].frames[9].contour_mm[3] = DVec2::NAN;
    if let Some(noisy) = shared("recordings/adult_aorta_noisy.mat") {
        recordings.push(Recording::read(&noisy).unwrap());
    }
    recordings
}

#[test]
fn a_recording_that_is_streamed_as_poses_and_points_is_the_recording_in_single_precision() {
    for recording in recordings() {
        let (source, server) = listening(AssemblerOptions::default());
        let sent = recording.clone();
        let sender = thread::spawn(move || {
            let stream = TcpStream::connect(server.address()).unwrap();
            for (k, frame) in sent.frames.iter().enumerate() {
                // Sixteenths of a second are exact.
                for message in messages_of(frame, start().plus_s(k as f64 / 16.0)) {
                    send(&stream, &message);
                }
            }
        });
        let counts = source.counts();
        let frames = frames_of(source);
        sender.join().unwrap();
        assert_eq!(frames.len(), recording.frames.len());
        let mut changed = 0;
        for (k, (found, sent)) in frames.iter().zip(&recording.frames).enumerate() {
            let rounded = |p: &DVec2| p.as_vec2().as_dvec2();
            let pose = sent.world_from_sensor;
            let rotation =
                DMat3::from_cols_array(&pose.rotation.to_cols_array().map(|x| f64::from(x as f32)));
            let translation_mm = pose.translation_mm.as_vec3().as_dvec3();
            let contour_mm = sent.contour_mm.iter().map(rounded).collect();
            let expected =
                Frame::new(Pose { rotation, translation_mm }, contour_mm).with_time_s(Some(k as f64 / 16.0));
            assert_eq!(bits(found), bits(&expected), "frame {k}");
            changed += usize::from(bits(found) != bits(&sent.clone().with_time_s(found.time_s)));
        }
        assert!(changed > frames.len() / 2, "the comparison sees rounding");
        let lost = recording.frames.iter().filter(|f| !f.world_from_sensor.is_finite()).count();
        let counts = counts.now();
        assert_eq!((counts.frames.frames, counts.frames.pose_not_ok), (frames.len(), lost));
        assert_eq!(counts.traffic.messages, 2 * frames.len());
        assert_eq!((counts.traffic.connections, counts.traffic.connections_ended), (1, 1));
    }
}

/// Bytes, so that NaN equals itself.
fn bytes(surface: &Surface) -> Vec<u64> {
    let nodes = surface.nodes_mm.iter().flat_map(|p| p.to_array());
    let arrays = surface.arrays.iter().flat_map(|a| a.values.iter().copied());
    let triangles = surface.triangles.iter().flatten().map(|&n| u64::from(n));
    nodes.chain(arrays).map(f64::to_bits).chain(triangles).collect()
}

#[test]
fn a_recording_that_is_streamed_as_texts_gives_the_bytes_of_the_batch() {
    for recording in recordings() {
        let (source, server) = listening(AssemblerOptions::default());
        let sent = recording.clone();
        let sender = thread::spawn(move || {
            let stream = TcpStream::connect(server.address()).unwrap();
            for frame in &sent.frames {
                let text = Content::Text(frame.to_json());
                send(&stream, &Message::new("Frames", Timestamp::now(), text));
            }
        });
        let streamed = Recording { frames: frames_of(source) };
        sender.join().unwrap();
        assert_eq!(streamed.frames.len(), recording.frames.len());
        for (found, sent) in streamed.frames.iter().zip(&recording.frames) {
            assert_eq!((bits(found), found.cylinder), (bits(sent), sent.cylinder));
        }
        if recording.frames.len() > 1000 {
            continue;
        }
        let run = |recording: &Recording| {
            let lumen = Reconstructor::new(Settings::default()).run(recording).unwrap();
            bytes(&lumen.surface())
        };
        assert_eq!(run(&streamed), run(&recording));
        let mut other = recording.clone();
        other.frames.truncate(recording.frames.len() - 20);
        assert_ne!(run(&other), run(&recording), "the comparison sees differences");
    }
}

/// A vessel whose arrays tell one node from another.
fn vessel(levels: u32) -> Surface {
    let mut surface = tube(16, levels, 4.0, 30.0);
    let count = surface.nodes_mm.len();
    surface.set_array("support", (0..count).map(|k| (k % 50) as f64).collect());
    surface.set_array("residual_mm", vec![0.5; count]);
    surface.set_array("standard_error_mm", (0..count).map(|k| 0.125 * (k % 7) as f64).collect());
    surface.set_array("supported", (0..count).map(|k| f64::from(u8::from(k % 3 > 0))).collect());
    surface
}

fn tip() -> Pose {
    Pose { rotation: DMat3::from_rotation_z(0.5), translation_mm: DVec3::new(-387.25, 32.5, -35.0) }
}

/// The client of libOpenIGTLink, compiled; `None`, with a line on stderr, where the library or the compiler
/// is missing.
fn reference_client(folder: &Path) -> Option<std::path::PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/igtl_client.cpp");
    let program = folder.join("igtl_client");
    let headers = "/usr/include/openigtlink";
    let compiled = Command::new("g++")
        .args(["-fpermissive", "-w", "-std=c++14", &format!("-I{headers}")])
        .arg(source)
        .arg("-o")
        .arg(&program)
        .args(["-lOpenIGTLink", "-lpthread"])
        .output();
    match compiled {
        Ok(output) if output.status.success() => return Some(program),
        Ok(output) if Path::new(headers).exists() => {
            panic!("{}", String::from_utf8_lossy(&output.stderr))
        }
        _ => skipped("no g++ with libOpenIGTLink (Debian: libopenigtlink-dev)", "LUMENMESH_REQUIRE_TOOLS"),
    }
    None
}

/// Values in the order of a line's words that are numbers.
fn numbers(line: &str) -> Vec<f64> {
    line.split(' ').filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn a_client_of_the_reference_library_sees_the_vessel_and_sends_frames() {
    let folder = tempfile::tempdir().unwrap();
    let Some(program) = reference_client(folder.path()) else { return };
    let options = AssemblerOptions::default().with_contour_device(Some("LumenContour".into()));
    let (source, server) = listening(options);
    let surface = vessel(20);
    server.send_vessel(&surface);
    server.send_status("20 levels");
    let port = server.address().port().to_string();
    let client = thread::spawn(move || Command::new(program).args([&port, "40"]).output().unwrap());
    while !client.is_finished() {
        server.send_tip(tip(), Some(1.5));
        thread::sleep(Duration::from_millis(5));
    }
    let output = client.join().unwrap();
    assert!(output.status.success(), "{:?}", output.status);
    let text = String::from_utf8(output.stdout).unwrap();
    let line =
        |start: &str| text.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{text}"));

    let (nodes, triangles) = (surface.nodes_mm.len(), surface.triangles.len());
    assert_eq!(line("POLYDATA"), format!("POLYDATA Lumen points {nodes} triangles {triangles}"));
    let bound = |of: fn(f64, f64) -> f64| -> Vec<f64> {
        let axis = |k: usize| surface.nodes_mm.iter().map(|p| f64::from(p[k] as f32)).reduce(of).unwrap();
        (0..3).map(axis).collect()
    };
    let single = |numbers: Vec<f64>| -> Vec<f32> { numbers.into_iter().map(|x| x as f32).collect() };
    assert_eq!(single(numbers(line("bounds"))), single([bound(f64::min), bound(f64::max)].concat()));
    for name in ["support", "standard_error_mm", "supported"] {
        let values = surface.array(name).unwrap();
        let sum = values.iter().sum::<f64>();
        let found = numbers(line(&format!("scalars {name} ")));
        assert_eq!(found, [0.0, nodes as f64, values[0], values[nodes - 1], sum], "{name}");
    }
    assert!(!text.contains("residual_mm"), "{text}");
    assert_eq!(line("STATUS"), "STATUS lumenmesh 1 20 levels");
    assert!(line("TRANSFORM").starts_with("TRANSFORM CatheterTip "));
    let rows: Vec<f32> = rows(&tip()).into_iter().flatten().collect();
    assert_eq!(single(numbers(line("TRANSFORM"))), rows);

    let frames = frames_of(source);
    assert_eq!(frames.len(), 40);
    for (number, frame) in frames.iter().enumerate() {
        let k = number as f64;
        assert_eq!(frame.world_from_sensor.translation_mm, DVec3::new(0.5 * k, -1.25, 0.0));
        // The library turns nanoseconds into 2⁻³² s, and loses one of them.
        let late_s = frame.time_s.unwrap() - k / 8.0;
        assert!(late_s.abs() <= 2.0_f64.powi(-31), "{late_s}");
        if number % 4 == 2 {
            let off = |p: &DVec2| (p.length() - 4.0).abs();
            assert!(frame.contour_mm.len() == 128 && frame.contour_mm.iter().all(|p| off(p) < 0.02));
        } else {
            let contour: Vec<DVec2> = (0..5).map(|j| DVec2::new(1.5 * f64::from(j), 0.25 * k)).collect();
            assert_eq!(frame.contour_mm, contour, "frame {number}");
        }
    }
}

/// A Python with pyigtl, the implementation that AIGT's live segmentation uses.
fn python() -> Option<Python> {
    python_with("pyigtl, numpy")
}

fn decoded(bytes: &[u8]) -> Message {
    let (header, body) = bytes.split_first_chunk().unwrap();
    Header::decode(header).unwrap().decode_body(body).unwrap()
}

const MATRIX: [[f32; 4]; 3] = [[1.0, 2.0, 3.0, 4.5], [5.0, 6.0, 7.0, 8.25], [9.0, 10.0, 11.0, -12.0]];

#[test]
fn messages_of_pyigtl_are_read() {
    let Some(python) = python() else { return };
    let script = r#"
import numpy as np, pyigtl
matrix = np.array([[1, 2, 3, 4.5], [5, 6, 7, 8.25], [9, 10, 11, -12], [0, 0, 0, 1]])
square = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0]], dtype=np.float32)
name = "ProbeToTracker"
for version in (1, 2):
    for message in (pyigtl.TransformMessage(matrix, device_name=name, timestamp=1700000000.5),
                    pyigtl.StringMessage("lumen", device_name="Text", timestamp=0),
                    pyigtl.PointMessage(square, names=["a", "b", "c"], device_name="Points", timestamp=0),
                    pyigtl.PolyDataMessage(points=square, lines=np.array([3, 0, 1, 2]), device_name="Line", timestamp=0),
                    pyigtl.PolyDataMessage(points=square, vertices=np.array([1, 0, 1, 1]), device_name="Dots", timestamp=0),
                    pyigtl.ImageMessage(np.array(range(12), dtype=np.uint16).reshape(3, 4), device_name="Image", timestamp=0)):
        message.header_version = version
        if version == 2:
            message.metadata = {"TransformStatus": "OK"}
        print(message.pack().hex())
"#;
    let output = python.run(script, &[]);
    let bytes = |line: &str| -> Vec<u8> {
        let pair = |k: usize| u8::from_str_radix(&line[2 * k..2 * k + 2], 16).unwrap();
        (0..line.len() / 2).map(pair).collect()
    };
    let messages: Vec<Message> = output.lines().map(|line| decoded(&bytes(line))).collect();
    assert_eq!(messages.len(), 12);
    for (version, of) in [(1, &messages[..6]), (2, &messages[6..])] {
        assert!(of.iter().all(|message| message.version == version));
        assert!(of.iter().all(|m| m.metadata("TransformStatus") == (version == 2).then_some("OK")));
        assert_eq!((of[0].device.as_str(), &of[0].content), ("ProbeToTracker", &Content::Transform(MATRIX)));
        assert!((of[0].time.to_s() - 1_700_000_000.5).abs() < 1e-6);
        assert_eq!(of[1].content, Content::Text("lumen".into()));
        let points_mm = vec![[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0]];
        assert_eq!(of[2].content, Content::Points(points_mm.clone()));
        let line = PolyData { points_mm, lines: vec![vec![0, 1, 2]], ..PolyData::default() };
        assert_eq!(of[3].content, Content::PolyData(line.clone()));
        assert_eq!(of[4].content, Content::PolyData(PolyData { lines: Vec::new(), ..line }));
        let Content::Image(image) = &of[5].content else { panic!("{:?}", of[5]) };
        let (plane, matrix) = image.plane().unwrap();
        assert_eq!((plane.width, plane.height), (4, 3));
        assert_eq!(plane.pixels, (0..12_u8).map(f32::from).collect::<Vec<_>>());
        // pyigtl gives a plane's pixels one pixel along i, and its columns and rows j and k.
        assert_eq!(matrix.x_axis.truncate(), DVec3::Y);
        assert_eq!(matrix.w_axis.truncate(), DVec3::ZERO);
    }
}

#[test]
fn pyigtl_reads_our_messages() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("messages");
    let mut bytes = Vec::new();
    for version in [1, 2] {
        for content in [Content::Transform(MATRIX), Content::Text("lumen".into())] {
            let message = Message::new("Tip", Timestamp::from_s(1_700_000_000.5), content)
                .with_metadata("TransformStatus", "OK")
                .with_version(version);
            bytes.extend(message.encode().unwrap());
        }
    }
    std::fs::write(&path, bytes).unwrap();
    let script = r#"
import sys
from pyigtl import messages as m
data = open(sys.argv[1], "rb").read()
while data:
    header = m.MessageBase.parse_header(data[:58])
    body, data = data[58:58 + header["body_size"]], data[58 + header["body_size"]:]
    message = m.MessageBase.create_message(header["message_type"])
    message.unpack(header, body)
    said = message.matrix.tolist() if hasattr(message, "matrix") else message.string
    print(message.header_version, message.device_name, message.timestamp, message.metadata, said)
"#;
    let output = python.run(script, &[&path]);
    let matrix =
        "[[1.0, 2.0, 3.0, 4.5], [5.0, 6.0, 7.0, 8.25], [9.0, 10.0, 11.0, -12.0], [0.0, 0.0, 0.0, 1.0]]";
    let mut expected = String::new();
    for (version, metadata) in [(1, "{}"), (2, "{'TransformStatus': 'OK'}")] {
        for said in [matrix, "lumen"] {
            expected += &format!("{version} Tip 1700000000.5 {metadata} {said}\n");
        }
    }
    assert_eq!(output, expected);
}

#[test]
fn a_client_of_pyigtl_sends_masks_with_metadata_and_sees_the_tip() {
    let Some(python) = python() else { return };
    let mask = MaskOptions::default().with_pixel_mm(Some([0.25; 2])).with_points(64);
    let options = AssemblerOptions::default().with_contour_device(Some("Inference".into())).with_mask(mask);
    let (source, server) = listening(options);
    let port = server.address().port();
    let client = thread::spawn(move || {
        python.run(
            &format!(
                r#"
import numpy as np, pyigtl, time
client = pyigtl.OpenIGTLinkClient("127.0.0.1", {port})
rows, columns = np.mgrid[:65, :65]
radius = np.hypot(rows - 32, columns - 32)
mask = (255 * np.clip((16 - radius) / 4 + 0.5, 0, 1)).astype(np.uint8)[np.newaxis]
for k in range(8):
    matrix = np.eye(4); matrix[0, 3] = k
    transform = pyigtl.TransformMessage(matrix, device_name="ProbeToTracker", timestamp=1700000000 + k / 8)
    transform.header_version = 2
    transform.metadata = {{"TransformStatus": "OK" if k != 5 else "INVALID"}}
    client.send_message(transform, wait=True)
    client.send_message(pyigtl.ImageMessage(mask, device_name="Inference", timestamp=1700000000 + k / 8), wait=True)
tip = client.wait_for_message("CatheterTip", timeout=60)
print(tip.header_version, tip.metadata["TransformStatus"], tip.metadata["FrameTime"], tip.matrix.tolist())
text = client.wait_for_message("lumenmesh", timeout=60)
print(text.string)
client.stop()
"#
            ),
            &[],
        )
    });
    while !client.is_finished() {
        server.send_tip(tip(), Some(0.625));
        server.send_text("{\"rings\": 20}").unwrap();
        thread::sleep(Duration::from_millis(20));
    }
    let output = client.join().unwrap();
    let lines: Vec<&str> = output.lines().collect();
    assert!(lines[0].starts_with("2 OK 0.625 [["), "{output}");
    assert!(lines[0].contains("-387.25]"), "{output}");
    assert_eq!(lines[1], "{\"rings\": 20}");
    let frames = frames_of(source);
    assert_eq!(frames.len(), 8);
    for (k, frame) in frames.iter().enumerate() {
        assert!((frame.time_s.unwrap() - k as f64 / 8.0).abs() < 1e-8);
        let x = frame.world_from_sensor.translation_mm.x;
        assert!(if k == 5 { x.is_nan() } else { x == k as f64 }, "frame {k}: {x}");
        assert_eq!(frame.contour_mm.len(), 64);
        assert!(frame.contour_mm.iter().all(|p| (p.length() - 4.0).abs() < 0.02), "{:?}", frame.contour_mm);
    }
}

#[test]
fn frames_come_from_a_server_of_pyigtl() {
    let Some(python) = python() else { return };
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let server = thread::spawn(move || {
        python.run(
            &format!(
                r#"
import numpy as np, pyigtl, time
server = pyigtl.OpenIGTLinkServer({port}, local_server=True)
while not server.is_connected():
    time.sleep(0.01)
for k in range(6):
    matrix = np.eye(4); matrix[2, 3] = k
    transform = pyigtl.TransformMessage(matrix, device_name="ProbeToTracker", timestamp=1700000000 + k / 8)
    transform.header_version = 2
    transform.metadata = {{"TransformStatus": "OK"}}
    server.send_message(transform, wait=True)
    server.send_message(pyigtl.PointMessage(np.array([[k, 1, 0], [2, 3, 0]]), device_name="Contour",
                                            timestamp=1700000000 + k / 8), wait=True)
time.sleep(0.5)
server.stop()
"#
            ),
            &[],
        )
    });
    let mut source = Source::new(&SourceOptions::default()).unwrap();
    let begun = Instant::now();
    while source.connect(&port.to_string()).is_err() {
        assert!(begun.elapsed() < Duration::from_secs(60), "pyigtl does not listen");
        thread::sleep(Duration::from_millis(50));
    }
    let frames: Vec<Frame> = source.by_ref().take(6).map(|frame| frame.unwrap()).collect();
    for (k, frame) in frames.iter().enumerate() {
        let k = k as f64;
        assert_eq!(frame.world_from_sensor.translation_mm, DVec3::new(0.0, 0.0, k));
        assert_eq!(frame.contour_mm, [DVec2::new(k, 1.0), DVec2::new(2.0, 3.0)]);
    }
    drop(source);
    server.join().unwrap();
}

/// Gives its bytes in small pieces, and nothing in between, as a socket with a timeout does.
struct Trickle {
    bytes: Vec<u8>,
    at: usize,
    reads: usize,
}

impl Read for Trickle {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.reads += 1;
        if self.reads.is_multiple_of(3) {
            return Err(ErrorKind::WouldBlock.into());
        }
        let count = (self.reads % 7 + 1).min(buffer.len()).min(self.bytes.len() - self.at);
        buffer[..count].copy_from_slice(&self.bytes[self.at..self.at + count]);
        self.at += count;
        Ok(count)
    }
}

/// A message whose kind is another one.
fn renamed(message: &Message, kind: &[u8; 12]) -> Vec<u8> {
    let mut bytes = message.encode().unwrap();
    bytes[2..14].copy_from_slice(kind);
    bytes
}

#[test]
fn messages_come_in_pieces_and_what_is_unknown_or_broken_is_skipped() {
    let good = Message::new("Probe", start(), Content::Text("frame".into()));
    let mut broken = good.encode().unwrap();
    *broken.last_mut().unwrap() ^= 1;
    let mut too_long = renamed(&good, b"IMAGE\0\0\0\0\0\0\0");
    too_long[42..50].copy_from_slice(&((1_u64 << 26) + 1).to_be_bytes());
    let mut bytes = good.encode().unwrap();
    bytes.extend(renamed(&good, b"COMMAND\0\0\0\0\0"));
    bytes.extend(broken);
    bytes.extend(good.clone().with_metadata("a", "b").encode().unwrap());
    bytes.extend(&bytes.clone()[..30]);
    let mut reader = MessageReader::new(Trickle { bytes, at: 0, reads: 0 });
    let mut silent = 0;
    let mut next = || loop {
        match reader.step() {
            Step::Silent => silent += 1,
            step => break step,
        }
    };
    assert!(matches!(next(), Step::Message(message) if message == good));
    assert!(matches!(next(), Step::Unknown));
    assert!(matches!(next(), Step::Refused(error) if error.to_string().contains("checksum")));
    assert!(matches!(next(), Step::Message(message) if message.metadata("a") == Some("b")));
    assert!(matches!(next(), Step::Closed(Ok(()))));
    assert!(silent > 20);

    // What is no header is the end; a body that is too long for its kind is skipped, as far as it may be.
    too_long.resize(58 + (1 << 26) + 1, 0);
    too_long.extend(good.encode().unwrap());
    let mut reader = MessageReader::new(&too_long[..]);
    assert!(matches!(reader.step(), Step::Refused(error) if error.to_string().contains("67108865 of IMAGE")));
    assert!(matches!(reader.step(), Step::Message(_)));
    let mut garbage = good.encode().unwrap();
    garbage[0] = 7;
    assert!(matches!(MessageReader::new(&garbage[..]).step(), Step::Lost(_)));
    let mut endless = renamed(&good, b"VIDEO\0\0\0\0\0\0\0");
    endless[42] = 1;
    assert!(matches!(MessageReader::new(&endless[..]).step(), Step::Lost(_)));
}

#[test]
fn a_server_that_comes_back_is_found_again_and_one_that_does_not_ends_the_source() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let options = SourceOptions::default().with_give_up_s(2.0);
    let mut source = Source::new(&options).unwrap();
    source.connect(&address.to_string()).unwrap();
    let serve = move |listener: TcpListener, k: usize| {
        let (stream, _) = listener.accept().unwrap();
        let mut asked = [0; 58];
        (&stream).read_exact(&mut asked).unwrap();
        let header = Header::decode(&asked).unwrap();
        assert_eq!((header.version, header.kind.as_str()), (2, "GET_STATUS"));
        let pose = Pose { translation_mm: DVec3::X * k as f64, ..Pose::IDENTITY };
        for message in messages_of(&Frame::new(pose, vec![DVec2::ONE]), start().plus_s(k as f64)) {
            send(&stream, &message);
        }
    };
    let server = thread::spawn(move || {
        serve(listener, 0);
        let begun = Instant::now();
        let again = loop {
            match TcpListener::bind(address) {
                Ok(listener) => break listener,
                Err(error) => assert!(begun.elapsed() < Duration::from_secs(60), "{error}"),
            }
            thread::sleep(Duration::from_millis(20));
        };
        serve(again, 1);
    });
    let counts = source.counts();
    let (mut frames, mut faults) = (Vec::new(), Vec::new());
    for frame in source {
        match frame {
            Ok(frame) => frames.push(frame.world_from_sensor.translation_mm.x),
            Err(error) => faults.push(error.to_string()),
        }
    }
    server.join().unwrap();
    assert_eq!(frames, [0.0, 1.0]);
    assert_eq!(faults.len(), 2, "{faults:?}");
    assert!(faults[0].contains(&address.to_string()), "{faults:?}");
    assert_eq!((counts.now().traffic.connections, counts.now().traffic.connections_ended), (2, 2));
    let gone = Source::new(&options).unwrap().connect(&address.to_string());
    assert!(matches!(gone, Err(Error::Connection { address: named, .. }) if named == address.to_string()));
}

/// A client that has asked for the status with some version of header, and reads.
struct Viewer {
    reader: MessageReader<TcpStream>,
    /// What came before its turn.
    passed: Vec<Message>,
}

impl Viewer {
    fn new(server: &Server, version: u16) -> Self {
        let stream = TcpStream::connect(server.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let asked = Message::new("viewer", Timestamp::now(), Content::GetStatus).with_version(version);
        send(&stream, &asked);
        let mut viewer = Self { reader: MessageReader::new(stream), passed: Vec::new() };
        // Where it is answered, the server knows the version.
        viewer.next("STATUS");
        viewer
    }

    /// The next message of that kind; panics where the connection ends before.
    fn next(&mut self, kind: &str) -> Message {
        self.before_the_end(kind).unwrap_or_else(|| panic!("no {kind} before the end"))
    }

    fn before_the_end(&mut self, kind: &str) -> Option<Message> {
        if let Some(k) = self.passed.iter().position(|message| message.content.kind() == kind) {
            return Some(self.passed.remove(k));
        }
        loop {
            match self.reader.step() {
                Step::Message(message) if message.content.kind() == kind => return Some(message),
                Step::Message(message) => self.passed.push(message),
                Step::Closed(_) => return None,
                step => panic!("{step:?}"),
            }
        }
    }

    /// Points of the next vessel.
    fn points(&mut self) -> usize {
        let Content::PolyData(data) = self.next("POLYDATA").content else { panic!() };
        data.points_mm.len()
    }
}

#[test]
fn each_client_gets_its_version_and_who_comes_late_the_newest_vessel() {
    let server = Server::start("127.0.0.1:0").unwrap();
    assert!(!server.wants_vessel());
    server.send_vessel(&Surface::default());
    server.send_vessel(&vessel(3));
    let (mut old, mut new) = (Viewer::new(&server, 1), Viewer::new(&server, 2));
    for viewer in [&mut old, &mut new] {
        let content = viewer.next("POLYDATA").content;
        assert_eq!(content, Content::PolyData(PolyData::of_surface(&vessel(3))));
    }
    server.send_vessel(&vessel(4));
    for (viewer, version) in [(&mut old, 1), (&mut new, 2)] {
        let message = viewer.next("POLYDATA");
        assert_eq!((message.version, message.device.as_str()), (version, "Lumen"));
        assert_eq!(message.content, Content::PolyData(PolyData::of_surface(&vessel(4))));
    }
    assert_eq!(server.clients(), 2);
    server.send_tip(Pose::LOST, None);
    server.send_status("lost");
    let lost = new.next("TRANSFORM");
    assert_eq!(lost.metadata("TransformStatus"), Some("INVALID"));
    old.next("STATUS");
    server.send_tip(tip(), Some(2.5));
    let found = old.next("TRANSFORM");
    assert_eq!((found.version, found.content), (1, Content::Transform(rows(&tip()))));
    let found = new.next("TRANSFORM");
    assert_eq!((found.metadata("TransformStatus"), found.metadata("FrameTime")), (Some("OK"), Some("2.5")));
    assert!(server.send_text(&"x".repeat(65_536)).is_err());
    server.send_text("{}").unwrap();
    assert_eq!(new.next("STRING").content, Content::Text("{}".into()));
}

#[test]
fn a_client_that_does_not_read_keeps_nobody_waiting() {
    let options = ServerOptions::default().with_vessel_interval_s(0.0);
    let server = Server::with_options("127.0.0.1:0", &options).unwrap();
    let asleep = TcpStream::connect(server.address()).unwrap();
    let mut viewer = Viewer::new(&server, 2);
    // More than all buffers of a connection hold.
    let vessels: Vec<Surface> = [900, 901, 902].map(vessel).to_vec();
    for surface in vessels.iter().cycle().take(60) {
        server.send_vessel(surface);
        server.send_tip(tip(), None);
        viewer.next("TRANSFORM");
    }
    server.send_vessel(&vessel(2));
    while viewer.points() != 48 {}
    // The viewer has all; the one who sleeps has not.
    let begun = Instant::now();
    while !server.wants_vessel() {
        assert!(begun.elapsed() < Duration::from_secs(60));
    }
    drop(server);
    assert_eq!(viewer.before_the_end("POLYDATA"), None);
    drop(asleep);
}

#[test]
fn what_was_sent_last_arrives_though_the_server_ends() {
    let server = Server::start("127.0.0.1:0").unwrap();
    let mut viewers: Vec<Viewer> = (0..3).map(|_| Viewer::new(&server, 1)).collect();
    server.send_vessel(&vessel(400));
    server.send_status("done");
    drop(server);
    for viewer in &mut viewers {
        assert_eq!(viewer.points(), 16 * 401);
        assert_eq!(viewer.before_the_end("POLYDATA"), None);
    }
}

#[test]
fn a_crowd_is_turned_away() {
    let server = Server::start("127.0.0.1:0").unwrap();
    let viewers: Vec<Viewer> = (0..MAX_CLIENTS).map(|_| Viewer::new(&server, 1)).collect();
    let mut turned_away = TcpStream::connect(server.address()).unwrap();
    turned_away.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    assert_eq!(turned_away.read(&mut [0; 1]).unwrap_or(0), 0);
    drop(viewers);
    // Places are free again when those who went are noticed.
    let begun = Instant::now();
    while server.clients() > 0 {
        assert!(begun.elapsed() < Duration::from_secs(60));
        thread::sleep(Duration::from_millis(5));
    }
    thread::sleep(Duration::from_millis(100));
    Viewer::new(&server, 1);
    let taken = Server::start(&server.address().to_string());
    assert!(matches!(taken, Err(Error::Connection { .. })));
}

#[test]
fn a_source_is_stopped_from_outside_whatever_it_waits_for() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut source = Source::new(&SourceOptions::default()).unwrap();
    source.connect(&listener.local_addr().unwrap().to_string()).unwrap();
    source.listen("127.0.0.1:0").unwrap();
    let stopper = source.stopper();
    let reading = thread::spawn(move || frames_of(source).len());
    thread::sleep(Duration::from_millis(50));
    stopper.stop();
    assert_eq!(reading.join().unwrap(), 0);
    assert!(Source::new(&SourceOptions::default()).unwrap().next().is_none(), "no connection, no frame");
    assert!(Source::new(&SourceOptions::default().with_give_up_s(f64::NAN)).is_err());
}

/// This process's threads whose names are those of connections. In a process of its own: other tests have
/// such threads too.
#[cfg(target_os = "linux")]
#[test]
fn no_thread_is_left() {
    const ALONE: &str = "LUMENMESH_TEST_ALONE";
    if std::env::var_os(ALONE).is_none() {
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "openigtlink::no_thread_is_left", "--nocapture"])
            .env(ALONE, "1")
            .output()
            .unwrap();
        let text = [output.stdout, output.stderr].concat();
        let text = String::from_utf8_lossy(&text);
        assert!(output.status.success() && text.contains("1 passed"), "{text}");
        return;
    }
    let threads = || {
        let names = std::fs::read_dir("/proc/self/task")
            .unwrap()
            .filter_map(|task| std::fs::read_to_string(task.unwrap().path().join("comm")).ok());
        names.filter(|name| name.starts_with("openigtlink ")).count()
    };
    assert_eq!(threads(), 0);
    let plus = Server::start("127.0.0.1:0").unwrap();
    let mut source = Source::new(&SourceOptions::default()).unwrap();
    source.connect(&plus.address().to_string()).unwrap();
    let server = source.listen("127.0.0.1:0").unwrap();
    let asleep = TcpStream::connect(server.address()).unwrap();
    let mut viewer = Viewer::new(&server, 2);
    server.send_vessel(&vessel(2000));
    viewer.points();
    let within_s = |seconds, what: &str, is_so: &dyn Fn(usize) -> bool| {
        let deadline = Instant::now() + Duration::from_secs(seconds);
        while !is_so(threads()) {
            assert!(Instant::now() < deadline, "{} threads: {what}", threads());
            thread::sleep(Duration::from_millis(1));
        }
    };
    // Connections are taken up when their turn comes.
    within_s(30, "two servers, a client, and two for each connection", &|count| count >= 8);
    drop(source);
    drop(server);
    drop(plus);
    // They have been joined; the system may still list one for a moment.
    within_s(1, "none once the servers and the client are gone", &|count| count == 0);
    drop(asleep);
}
