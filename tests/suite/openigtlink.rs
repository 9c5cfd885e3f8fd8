//! Messages of OpenIGTLink, against the Python implementation that others use.

use crate::support::python_with;
use lumenmesh::openigtlink::{Content, Header, Message, Timestamp};

fn decoded(bytes: &[u8]) -> Message {
    let (header, body) = bytes.split_first_chunk().unwrap();
    Header::decode(header).unwrap().decode_body(body).unwrap()
}

const MATRIX: [[f32; 4]; 3] = [[1.0, 2.0, 3.0, 4.5], [5.0, 6.0, 7.0, 8.25], [9.0, 10.0, 11.0, -12.0]];

#[test]
fn messages_of_pyigtl_are_read() {
    let Some(python) = python_with("pyigtl, numpy") else { return };
    let script = r#"
import numpy as np, pyigtl
matrix = np.array([[1, 2, 3, 4.5], [5, 6, 7, 8.25], [9, 10, 11, -12], [0, 0, 0, 1]])
for version in (1, 2):
    for message in (pyigtl.TransformMessage(matrix, device_name="ProbeToTracker", timestamp=1700000000.5),
                    pyigtl.StringMessage("lumen", device_name="Text", timestamp=0)):
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
    assert_eq!(messages.len(), 4);
    for (version, pair) in [(1, &messages[..2]), (2, &messages[2..])] {
        assert_eq!((pair[0].version, pair[0].device.as_str()), (version, "ProbeToTracker"));
        assert_eq!(pair[0].content, Content::Transform(MATRIX));
        assert!((pair[0].time.to_s() - 1_700_000_000.5).abs() < 1e-6);
        assert_eq!(pair[1].content, Content::Text("lumen".into()));
        assert_eq!(pair[0].metadata("TransformStatus"), (version == 2).then_some("OK"));
    }
}

#[test]
fn pyigtl_reads_our_messages() {
    let Some(python) = python_with("pyigtl, numpy") else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("messages");
    let mut bytes = Vec::new();
    for version in [1, 2] {
        for content in [Content::Transform(MATRIX), Content::Text("lumen".into())] {
            let mut message = Message::new("Tip", Timestamp::from_s(1_700_000_000.5), content);
            message.version = version;
            message.metadata.push(("TransformStatus".into(), "OK".into()));
            bytes.extend(message.encode().unwrap());
        }
    }
    std::fs::write(&path, bytes).unwrap();
    let script = r#"
import struct, sys
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
