//! Recordings and tables.

use crate::mutate::{File, fuzz, inputs};
use flate2::{Compression, write::ZlibEncoder};
use glam::{DQuat, DVec2, DVec3};
use hdf5_pure::{AttrValue, DatasetBuilder, FileBuilder};
use lumenmesh::anatomy::read_values;
use lumenmesh::geometry::Pose;
use lumenmesh::recording::{
    Curves, CylinderModel, Frame, MaskOptions, Masks, Pullback, PullbackOptions, PullbackPath, ReadOptions,
    Recording, Sequence, Summary,
};
use lumenmesh::simulate::Centreline;
use std::io::Write;
use std::path::Path;

/// Three frames of four rays, with everything that a recording may have.
fn recording() -> Recording {
    let axis = DVec3::new(0.3, 0.4, 1.0);
    let frame = |k: usize| {
        let pose = Pose::from_quaternion(DVec3::Z * k as f64, DQuat::from_rotation_z(0.1 * k as f64));
        let contour = [DVec2::X * 3.0, DVec2::Y * 2.5, DVec2::NAN, -DVec2::Y];
        Frame::new(pose, contour[..3 + k % 2].to_vec())
            .with_time_s(Some(0.1 * k as f64))
            .with_cylinder(Some(CylinderModel::from_axis(0.5, 0.25, axis, 4.0)))
            .with_number(Some(2 * k + 1))
    };
    Recording { frames: (0..3).map(frame).collect() }
}

/// What all readers of recordings promise: what was read can be summarised, and what passes the check can be
/// written.
fn reads(path: &Path) -> bool {
    let Ok(recording) = Recording::read_unchecked(path) else { return false };
    let _any = Summary::of(&recording).to_string();
    recording.check().is_ok()
}

/// A recording of level 5, as it is written.
fn mat() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec.mat");
    recording().write(&path).unwrap();
    std::fs::read(path).unwrap()
}

/// An element of a MAT-file of level 5.
fn element(kind: u32, bytes: &[u8]) -> Vec<u8> {
    let mut element = [kind.to_le_bytes(), (bytes.len() as u32).to_le_bytes()].concat();
    element.extend(bytes);
    element.resize(element.len().next_multiple_of(8), 0);
    element
}

/// A matrix of level 5, with its parts after the name.
fn matrix(class: u32, shape: &[u32], name: &str, parts: &[Vec<u8>]) -> Vec<u8> {
    let shape: Vec<u8> = shape.iter().flat_map(|size| size.to_le_bytes()).collect();
    let flags = [class.to_le_bytes(), [0; 4]].concat();
    let head = [element(6, &flags), element(5, &shape), element(1, name.as_bytes())].concat();
    element(14, &[head, parts.concat()].concat())
}

fn doubles(shape: &[u32], name: &str, values: &[f64]) -> Vec<u8> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    matrix(6, shape, name, &[element(9, &bytes)])
}

