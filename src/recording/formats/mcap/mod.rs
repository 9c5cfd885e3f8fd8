//! Recordings in MCAP files: poses of Foxglove and ROS 2, contours in JSON.
//!
//! | schema | encoding | |
//! |---|---|---|
//! | `foxglove.FrameTransform`, `foxglove.FrameTransforms` | `protobuf`, `json` | poses |
//! | `tf2_msgs/msg/TFMessage` | `cdr` | poses |
//! | `geometry_msgs/msg/PoseStamped` | `cdr` | poses |
//! | `lumenmesh.Frame` | `json` | contours: a [frame as JSON](Frame::from_json) with `timestamp` (`sec`, `nsec`) instead of `time_s`, and with or without `pose` |
//!
//! Positions are in metres, as ROS has them; contours in mm. A contour without a pose of its own has that of
//! its time: between two poses that are at most 0.1 s apart it is interpolated, and with a longer gap about it
//! there is none.

mod messages;

use super::ndjson;
use crate::geometry::Pose;
use crate::recording::{Frame, ReadOptions, Recording};
use crate::{Error, Result};
use glam::DQuat;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use messages::{PoseKind, StampedPose};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The largest record, and the largest content of a chunk, bytes.
const MAX_RECORD: usize = 1 << 28;
/// The most that is taken of all messages, bytes.
const MAX_TAKEN: u64 = 1 << 32;
/// Poses are interpolated over at most so much time, ns.
const MAX_GAP_NS: i64 = 100_000_000;

/// A topic that is understood.
#[derive(Clone)]
struct Topic {
    name: String,
    kind: Kind,
}

#[derive(Clone, Copy)]
enum Kind {
    Pose(PoseKind),
    Contour,
}

/// What a file has: poses by topic and by the names of the frames, contours by topic.
#[derive(Default)]
struct Contents {
    poses: BTreeMap<(String, String), Vec<StampedPose>>,
    contours: BTreeMap<String, Vec<Contour>>,
    /// Topics that are not understood, with their schemas.
    others: Vec<String>,
}

struct Contour {
    time_ns: i64,
    has_pose: bool,
    frame: Frame,
}

pub(in crate::recording) fn read(path: &Path, options: &ReadOptions) -> Result<Recording> {
    let contents = contents(path)?;
    let contours = contents.contours(path, options)?;
    let poses = match contours.iter().all(|contour| contour.has_pose) {
        true => Vec::new(),
        false => contents.poses(path, options)?,
    };
    let mut contours: Vec<&Contour> = contours.iter().collect();
    contours.sort_by_key(|contour| contour.time_ns);
    let first_ns = contours.first().map_or(0, |contour| contour.time_ns);
    let frame = |contour: &Contour| {
        let mut frame = contour.frame.clone();
        if !contour.has_pose {
            frame.world_from_sensor = pose_at(&poses, contour.time_ns);
            frame.orthonormalise();
        }
        let time_s = (contour.time_ns - first_ns) as f64 * 1e-9;
        frame.with_time_s(Some(time_s))
    };
    Ok(Recording { frames: contours.into_iter().map(frame).collect() })
}

/// The pose of a time; lost where there is none near enough.
fn pose_at(poses: &[StampedPose], time_ns: i64) -> Pose {
    let after = poses.partition_point(|pose| pose.time_ns < time_ns);
    let Some(later) = poses.get(after) else { return Pose::LOST };
    if later.time_ns == time_ns {
        return later.pose;
    }
    let Some(earlier) = after.checked_sub(1).map(|k| &poses[k]) else { return Pose::LOST };
    let gap_ns = later.time_ns.saturating_sub(earlier.time_ns);
    if gap_ns > MAX_GAP_NS || !earlier.pose.is_finite() || !later.pose.is_finite() {
        return Pose::LOST;
    }
    let share = (time_ns - earlier.time_ns) as f64 / gap_ns as f64;
    let turn = |pose: &Pose| DQuat::from_mat3(&pose.rotation).normalize();
    let between = turn(&earlier.pose).slerp(turn(&later.pose), share);
    Pose::from_quaternion(earlier.pose.translation_mm.lerp(later.pose.translation_mm, share), between)
}

impl Contents {
    /// The contours of the chosen topic, or of the only one.
    fn contours(&self, path: &Path, options: &ReadOptions) -> Result<&[Contour]> {
        let wanted = options.contour_topic.as_deref();
        let found: Vec<_> =
            self.contours.iter().filter(|(topic, _)| wanted.is_none_or(|wanted| wanted == *topic)).collect();
        match found[..] {
            [(_, contours)] => Ok(contours),
            _ => {
                let expected = match wanted {
                    Some(topic) => format!("the topic {topic} of lumenmesh.Frame in json"),
                    None if found.is_empty() => "a topic of lumenmesh.Frame in json".into(),
                    None => "one, or its name (--contour-topic)".into(),
                };
                Err(Error::input(path, "topics of contours", self.listed(), expected))
            }
        }
    }

