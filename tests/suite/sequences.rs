//! Sequence files of PLUS and 3D Slicer, as they occur and as they are written.

use crate::support::{lumenmesh, python_with, shared};
use glam::{DQuat, DVec2, DVec3};
use lumenmesh::geometry::Pose;
use lumenmesh::recording::{Frame, ReadOptions, Recording, Sequence, Summary, Timestamps};
use std::path::{Path, PathBuf};

/// All real files.
const FILES: [&str; 8] = [
    "NrrdSample.igs.nrrd",
    "NwirePhantomFreehandCropped.igs.mha",
    "Prostate10_tracker.igs.mha",
    "SlidingProbeTrackingData.igs.mha",
    "SyntheticTrackerBuffer20.igs.mha",
    "TransformInterpolationTest.igs.mha",
    "UsSimulatorOutputSpinePhantom2CurvilinearBaselineNoUS.igs.mha",
    "UsSimulatorOutputSpinePhantom2CurvilinearBaselineNoUSCompressed.igs.mha",
];

/// What another reader finds: a line for each transform with the counts of its statuses, then the times, then the images.
const READER: &str = r#"
import collections, re, sys
import numpy as np
path = sys.argv[1]
if path.endswith("nrrd"):
    import nrrd
    data, header = nrrd.read(path, index_order="C")
    items = [(k, str(v)) for k, v in header.items()]
    shape = data.shape if data.ndim == 3 else (1,) + data.shape
else:
    import SimpleITK as sitk
    # Its reader of MetaImage takes no image of 0 × 0 pixels: there the fields are read by hand.
    lines = open(path, "rb").read().split(b"ElementDataFile")[0].decode("latin-1").splitlines()
    items = [tuple(part.strip() for part in line.split("=", 1)) for line in lines if "=" in line]
    shape = None
    if dict(items)["DimSize"].split()[0] != "0":
        image = sitk.ReadImage(path)
        shape = sitk.GetArrayFromImage(image).shape
        meta = {k: image.GetMetaData(k).strip() for k in image.GetMetaDataKeys() if k.startswith("Seq_")}
        ours = {k: v for k, v in items if k.startswith("Seq_")}
        assert meta == ours, "SimpleITK reads other fields"
        data = sitk.GetArrayFromImage(image)
frames = collections.defaultdict(dict)
for name, value in items:
    match = re.match(r"Seq_Frame(\d+)_(.*)", name)
    if match:
        frames[int(match[1])][match[2]] = value.strip()
transforms = sorted({f[:-9] for frame in frames.values() for f in frame if f.endswith("Transform")})
for t in transforms:
    statuses = collections.Counter(
        frame.get(t + "TransformStatus", "not stated") if t + "Transform" in frame else "absent"
        for frame in frames.values())
    print("transform", t, " ".join(f"{s}={n}" for s, n in sorted(statuses.items())))
    for number, frame in sorted(frames.items()):
        if frame.get(t + "TransformStatus", "OK") == "OK" and t + "Transform" in frame:
            m = [float(x) for x in frame[t + "Transform"].split()]
            print("pose", number, m[3], m[7], m[11])
        else:
            print("pose", number, "none")
print("times", *[float(frame["Timestamp"]) for _, frame in sorted(frames.items()) if "Timestamp" in frame])
if shape is not None:
    print("images", *shape, *[int(s) for s in data.reshape(shape[0], -1).astype(np.int64).sum(axis=1)])
"#;

