//! Messages of OpenIGTLink: bytes as they come over a connection, and contents with the right checksum.

use crate::mutate::{fuzz, inputs, mutated};
use glam::DVec2;
use lumenmesh::geometry::Pose;
use lumenmesh::openigtlink::{
    AssemblerOptions, Content, FrameAssembler, HEADER_BYTES, Header, ImageContent, Message, MessageReader,
    PolyData, Status, Step, Timestamp, Tool,
};
use lumenmesh::recording::{Frame, MaskOptions, PixelType};
use std::cell::RefCell;

/// What a message takes in memory at most, as its documentation says: eight times its bytes, and a little.
fn limit(bytes: usize) -> u64 {
    8 * bytes as u64 + (1 << 12)
}

fn messages() -> Vec<Message> {
    let matrix = [[1.0, 0.0, 0.0, 10.0], [0.0, 1.0, 0.0, 20.5], [0.0, 0.0, 1.0, -30.0]];
    let image = ImageContent {
        size: [4, 4, 1],
        components: 1,
        kind: PixelType::U8,
        big_endian: true,
        matrix,
        pixels: vec![0, 0, 0, 0, 0, 9, 9, 0, 0, 9, 9, 0, 0, 0, 0, 0],
    };
    let strip = PolyData {
        points_mm: vec![[1.0, 2.0, 3.0]; 4],
        strips: vec![vec![0, 1, 2, 3]],
        scalars: vec![("support".into(), vec![1.0; 4]), ("supported".into(), vec![0.0; 4])],
        ..PolyData::default()
    };
    let line =
        PolyData { points_mm: vec![[1.0, 2.0, 0.0]; 3], lines: vec![vec![0, 1, 2]], ..PolyData::default() };
    let frame = Frame::new(Pose::IDENTITY, vec![DVec2::new(0.1, 0.2), DVec2::NAN]).with_time_s(Some(1.5));
    let tool = Tool { name: "ProbeToTracker".into(), kind: 2, matrix };
    let contents = [
        ("ProbeToTracker", Content::Transform(matrix)),
        ("Tracker", Content::Tracking(vec![tool; 3])),
        ("Lumen", Content::Points(vec![[1.0, -2.0, 0.0], [0.5, 0.25, 0.0]])),
        ("Lumen", Content::PolyData(strip)),
        ("Lumen", Content::PolyData(line)),
        ("Lumen", Content::Image(image)),
        ("Lumen", Content::Text(frame.to_json())),
        ("Lumen", Content::Status(Status::ok("ready"))),
        ("Lumen", Content::StartTracking(50)),
    ];
    let of = |(k, (device, content)): (usize, (&str, Content))| {
        let time = Timestamp::from_s(1_700_000_000.0).plus_s(k as f64 / 64.0);
        let message = Message::new(device, time, content);
        let status = if k % 3 == 0 { "OK" } else { "INVALID" };
        [message.clone(), message.with_metadata("TransformStatus", status).with_metadata("a", "")]
    };
    contents.into_iter().enumerate().flat_map(of).collect()
}

const TOKENS: [&[u8]; 12] = [
    b"TRANSFORM\0\0\0",
    b"POLYDATA\0\0\0\0",
    b"IMAGE\0\0\0\0\0\0\0",
    b"POINT\0\0\0\0\0\0\0",
    b"STRING\0\0\0\0\0\0",
    b"TDATA\0\0\0\0\0\0\0",
    b"\0\0\0\0",
    b"\0\0\0\x01",
    b"\x7f\xc0\0\0",
    b"\x7f\x80\0\0",
    b"null",
    b"{\"pose\":",
];

fn assembler() -> FrameAssembler {
    let options = AssemblerOptions::default()
        .with_contour_device(Some("Lumen".into()))
        .with_mask(MaskOptions::default().with_points(8).with_pixel_mm(Some([0.5; 2])));
    FrameAssembler::new(options).unwrap()
}

/// Frames, whatever was sent, have contours of bounded length and poses that are lost or finite.
fn check(frames: &[Frame]) {
    for frame in frames {
        assert!(frame.contour_mm.len() <= 100_000);
        let pose = frame.world_from_sensor;
        assert!(pose.is_finite() || pose.translation_mm.is_nan(), "{pose:?}");
        assert!(frame.time_s.is_none_or(|s| !s.is_nan()));
    }
}