    /// The poses of the chosen topic and transform, or the only ones, in the order of their times.
    fn poses(&self, path: &Path, options: &ReadOptions) -> Result<Vec<StampedPose>> {
        let (topic, transform) = (options.topic.as_deref(), options.transform.as_deref());
        let is_wanted = |(of, name): &(String, String)| {
            topic.is_none_or(|topic| topic == of) && transform.is_none_or(|transform| transform == name)
        };
        let found: Vec<_> = self.poses.iter().filter(|(key, _)| is_wanted(key)).collect();
        match found[..] {
            [(_, poses)] => {
                let mut poses = poses.clone();
                poses.sort_by_key(|pose| pose.time_ns);
                Ok(poses)
            }
            _ => {
                let expected = match (topic, transform) {
                    (None, None) if found.is_empty() => "transforms or poses".into(),
                    (None, None) => "one, or its name (--topic, --transform)".to_owned(),
                    (topic, transform) => {
                        let named = topic.map(|name| format!("topic {name}"));
                        let parts: Vec<String> = named
                            .into_iter()
                            .chain(transform.map(|name| format!("transform {name}")))
                            .collect();
                        format!("the {}", parts.join(", "))
                    }
                };
                Err(Error::input(path, "topics of poses", self.listed(), expected))
            }
        }
    }

    /// What is there, for messages.
    fn listed(&self) -> String {
        let poses = self.poses.iter().map(|((topic, name), poses)| match name.as_str() {
            "" => format!("{topic}: {} poses", poses.len()),
            name => format!("{topic}: {} of {name}", poses.len()),
        });
        let contours = self.contours.iter().map(|(topic, all)| format!("{topic}: {} contours", all.len()));
        let others = self.others.iter().cloned();
        let all: Vec<String> = poses.chain(contours).chain(others).collect();
        if all.is_empty() { "no topics".into() } else { all.join(", ") }
    }
}

/// Reads all messages that are understood.
fn contents(path: &Path) -> Result<Contents> {
    let unreadable = |source| Error::read(path, source);
    let broken = |e: mcap::McapError| Error::input(path, "content", e, "an MCAP file");
    let mut file = File::open(path).map_err(unreadable)?;
    let mut reader = LinearReader::new_with_options(
        LinearReaderOptions::default().with_record_length_limit(MAX_RECORD).with_validate_chunk_crcs(true),
    );
    let (mut schemas, mut topics) = (BTreeMap::new(), BTreeMap::new());
    let (mut contents, mut taken) = (Contents::default(), 0_u64);
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event.map_err(broken)? {
            LinearReadEvent::ReadRequest(bytes) => {
                let room = reader.insert(bytes.min(MAX_RECORD));
                let read = file.read(room).map_err(unreadable)?;
                reader.notify_read(read);
                continue;
            }
            LinearReadEvent::Record { opcode, data } => (opcode, data),
        };
        match mcap::parse_record(opcode, data).map_err(broken)? {
            Record::Schema { header, .. } => {
                schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = schemas.get(&channel.schema_id).map_or("", String::as_str);
                let kind = kind(schema, &channel.message_encoding);
                if kind.is_none() {
                    let other = format!("{} ({schema}, {})", channel.topic, channel.message_encoding);
                    if !contents.others.contains(&other) {
                        contents.others.push(other);
                    }
                }
                let topic = kind.map(|kind| Topic { name: channel.topic, kind });
                topics.insert(channel.id, topic);
            }
            Record::Message { header, data } => {
                let Some(Some(topic)) = topics.get(&header.channel_id) else { continue };
                taken += data.len() as u64;
                if taken > MAX_TAKEN {
                    return Err(Error::input(path, "messages", "more than 4 GiB", "less"));
                }
                let logged_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                contents.take(topic, &data, logged_ns).map_err(|found| {
                    let field = format!("message {} of {}", header.sequence, topic.name);
                    Error::input(path, field, found, "what its schema says")
                })?;
            }
            _ => {}
        }
    }
    Ok(contents)
}

fn kind(schema: &str, encoding: &str) -> Option<Kind> {
    match (schema, encoding) {
        ("lumenmesh.Frame", "json") => Some(Kind::Contour),
        _ => PoseKind::of(schema, encoding).map(Kind::Pose),
    }
}

impl Contents {
    /// Takes a message, or says what is wrong with it.
    fn take(&mut self, topic: &Topic, data: &[u8], logged_ns: i64) -> Result<(), String> {
        match topic.kind {
            Kind::Pose(kind) => {
                for message in kind.decode(data)? {
                    let mut pose = message.pose;
                    if pose.time_ns == 0 {
                        pose.time_ns = logged_ns;
                    }
                    self.poses.entry((topic.name.clone(), message.name)).or_default().push(pose);
                }
            }
            Kind::Contour => {
                let contour = contour(data, logged_ns)?;
                self.contours.entry(topic.name.clone()).or_default().push(contour);
            }
        }
        Ok(())
    }
}

/// A contour out of JSON.
fn contour(data: &[u8], logged_ns: i64) -> Result<Contour, String> {
    let value = serde_json::from_slice(data).map_err(|e| format!("no JSON: {e}"))?;
    let Value::Object(mut members) = value else { return Err("no object".into()) };
    let time_ns = match members.remove("timestamp") {
        None => logged_ns,
        Some(stamp) => messages::time_of(&stamp)?,
    };
    let has_pose = members.contains_key("pose");
    members.entry("pose").or_insert(Value::Null);
    Ok(Contour { time_ns, has_pose, frame: ndjson::frame_of(&members)? })
}