/// The same in this project's words.
fn ours(path: &Path) -> String {
    let sequence = Sequence::read(path).unwrap();
    let contents = sequence.contents();
    let mut text = String::new();
    let folder = tempfile::tempdir().unwrap();
    let contours = folder.path().join("contours.csv");
    std::fs::write(&contours, "frame,x_mm,y_mm\n0,1,0\n").unwrap();
    let contours = Some(contours).filter(|_| contents.contours == 0);
    for transform in &contents.transforms {
        let statuses: Vec<String> =
            transform.statuses.iter().map(|(status, count)| format!("{status}={count}")).collect();
        text += &format!("transform {} {}\n", transform.name, statuses.join(" "));
        let options = ReadOptions::default()
            .with_transform(Some(transform.name.clone()))
            .with_contours(contours.clone());
        let recording = sequence.recording(&options).unwrap();
        for (k, frame) in recording.frames.iter().enumerate() {
            let p = frame.world_from_sensor.translation_mm;
            let number = recording.number(k);
            match p.is_nan() {
                true => text += &format!("pose {number} none\n"),
                false => text += &format!("pose {number} {:?} {:?} {:?}\n", p.x, p.y, p.z),
            }
        }
    }
    let times: Vec<f64> = match contents.transforms.first() {
        None => Vec::new(),
        Some(first) => {
            let options = ReadOptions::default()
                .with_transform(Some(first.name.clone()))
                .with_contours(contours.clone());
            sequence.recording(&options).unwrap().frames.iter().filter_map(|frame| frame.time_s).collect()
        }
    };
    text += &format!("times {}\n", times.iter().map(|t| format!("{t:?}")).collect::<Vec<_>>().join(" "));
    if let Some(images) = contents.images {
        let sums = sequence.images().unwrap().map(|image| {
            let (_, image) = image.unwrap();
            image.pixels.iter().map(|&p| p as i64).sum::<i64>().to_string()
        });
        let sums: Vec<String> = sums.collect();
        text += &format!("images {} {} {} {}\n", images.count, images.height, images.width, sums.join(" "));
    }
    text
}

/// Lines of words and numbers, the numbers compared as numbers.
fn assert_same(ours: &str, theirs: &str, what: &str) {
    let lines = |text: &str| text.lines().map(|line| line.trim().to_owned()).collect::<Vec<_>>();
    let (ours, theirs) = (lines(ours), lines(theirs));
    assert_eq!(ours.len(), theirs.len(), "{what}");
    for (a, b) in ours.iter().zip(&theirs) {
        let words = |line: &str| line.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let same = |a: &String, b: &String| match (a.parse::<f64>(), b.parse::<f64>()) {
            (Ok(a), Ok(b)) => a == b,
            _ => a == b,
        };
        let (wa, wb) = (words(a), words(b));
        assert!(wa.len() == wb.len() && wa.iter().zip(&wb).all(|(a, b)| same(a, b)), "{what}: {a} / {b}");
    }
}

#[test]
fn every_real_file_reads_as_another_reader_reads_it() {
    let Some(python) = python_with("SimpleITK, nrrd, numpy") else { return };
    for name in FILES {
        let Some(path) = shared(&format!("data/igs/{name}")) else { return };
        assert_same(&ours(&path), &python.run(READER, &[&path]), name);
    }
}

#[test]
#[should_panic(expected = "pose 1 2.0 3.0 4.5")]
fn a_pose_of_another_reader_that_differs_is_told() {
    assert_same(
        "transform A OK=1\npose 1 2.0 3.0 4.5\n",
        "transform A OK=1\npose 1 2.0 3.0 4.0\n",
        "made up",
    );
}

/// Three frames with what a sequence file can hold.
fn recording() -> Recording {
    let frame = |k: usize| {
        let q = DQuat::from_xyzw(0.1, 0.2 * k as f64, -0.3, 0.9).normalize();
        let contour = (0..97).map(|j| match j % 10 {
            3 => DVec2::NAN,
            _ => DVec2::from_angle(f64::from(j) / 97.0 * 6.3) * (10.0 + k as f64 / 3.0),
        });
        Frame::new(Pose::from_quaternion(DVec3::new(1.0 / 3.0, -400.0, 2.0 * k as f64), q), contour.collect())
            .with_time_s(Some(1000.0 + k as f64 / 12.0))
            .with_number(Some(2 * k + 1))
    };
    Recording { frames: (0..3).map(frame).collect() }
}