/// Streams of several messages, spoiled anywhere.
#[test]
fn openigtlink_streams() {
    let messages = messages();
    let stream = |k: usize| messages[k..k + 3].iter().flat_map(|m| m.encode().unwrap()).collect();
    let seeds: Vec<Vec<u8>> = (0..messages.len() - 2).map(stream).collect();
    let assembler = RefCell::new(assembler());
    let mut whole = MessageReader::new(&seeds[0][..]);
    assert!((0..3).all(|_| matches!(whole.step(), Step::Message(_))));
    let accepted = fuzz(&seeds, &TOKENS, |bytes| {
        let mut reader = MessageReader::new(bytes);
        let mut count = 0;
        loop {
            match reader.step() {
                Step::Message(message) => {
                    count += 1;
                    if let Ok(frames) = assembler.borrow_mut().push(&message) {
                        check(&frames);
                    }
                }
                Step::Unknown | Step::Refused(_) => {}
                _ => break,
            }
        }
        count == 3
    });
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

/// Bodies that say anything, with the right length and checksum: a value or an error, and no allocation that
/// the body's own length does not bear.
#[test]
fn openigtlink_bodies() {
    let bodies: Vec<Vec<u8>> = messages()
        .iter()
        .map(|message| {
            let bytes = message.encode().unwrap();
            // The version and the kind stay before the body.
            [&bytes[..14], &bytes[HEADER_BYTES..]].concat()
        })
        .collect();
    let assembler = RefCell::new(assembler());
    let largest = RefCell::new(0.0_f64);
    let read = |input: &[u8]| {
        if input.len() < 14 {
            return false;
        }
        let (start, body) = input.split_at(14);
        let mut header = [0; HEADER_BYTES];
        header[..14].copy_from_slice(start);
        header[14..19].copy_from_slice(b"Lumen");
        header[42..50].copy_from_slice(&(body.len() as u64).to_be_bytes());
        header[50..].copy_from_slice(&crc64(body).to_be_bytes());
        let mut found = None;
        let used = allocation_counter::measure(|| {
            found = Some(Header::decode(&header).and_then(|header| header.decode_body(body)));
        });
        assert!(used.bytes_max <= limit(body.len()), "{} bytes for {}", used.bytes_max, body.len());
        let share = used.bytes_max as f64 / body.len().max(1) as f64;
        let new = largest.borrow().max(if body.len() > 4096 { share } else { 0.0 });
        *largest.borrow_mut() = new;
        match found.unwrap() {
            Ok(message) => {
                if let Ok(frames) = assembler.borrow_mut().push(&message) {
                    check(&frames);
                }
                // What was understood can be sent, but for texts that grew where they were no UTF-8, and is the same then.
                if let Ok(sent) = message.encode() {
                    let (header, body) = sent.split_first_chunk().unwrap();
                    let back = Header::decode(header).unwrap().decode_body(body).unwrap();
                    assert!(back.encode().unwrap() == sent, "{message:?}\n{back:?}");
                }
                true
            }
            Err(error) => {
                assert!(error.to_string().len() < 1500);
                false
            }
        }
    };
    let accepted = fuzz(&bodies, &TOKENS, read);
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

/// Bodies that are all of what takes the most memory for its bytes.
#[test]
fn large_openigtlink_bodies_take_no_more_memory_than_is_stated() {
    let empty_lines = |count: u32| {
        let counts = [0, 0, 0, count, 4 * count, 0, 0, 0, 0, 0];
        let mut body: Vec<u8> = counts.iter().flat_map(|n: &u32| n.to_be_bytes()).collect();
        body.resize(40 + 4 * count as usize, 0);
        body
    };
    let metadata = |count: u16| {
        let mut body = vec![0, 12];
        body.extend((2 + 8 * count).to_be_bytes());
        body.extend([0; 8]);
        body.extend(count.to_be_bytes());
        body.resize(14 + 8 * usize::from(count), 0);
        body
    };
    let mut status = vec![0; 30];
    status.resize(1 << 20, 0xff);
    for (version, kind, body) in [
        (1_u16, "POLYDATA", empty_lines(200_000)),
        (2, "GET_STATUS", metadata(8000)),
        (1, "STATUS", status),
        (1, "POINT", vec![0; 136 * 5000]),
        (1, "TDATA", vec![b'x'; 70 * 5000]),
    ] {
        let mut bytes = version.to_be_bytes().to_vec();
        bytes.extend(kind.bytes());
        bytes.resize(42, 0);
        bytes.extend((body.len() as u64).to_be_bytes());
        bytes.extend(crc64(&body).to_be_bytes());
        let header = Header::decode(bytes[..].try_into().unwrap()).unwrap();
        let mut is_read = false;
        let used = allocation_counter::measure(|| is_read = header.decode_body(&body).is_ok());
        assert!(is_read, "{kind}");
        let share = used.bytes_max as f64 / body.len() as f64;
        println!("{kind}: {share:.2} times its bytes");
        assert!(used.bytes_max <= limit(body.len()), "{kind}: {share}");
    }
    let counted = allocation_counter::measure(|| drop(std::hint::black_box(vec![0_u8; 1 << 20])));
    assert!(counted.bytes_max >= 1 << 20, "allocations are seen");
    assert_ne!(mutated(&[vec![1; 64]], &TOKENS, 1), vec![1; 64], "inputs are mutated");
}

/// The checksum, bit by bit.
fn crc64(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |crc, &byte| {
        (0..8).fold(crc ^ (u64::from(byte) << 56), |crc: u64, _| {
            if crc >> 63 == 1 { (crc << 1) ^ 0x42f0_e1eb_a9ea_3693 } else { crc << 1 }
        })
    })
}
