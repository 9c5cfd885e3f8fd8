//! MCAP files: what ROS 2 and Foxglove write, and a mesh for Foxglove. Needs Python with mcap, numpy and scipy.

use crate::support::{Python, lumenmesh, python_with, tube};
use lumenmesh::geometry::Pose;
use lumenmesh::recording::{Frame, ReadOptions, Recording};
use lumenmesh::simulate::{Insertion, SimulationSettings};
use std::path::Path;

const WRITE: &str = include_str!("../support/write_mcap.py");

/// A folder with MCAP files of a recording, whose eighth frame has no pose.
fn folder(python: &Python) -> (tempfile::TempDir, Recording) {
    let folder = tempfile::tempdir().unwrap();
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    let mut recording = crate::support::vessel::simulated("cylinder", &settings).recording;
    recording.frames.truncate(120);
    recording.frames[7].world_from_sensor = Pose::LOST;
    recording.frames[9].contour_mm[3] = glam::DVec2::NAN;
    let path = folder.path().join("rec.ndjson");
    recording.write(&path).unwrap();
    python.run(WRITE, &[&path, folder.path()]);
    (folder, recording)
}

/// The largest difference of two frames' poses, mm and rotation, and whether all else is equal.
fn apart(a: &Frame, b: &Frame) -> (f64, bool) {
    let (p, q) = (&a.world_from_sensor, &b.world_from_sensor);
    let pose = match (p.is_finite(), q.is_finite()) {
        (false, false) => 0.0,
        _ => {
            let turn = (p.rotation - q.rotation)
                .to_cols_array()
                .into_iter()
                .fold(0.0, |most: f64, x| most.max(x.abs()));
            turn.max((p.translation_mm - q.translation_mm).abs().max_element())
        }
    };
    let times = a.time_s.zip(b.time_s).is_some_and(|(a, b)| (a - b).abs() < 1e-8);
    (pose, times && format!("{:?}", a.contour_mm) == format!("{:?}", b.contour_mm))
}

fn read(folder: &Path, name: &str, options: &ReadOptions) -> Result<Recording, String> {
    Recording::read_with(&folder.join(name), options).map_err(|e| e.to_string())
}

#[test]
fn poses_and_contours_are_those_that_were_written() {
    let Some(python) = python_with("mcap, numpy, scipy") else { return };
    let (folder, recording) = folder(&python);
    let plain = ReadOptions::default();
    for name in ["json", "protobuf", "tf", "pose", "whole"] {
        let read = read(folder.path(), &format!("{name}.mcap"), &plain).unwrap();
        assert_eq!(read.frames.len(), recording.frames.len());
        for (k, (found, sent)) in read.frames.iter().zip(&recording.frames).enumerate() {
            let (pose, others) = apart(found, sent);
            assert!(pose < 1e-10 && others, "{name} {k}: {pose}");
        }
        assert!(apart(&read.frames[3], &recording.frames[4]).0 > 1e-3, "the comparison sees differences");
    }
    // Poses 20 ms later: between two of them, and none beside the one that is missing or before the first.
    let between = read(folder.path(), "between.mcap", &plain).unwrap();
    let lost: Vec<usize> = (0..120).filter(|&k| !between.frames[k].world_from_sensor.is_finite()).collect();
    assert_eq!(lost, [0, 7, 8]);
    for k in [1, 60, 119] {
        let at = |k: usize| recording.frames[k].world_from_sensor.translation_mm;
        // Frames are 1/12 s apart.
        let expected = at(k - 1).lerp(at(k), 1.0 - 0.02 * 12.0);
        let found = between.frames[k].world_from_sensor;
        assert!((found.translation_mm - expected).length() < 1e-6, "{k}");
        assert!(found.orthogonality_error() < 1e-12);
    }
}

#[test]
fn a_choice_is_asked_for_and_what_is_there_is_listed() {
    let Some(python) = python_with("mcap, numpy, scipy") else { return };
    let (folder, recording) = folder(&python);
    let folder = folder.path();
    let plain = ReadOptions::default();
    let with = |topic: &str| plain.clone().with_topic(Some(topic.into()));
    let says = |name: &str, options: &ReadOptions, parts: &[&str]| {
        let message = read(folder, name, options).unwrap_err();
        parts.iter().for_each(|part| assert!(message.contains(part), "{message}"));
    };
    let listed = [
        "/pose: 119 poses",
        "/tf: 119 of ProbeToTracker",
        "/contour: 120 contours",
        "/log (std_msgs/msg/String, cdr)",
    ];
    says(
        "two.mcap",
        &plain,
        &[&listed[..], &["two.mcap: topics of poses: found ", "expected one, or its name (--topic"]].concat(),
    );
    says("two.mcap", &with("/else"), &[&listed[..], &["expected the topic /else"]].concat());
    says("tf.mcap", &plain.clone().with_transform(Some("A".into())), &["expected the transform A"]);
    says(
        "tf.mcap",
        &plain.clone().with_contour_topic(Some("/c".into())),
        &["topics of contours", "the topic /c of"],
    );
    for options in [with("/pose"), with("/tf"), plain.clone().with_transform(Some("ProbeToTracker".into()))] {
        let read = read(folder, "two.mcap", &options).unwrap();
        assert!(apart(&read.frames[50], &recording.frames[50]).0 < 1e-10);
    }
    // As a user runs it.
    let (status, out, _) = lumenmesh(&["reconstruct", "two.mcap", "-o", "v.vtp", "--topic", "/tf"], folder);
    assert!(status == 0 && out.contains("left out   1 of 120"), "{out}");
    let (status, _, said) =
        lumenmesh(&["reconstruct", "rec.ndjson", "-o", "v.vtp", "--topic", "/tf"], folder);
    assert!(status == 1 && said.contains("topic of poses"), "{said}");
    // A file that is cut, changed or of another kind.
    let whole = std::fs::read(folder.join("tf.mcap")).unwrap();
    for end in [0, 4, 8, 100, whole.len() / 2, whole.len() - 1] {
        std::fs::write(folder.join("cut.mcap"), &whole[..end]).unwrap();
        says("cut.mcap", &plain, &["cut.mcap: content: found "]);
    }
    for at in (100..whole.len()).step_by(whole.len() / 50) {
        let mut changed = whole.clone();
        changed[at] ^= 0x55;
        std::fs::write(folder.join("changed.mcap"), &changed).unwrap();
        drop(read(folder, "changed.mcap", &plain));
    }
}

#[test]
fn a_mesh_is_a_scene_for_foxglove() {
    let Some(python) = python_with("mcap, numpy, scipy") else { return };
    let folder = tempfile::tempdir().unwrap();
    let (mesh, path) = (tube(12, 5, 4.0, 10.0), folder.path().join("v.mcap"));
    mesh.write(&path).unwrap();
    let script = "
import json, sys
from mcap.reader import make_reader
[(schema, channel, message)] = make_reader(open(sys.argv[1], 'rb')).iter_messages()
[entity] = json.loads(message.data)['entities']
[mesh] = entity['triangles']
top = max(p['z'] for p in mesh['points'])
print(schema.name, channel.topic, channel.message_encoding, len(mesh['points']), len(mesh['indices']), top)";
    assert_eq!(python.run(script, &[&path]).trim(), "foxglove.SceneUpdate /lumen json 72 360 0.005");
}