fn same(a: &Recording, b: &Recording) -> bool {
    let points = |r: &Recording| {
        let points = r.frames.iter().flat_map(|f| f.contour_mm.iter().flat_map(|p| [p.x, p.y]));
        points.map(|x| if x.is_nan() { u64::MAX } else { x.to_bits() }).collect::<Vec<_>>()
    };
    let others = |r: &Recording| {
        let other = |k: usize| (r.frames[k].world_from_sensor, r.frames[k].time_s, r.number(k));
        (0..r.frames.len()).map(other).collect::<Vec<_>>()
    };
    points(a) == points(b) && others(a) == others(b)
}

const ENDINGS: [&str; 5] = ["igs.mha", "igs.mhd", "seq.mha", "igs.nrrd", "seq.nrrd"];

#[test]
fn what_is_written_comes_back_and_other_readers_take_it() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recording();
    for ending in ENDINGS {
        let path = folder.path().join(format!("rec.{ending}"));
        recording.write(&path).unwrap();
        assert!(same(&Recording::read(&path).unwrap(), &recording), "{ending}");
        let header = std::fs::read(&path).unwrap();
        assert!(
            header.split(|&b| b == b'\n').all(|line| line.len() <= 999),
            "{ending}: a line is cut elsewhere"
        );
    }
    let mut other = recording.clone();
    other.frames[1].contour_mm[5].x += 1e-12;
    assert!(!same(&other, &recording));
    let Some(python) = python_with("SimpleITK, nrrd, numpy") else { return };
    // Without gaps, so that each image has its frame.
    let mut recording = recording;
    recording.frames.iter_mut().for_each(|frame| frame.number = None);
    for ending in ENDINGS {
        let path = folder.path().join(format!("rec.{ending}"));
        recording.write(&path).unwrap();
        let theirs = python.run(READER, &[&path]);
        assert!(
            theirs.contains("transform ProbeToTracker OK=3") && theirs.contains("images 3 1 1"),
            "{theirs}"
        );
        assert_same(&ours(&path), &theirs, ending);
    }
}

/// A header that PLUS might write, with everything that is unusual.
fn header() -> String {
    let mut text = "ObjectType = Image\r\nNDims = 3\r\nDimSize = 0 0 5   \r\nKinds = domain domain list\r\n\
        ElementType = MET_OTHER\r\nUltrasoundImageOrientation = BRIGHTNESSBRIGHTNESS\r\na line without a sign\r\n"
        .to_owned();
    let matrix = |x: f64| format!("1 0 0  {x} 0 1 0 -0 0 0 1 2.8e-005 0 0 0 1 ");
    for (number, status) in
        [(0, Some("OK ")), (1, Some("INVALID")), (3, None), (7, Some("MISSING")), (8, Some("OK"))]
    {
        let prefix = format!("Seq_Frame{number:04}_");
        text += &format!("{prefix}ProbeToTrackerTransform ={}\r\n", matrix(10.0 + f64::from(number)));
        if let Some(status) = status {
            text += &format!("{prefix}ProbeToTrackerTransformStatus = {status}\r\n");
        }
        if number < 8 {
            text += &format!("{prefix}ReferenceToTrackerTransform = {}\r\n", matrix(4.0));
        }
        text +=
            &format!("{prefix}Timestamp = {}\r\n{prefix}UnfilteredTimestamp = {}\r\n", number, number + 100);
        text += &format!("{prefix}LumenContourX0 = 1 0\r\n{prefix}LumenContourX1 = -1\r\n");
        text += &format!("{prefix}LumenContourY = 0 1 nan\r\n");
    }
    text + "ElementDataFile = LOCAL\r\n"
}