/// A recording of two frames in a struct: quaternions, cells of points, words for the poses.
fn mat_of_a_struct() -> Vec<u8> {
    let text = |word: &str| matrix(4, &[1, word.len() as u32], "", &[element(16, word.as_bytes())]);
    let contour = || doubles(&[3, 2], "", &[1.0, 0.0, -1.0, 0.0, 1.0, -1.0]);
    let fields = [
        ("quat_wxyz", doubles(&[2, 4], "", &[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
        ("Ep", doubles(&[2, 3], "", &[0.0, 0.0, 0.0, 0.0, 1.0, 2.0])),
        ("contours", matrix(1, &[1, 2], "", &[contour(), contour()])),
        ("status", matrix(1, &[2, 1], "", &[text("OK"), text("TOOL_OK")])),
        ("note", text("by hand")),
    ];
    let names: Vec<u8> = fields.iter().flat_map(|(name, _)| format!("{name:\0<12}").into_bytes()).collect();
    let mut parts = vec![element(5, &12_u32.to_le_bytes()), element(1, &names)];
    parts.extend(fields.into_iter().map(|(_, value)| value));
    [&mat()[..128], &matrix(2, &[1, 1], "rec", &parts)].concat()
}

/// The same file with each variable in a deflate stream.
fn compressed(plain: &[u8]) -> Vec<u8> {
    let (header, mut rest) = plain.split_at(128);
    let mut bytes = header.to_vec();
    while !rest.is_empty() {
        let size = 8 + u32::from_le_bytes(rest[4..8].try_into().unwrap()) as usize;
        let mut stream = ZlibEncoder::new(Vec::new(), Compression::fast());
        stream.write_all(&rest[..size]).unwrap();
        let stream = stream.finish().unwrap();
        bytes.extend([15_u32.to_le_bytes(), (stream.len() as u32).to_le_bytes()].concat());
        bytes.extend(stream);
        rest = &rest[size..];
    }
    bytes
}

const MAT_TOKENS: [&[u8]; 14] = [
    b"rotm\0\0\0\0",
    b"Ep",
    b"x_data",
    b"contours",
    b"status",
    &[14, 0, 0, 0],
    &[15, 0, 0, 0],
    &[1, 0, 4, 0],
    &[2, 0, 0, 0],
    &[6, 8, 0, 0, 0, 0, 0, 0],
    &[255, 255, 255, 127],
    &[0, 0, 0, 1],
    &[0, 0, 0, 0, 0, 0, 0xf0, 0x7f],
    &[0; 8],
];

#[test]
fn mat_files_of_version_5() {
    let file = File::new("rec.mat");
    let seeds = [mat(), mat_of_a_struct()];
    assert!(seeds.iter().all(|seed| reads(file.holding(seed))));
    let accepted = fuzz(&seeds, &MAT_TOKENS, |bytes| reads(file.holding(bytes)));
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

#[test]
fn compressed_mat_files() {
    let file = File::new("rec.mat");
    let seeds = [mat(), mat_of_a_struct()].map(|plain| compressed(&plain));
    assert!(seeds.iter().all(|seed| reads(file.holding(seed))));
    let accepted = fuzz(&seeds, &MAT_TOKENS, |bytes| reads(file.holding(bytes)));
    // What the mutations leave whole is the deflate stream of few inputs only: the others are mutated inside
    // it.
    let inside = fuzz(&[mat(), mat_of_a_struct()], &MAT_TOKENS, |bytes| {
        let variable = bytes.get(128..).unwrap_or_default();
        let mut stream = ZlibEncoder::new(Vec::new(), Compression::fast());
        stream.write_all(variable).unwrap();
        let stream = stream.finish().unwrap();
        let tag = [15_u32.to_le_bytes(), (stream.len() as u32).to_le_bytes()].concat();
        reads(file.holding(&[&bytes[..bytes.len().min(128)], &tag, &stream].concat()))
    });
    assert!(accepted + inside < 2 * inputs() && inside > 0, "{accepted} and {inside} accepted");
}

#[test]
fn mat_files_of_version_4() {
    let matrix = |name: &str, shape: [u32; 2], values: &[f64]| {
        let header = [0, shape[0], shape[1], 0, name.len() as u32 + 1];
        let mut bytes: Vec<u8> = header.iter().flat_map(|word| word.to_le_bytes()).collect();
        bytes.extend(name.bytes().chain([0]));
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    };
    let seed = [
        matrix("Ep", [2, 3], &[0.0, 0.0, 0.0, 0.0, 1.0, 2.0]),
        matrix("quat_xyzw", [2, 4], &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]),
        matrix("x_data", [2, 3], &[1.0, 1.0, 0.0, 0.0, -1.0, -1.0]),
        matrix("y_data", [2, 3], &[0.0, 0.0, 1.0, 1.0, -1.0, -1.0]),
        matrix("valid", [2, 1], &[1.0, 1.0]),
    ]
    .concat();
    let file = File::new("rec.mat");
    assert!(reads(file.holding(&seed)));
    let accepted = fuzz(&[seed], &MAT_TOKENS, |bytes| reads(file.holding(bytes)));
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

/// A recording of version 7.3 of two frames, the arrays in chunks or not.
fn mat_of_version_7_3(deflate: bool) -> Vec<u8> {
    let mut file = FileBuilder::new();
    let doubles = |dataset: &mut DatasetBuilder, shape: &[u64], values: &[f64]| {
        dataset.with_f64_data(values).with_shape(shape);
        dataset.set_attr("MATLAB_class", AttrValue::AsciiString("double".into()));
        if deflate {
            dataset.with_deflate(1);
        }
    };
    let mut cells = file.create_group("#refs#");
    doubles(cells.create_dataset("a"), &[2, 3], &[1.0, 0.0, -1.0, 0.0, 1.0, -1.0]);
    doubles(cells.create_dataset("b"), &[2, 2], &[1.0, 0.0, 0.0, 1.0]);
    file.add_group(cells.finish());
    let mut rec = file.create_group("rec");
    doubles(rec.create_dataset("Ep"), &[3, 2], &[0.0, 0.0, 0.0, 0.0, 1.0, 2.0]);
    doubles(rec.create_dataset("quat_wxyz"), &[4, 2], &[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    file.add_group(rec.finish());
    let contours = file.create_dataset("contours").with_path_references(&["/#refs#/a", "/#refs#/b"]);
    contours.with_shape(&[2, 1]).set_attr("MATLAB_class", AttrValue::AsciiString("cell".into()));
    file.finish().unwrap()
}

#[test]
fn mat_files_of_version_7_3() {
    let file = File::new("rec.mat");
    let seeds = [mat_of_version_7_3(false), mat_of_version_7_3(true)];
    assert!(seeds.iter().all(|seed| reads(file.holding(seed))));
    let accepted = fuzz(&seeds, &MAT_TOKENS, |bytes| reads(file.holding(bytes)));
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

const CSV_TOKENS: [&[u8]; 24] = [
    b",",
    b";",
    b"\t",
    b" ",
    b"\n",
    b"\r",
    b"\r\n",
    b"\"",
    b"\"\"",
    b"#",
    b"//",
    b"sep=;\n",
    b"nan",
    b"N/A",
    b"inf",
    b"1e308",
    b"-1",
    b"18446744073709551616",
    b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"\0",
    b"[cm]",
    b"\xb5m",
    b"OUT_OF_VIEW",
];

/// Gives a folder recording's file mutated contents, whereas the others are whole.
fn folder(mutated: &str, more: &[&[u8]]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec");
    recording().write(&path).unwrap();
    let file = path.join(mutated);
    let seeds: Vec<Vec<u8>> =
        [std::fs::read(&file).unwrap()].into_iter().chain(more.iter().map(|seed| seed.to_vec())).collect();
    let accepted = fuzz(&seeds, &CSV_TOKENS, |bytes| {
        std::fs::write(&file, bytes).unwrap();
        reads(&path)
    });
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

#[test]
fn poses() {
    let with_status = b"# tracker\nframe;t [ms];x;y;z;qx;qy;qz;qw;ToolStatus;note\n;ms;cm;cm;cm;;;;;;\n\
        1;0;0;0;0;0;0;0;1;OK;\n3;100;0;0;0,1;0;0;0;1;OK;\"a; b\"\n5;200;NA;NA;NA;NA;;;;MISSING;\"\n";
    folder("poses.csv", &[with_status]);
}

#[test]
fn contours() {
    let wide = b"frame,x0,y0,x1,y1,x2,y2\n1,3,0,0,2.5,-1,-1\n3,3,0,\"0,5\",2.5,,\n5,3,0,0,2,NaN,nan\n";
    folder("contours.csv", &[wide]);
}

#[test]
fn cylinders() {
    folder("cylinders.csv", &[b"frame px_cm py_cm theta_deg phi_deg radius_m\n3 0.1 0 80 70 0.004\n"]);
}

#[test]
fn pullbacks() {
    let seeds = [
        b"1\t1\t0\t0.5\n1\t0\t1\t0.5\n1\t-1\t-1\t0.5\n2\t1\t0\t1\n2\t0\t1\t1\n2\t-1\t-1\t1\n".to_vec(),
        b"z (mm);frame;x;y\n0,5;1;1;0\n0,5;1;0;1\n0,5;1;-1;-1\n".to_vec(),
    ];
    let file = File::new("pullback.csv");
    let accepted = fuzz(&seeds, &CSV_TOKENS, |bytes| {
        Pullback::read(file.holding(bytes), &PullbackOptions::default()).is_ok()
    });
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

#[test]
fn centrelines() {
    let seeds = [
        b"branch,s_mm,x_mm,y_mm,z_mm,r_inscribed_mm\n0,0,0,0,0,5\n0,1,0,0,1,5\n0,2,0,0.1,2,5\n".to_vec(),
        b"# branch x y z r_inscribed\n0 1 2 3 1\n0 1 2 4 1\n1 0 0 0 2\n1 0 0 1 2\n".to_vec(),
    ];
    let file = File::new("centreline.csv");
    let accepted = fuzz(&seeds, &CSV_TOKENS, |bytes| {
        let path = file.holding(bytes);
        let line = PullbackPath::read(path).map(|line| line.point_mm(line.length_mm() / 2.0));
        line.is_ok() & Centreline::read_branches(path).is_ok()
    });
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

#[test]
fn values_per_frame() {
    let seeds = [
        b"frame,phase,lumen_area\n1,D,18.9\n2,S,17\n3,D,\n".to_vec(),
        b"lumen_area\tframe\n1,5\t7\n".to_vec(),
    ];
    let file = File::new("by_hand.csv");
    let accepted = fuzz(&seeds, &CSV_TOKENS, |bytes| read_values(file.holding(bytes), "lumen_area").is_ok());
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

const SEQUENCE_TOKENS: [&[u8]; 20] = [
    b"Seq_Frame0001_",
    b"ProbeToTrackerTransform",
    b"TransformStatus",
    b"INVALID",
    b" = ",
    b":=",
    b": ",
    b"\r\n",
    b"\n\n",
    b"DimSize = 4294967295 4294967295 2",
    b"sizes: 0 1 18446744073709551615",
    b"kinds: list domain domain",
    b"LumenContourX0",
    b"CompressedData = True",
    b"encoding: gz",
    b"MET_DOUBLE",
    b"ElementDataFile = LOCAL",
    b"UltrasoundImageOrientation = NU",
    b"nan",
    b"1e308",
];

/// Files as they are written, and one with images of a lumen.
fn sequences(ending: &str) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("rec.{ending}"));
    recording().write(&path).unwrap();
    let mut seeds = vec![std::fs::read(&path).unwrap()];
    if ending == "mha" {
        let mut pixels = vec![0; 2 * 7 * 7];
        for frame in pixels.chunks_mut(49) {
            (0..25).for_each(|k| frame[(k / 5 + 1) * 7 + k % 5 + 1] = 255);
        }
        let mut text = "ObjectType = Image\nDimSize = 7 7 2\nElementType = MET_UCHAR\n".to_owned();
        for frame in 0..2 {
            let matrix = format!("1 0 0 0 0 1 0 0 0 0 1 {frame} 0 0 0 1");
            text += &format!("Seq_Frame{frame:04}_ProbeToTrackerTransform = {matrix}\n");
            text +=
                &format!("Seq_Frame{frame:04}_ImageToProbeTransform = 1 0 0 -3 0 1 0 -3 0 0 1 0 0 0 0 1\n");
        }
        seeds.push([(text + "ElementDataFile = LOCAL\n").as_bytes(), &pixels].concat());
    }
    seeds
}

fn sequence_files(ending: &str) {
    let file = File::new(&format!("rec.{ending}"));
    let accepted = fuzz(&sequences(ending), &SEQUENCE_TOKENS, |bytes| {
        let path = file.holding(bytes);
        let contents = Sequence::read(path).map(|sequence| sequence.contents().to_string());
        let masks = Masks::read(path, &ReadOptions::default(), &MaskOptions::default());
        contents.is_ok() & (reads(path) | masks.is_ok())
    });
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

#[test]
fn meta_image_sequences() {
    sequence_files("mha");
}

#[test]
fn nrrd_sequences() {
    sequence_files("nrrd");
}

#[test]
fn plus_configurations() {
    let seed = br#"<?xml version="1.0"?><PlusConfiguration><CoordinateDefinitions>
        <Transform From="Tip" To="Probe" Matrix="1 0 0 0 0 1 0 0 0 0 1 7 0 0 0 1"/></CoordinateDefinitions></PlusConfiguration>"#;
    let sequence = File::new("rec.mha");
    let path = sequence.holding(&sequences("mha")[0]);
    let file = File::new("plus.xml");
    let accepted = fuzz(&[seed.to_vec()], &[b"<", b"/>", b"\"", b"&amp;", b"To=", b"nan"], |bytes| {
        let options = ReadOptions::default()
            .with_transform(Some("TipToTracker".into()))
            .with_plus_config(Some(file.holding(bytes).to_owned()));
        Recording::read_with(path, &options).is_ok()
    });
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

#[test]
fn markups() {
    let seed = br#"{"markups":[{"type":"ClosedCurve","coordinateSystem":"LPS","coordinateUnits":"mm","controlPoints":[
        {"position":[1,0,0],"positionStatus":"defined"},{"position":[0,1,0]},{"position":[-1,-1,0.5]}]}]}"#;
    let file = File::new("curve.mrk.json");
    let tokens: [&[u8]; 8] = [b"1e308", b"null", b"[", b"]", b"{}", b"\"RAS\"", b",", b"-0.0"];
    let accepted =
        fuzz(&[seed.to_vec()], &tokens, |bytes| Curves::read(&[file.holding(bytes).to_owned()]).is_ok());
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

const JSON_TOKENS: [&[u8]; 16] = [
    b"null",
    b"NaN",
    b"1e308",
    b"-1e999",
    b"18446744073709551616",
    b"[[",
    b"]]",
    b"{}",
    b"\"pose\":",
    b"\"contour\":",
    b"\"time_s\":",
    b"\"frame\":",
    b"\"cylinder\":",
    b"\n",
    b"\\ud800",
    b"\xff",
];

#[test]
fn frames_as_json() {
    let file = File::new("rec.ndjson");
    let path = file.holding(b"").to_owned();
    recording().write(&path).unwrap();
    let seeds = [std::fs::read(path).unwrap()];
    assert!(seeds.iter().all(|seed| reads(file.holding(seed))));
    let accepted = fuzz(&seeds, &JSON_TOKENS, |bytes| reads(file.holding(bytes)));
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}

/// Poses in JSON, protobuf and CDR, and contours, in no chunks and without checksums.
#[cfg(feature = "mcap")]
fn mcap_files() -> Vec<Vec<u8>> {
    use mcap::records::MessageHeader;
    let json = br#"{"timestamp": {"sec": 1, "nsec": 5}, "parent_frame_id": "T", "child_frame_id": "P",
        "translation": {"x": 1, "y": 2, "z": 3}, "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}"#;
    let one = 1.0_f64.to_le_bytes();
    let cdr = [&[0, 1, 0, 0, 1, 0, 0, 0, 5, 0, 0, 0, 2, 0, 0, 0, b'T', 0, 0, 0][..], &one.repeat(7)];
    let protobuf = [&[10, 4, 8, 1, 16, 5, 18, 1, b'T', 26, 1, b'P', 34, 9, 9][..], &one, &[42, 9, 33], &one];
    let file = |schema: &str, encoding: &str, message: &[u8]| {
        let mut file = std::io::Cursor::new(Vec::new());
        let options = mcap::WriteOptions::new().use_chunks(false).calculate_data_section_crc(false);
        let mut writer = options.create(&mut file).unwrap();
        let mut add = |schema: &str, encoding: &str, message: &[u8]| {
            let id = writer.add_schema(schema, "jsonschema", b"{}").unwrap();
            let id = writer.add_channel(id, encoding, encoding, &Default::default()).unwrap();
            for k in 0..3 {
                let header =
                    MessageHeader { channel_id: id, sequence: k, log_time: 1_000_000_005, publish_time: 0 };
                writer.write_to_known_channel(&header, message).unwrap();
            }
        };
        add(schema, encoding, message);
        add(
            "lumenmesh.Frame",
            "json",
            br#"{"timestamp": {"sec": 1, "nsec": 5}, "contour": [[1, 2], null, [3, 1]]}"#,
        );
        writer.finish().unwrap();
        drop(writer);
        file.into_inner()
    };
    vec![
        file("foxglove.FrameTransform", "json", json),
        file("foxglove.FrameTransform", "protobuf", &protobuf.concat()),
        file("geometry_msgs/msg/PoseStamped", "cdr", &cdr.concat()),
    ]
}

#[cfg(feature = "mcap")]
#[test]
fn mcap_files_of_poses() {
    let file = File::new("rec.mcap");
    let seeds = mcap_files();
    for seed in &seeds {
        let read = Recording::read_unchecked(file.holding(seed)).unwrap();
        assert_eq!(read.frames.len(), 3);
        assert!(read.frames.iter().all(|frame| frame.world_from_sensor.is_finite()));
    }
    let accepts = |bytes: &[u8]| Recording::read_unchecked(file.holding(bytes)).is_ok();
    let accepted = fuzz(&seeds, &JSON_TOKENS, accepts);
    assert!(0 < accepted && accepted < inputs(), "{accepted} accepted");
}