fn file(text: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec.igs.mha");
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

#[test]
fn only_ok_counts_and_chains_are_resolved() {
    let (_folder, path) = file(&header());
    let read = |transform: &str| {
        let options = ReadOptions::default().with_transform(Some(transform.into()));
        Recording::read_with(&path, &options).unwrap()
    };
    let x = |recording: &Recording| -> Vec<f64> {
        recording.frames.iter().map(|f| f.world_from_sensor.translation_mm.x).collect()
    };
    let direct = read("ProbeToTrackerTransform");
    assert_eq!((0..5).map(|k| direct.number(k)).collect::<Vec<_>>(), [0, 1, 3, 7, 8]);
    let lost = [f64::NAN; 2];
    assert_eq!(format!("{:?}", x(&direct)), format!("{:?}", [10.0, lost[0], 13.0, lost[1], 18.0]));
    assert_eq!(direct.frames[2].contour_mm[1], DVec2::Y);
    assert_eq!(direct.frames[2].contour_mm.len(), 3);
    // Frame 8 has no reference.
    let chain = read("ProbeToReference");
    assert_eq!(format!("{:?}", x(&chain)), format!("{:?}", [6.0, lost[0], 9.0, lost[1], f64::NAN]));
    let inverse = read("ReferenceToProbe");
    assert_eq!(x(&inverse)[0], -6.0);
    let times: Vec<_> = direct.frames.iter().map(|f| f.time_s.unwrap()).collect();
    assert_eq!(times, [0.0, 1.0, 3.0, 7.0, 8.0]);
    let unfiltered = ReadOptions::default().with_timestamps(Timestamps::Unfiltered);
    assert_eq!(Recording::read_with(&path, &unfiltered).unwrap().frames[0].time_s, Some(100.0));
    let summary = Summary::of(&direct);
    assert_eq!(summary.defects.iter().find(|d| d.field == "pose").unwrap().frames, 2);
    let contents = Sequence::read(&path).unwrap().contents();
    let counts: Vec<_> = contents.transforms[0].statuses.clone().into_iter().collect();
    let expected = [("INVALID", 1), ("MISSING", 1), ("OK", 2), ("not stated", 1)];
    assert_eq!(counts, expected.map(|(status, count)| (status.to_owned(), count)));
    assert_eq!((contents.frames, contents.gaps, contents.contours), (5, 4, 5));
}

#[test]
fn what_is_wrong_is_said_with_the_way_out() {
    let says = |text: &str, options: &ReadOptions, words: &[&str]| {
        let (_folder, path) = file(text);
        let message = Recording::read_with(&path, options).unwrap_err().to_string();
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    };
    let header = header();
    let named = |name: &str| ReadOptions::default().with_transform(Some(name.into()));
    let none = ReadOptions::default();
    says(&header, &named("NeedleToTracker"), &["NeedleToTracker", "ProbeToTracker, ReferenceToTracker"]);
    says(&header, &named("Tracker"), &["transform", "ProbeToTracker"]);
    says(&header.replace("LumenContour", "Other"), &none, &["contours", "--contours", "import mask"]);
    says(
        &header.replace("LumenContourY = 0 1 nan", "LumenContourY = 0 1"),
        &none,
        &["frame 0", "3 numbers", "2"],
    );
    says(&header.replace("0003_LumenContourY = 0", "0003_LumenContourY = x"), &none, &["frame 3", "\"x\""]);
    says(&header.replace("=1 0 0  13", "=1 0 0"), &none, &["frame 3", "16 numbers"]);
    says(
        &header.replace("0003_Timestamp = 3", "0003_Timestamp = soon"),
        &none,
        &["frame 3", "soon", "seconds"],
    );
    says(&header.replace("ElementDataFile", "Elements"), &none, &["header", "ElementDataFile"]);
    says("\u{0}\u{1}nothing", &none, &["another kind of file"]);
    says("", &none, &["another kind of file"]);
    says(&header.replace("0 0 0 1 \r\n", "0 0 1 1 \r\n"), &none, &["frame 0", "last row"]);
    let two = header.replace("ProbeToTracker", "StylusToTracker");
    says(&two, &none, &["ReferenceToTracker, StylusToTracker", "--transform"]);
    let singular = header.replace("Transform = 1 0 0", "Transform = 0 0 0");
    says(&singular, &named("ProbeToReference"), &["frame 0", "determinant 0"]);
    // An option of another kind of recording.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rec.mat");
    recording().write(&path).unwrap();
    let message = Recording::read_with(&path, &named("ProbeToTracker")).unwrap_err().to_string();
    assert!(message.contains("name of a transform") && message.contains("sequence file"), "{message}");
}

#[test]
fn contours_come_from_a_csv_file_by_the_numbers_of_the_frames() {
    let (folder, path) = file(&header().replace("LumenContour", "Other"));
    let contours = folder.path().join("contours.csv");
    let options = ReadOptions::default().with_contours(Some(contours.clone()));
    std::fs::write(&contours, "frame,x_mm,y_mm\n0,1,0\n0,0,1\n3,2,0\n").unwrap();
    let recording = Recording::read_with(&path, &options).unwrap();
    assert_eq!(recording.frames.iter().map(|f| f.contour_mm.len()).collect::<Vec<_>>(), [2, 0, 1, 0, 0]);
    std::fs::write(&contours, "frame,x_mm,y_mm\n0,1,0\n2,2,0\n").unwrap();
    let message = Recording::read_with(&path, &options).unwrap_err().to_string();
    assert!(message.contains("contours.csv: frame: found 2, expected a frame of rec.igs.mha"), "{message}");
}

#[test]
fn a_plus_configuration_completes_the_chain() {
    let (folder, path) = file(&header());
    let config = folder.path().join("plus.xml");
    let xml = r#"<?xml version="1.0"?><PlusConfiguration><CoordinateDefinitions>
        <Transform From="Tip" To="Probe" Matrix="1 0 0 0  0 1 0 0  0 0 1 7  0 0 0 1" Date="2026"/>
        <Transform From="Probe" To="Tracker" Matrix="1 0 0 99  0 1 0 0  0 0 1 7  0 0 0 1"/>
        </CoordinateDefinitions></PlusConfiguration>"#;
    std::fs::write(&config, xml).unwrap();
    let options = ReadOptions::default()
        .with_transform(Some("TipToTracker".into()))
        .with_plus_config(Some(config.clone()));
    let recording = Recording::read_with(&path, &options).unwrap();
    // What was measured stands above the configuration's.
    let p = recording.frames[0].world_from_sensor.translation_mm;
    assert_eq!(p, DVec3::new(10.0, 0.0, 7.0 + 2.8e-5));
    for broken in ["<PlusConfiguration/>", "<a", &xml.replace("0 0 0 1\" Date", "0 0 0\" Date")] {
        std::fs::write(&config, broken).unwrap();
        let message = Recording::read_with(&path, &options).unwrap_err().to_string();
        assert!(message.contains("plus.xml"), "{message}");
    }
}

#[test]
fn the_command_shows_what_a_sequence_has_and_lacks() {
    let (folder, _path) = file(&header().replace("LumenContour", "Other"));
    let (status, text, _) = lumenmesh(&["info", "rec.igs.mha"], folder.path());
    assert_eq!(status, 0);
    for words in ["ProbeToTracker: 1 INVALID, 1 MISSING, 2 OK, 1 not stated", "lacks", "--contours FILE"] {
        assert!(text.contains(words), "{text}");
    }
    let (status, json, _) = lumenmesh(&["info", "rec.igs.mha", "--json"], folder.path());
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((status, json["sequence"]["frames"].as_u64()), (0, Some(5)));
    let (status, _, said) = lumenmesh(&["reconstruct", "rec.igs.mha", "-o", "vessel.vtp"], folder.path());
    assert!(status == 1 && said.contains("lumenmesh import mask"), "{said}");
}

/// From a simulated recording to a mesh, by way of PLUS's format, without a bit lost.
#[test]
fn a_mesh_of_a_sequence_file_is_that_of_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    for rec in ["rec.mat", "rec.igs.mha"] {
        let (status, _, said) = lumenmesh(&["simulate", "--vessel", "cylinder", "-o", rec], folder.path());
        assert_eq!(status, 0, "{said}");
        let mesh = format!("{rec}.vtp");
        let (status, _, said) = lumenmesh(&["reconstruct", rec, "-o", &mesh], folder.path());
        assert_eq!(status, 0, "{said}");
    }
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("rec.mat.vtp"), bytes("rec.igs.mha.vtp"));
}
