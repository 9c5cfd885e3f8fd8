//! Poses out of messages: the parts of JSON, protobuf and CDR that they need.

use crate::geometry::Pose;
use crate::recording::formats::rotation;
use glam::{DQuat, DVec3};
use serde_json::Value;

const MM_PER_M: f64 = 1000.0;
/// Transforms in one message, at most.
const MAX_TRANSFORMS: usize = 10_000;

/// A pose and its time, ns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StampedPose {
    pub time_ns: i64,
    pub pose: Pose,
}

/// A pose and the transform that it is, such as `ProbeToTracker` for the child `Probe` in the parent `Tracker`;
/// without a name where the message names no child.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NamedPose {
    pub name: String,
    pub pose: StampedPose,
}

/// How a topic's messages are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PoseKind {
    TransformJson,
    TransformsJson,
    TransformProtobuf,
    TransformsProtobuf,
    TransformsCdr,
    PoseCdr,
}

impl PoseKind {
    pub(super) fn of(schema: &str, encoding: &str) -> Option<Self> {
        Some(match (schema, encoding) {
            ("foxglove.FrameTransform", "json") => Self::TransformJson,
            ("foxglove.FrameTransforms", "json") => Self::TransformsJson,
            ("foxglove.FrameTransform", "protobuf") => Self::TransformProtobuf,
            ("foxglove.FrameTransforms", "protobuf") => Self::TransformsProtobuf,
            ("tf2_msgs/msg/TFMessage" | "tf2_msgs/TFMessage", "cdr") => Self::TransformsCdr,
            ("geometry_msgs/msg/PoseStamped" | "geometry_msgs/PoseStamped", "cdr") => Self::PoseCdr,
            _ => return None,
        })
    }

    /// The poses of a message, or what is wrong with it.
    pub(super) fn decode(self, data: &[u8]) -> Result<Vec<NamedPose>, String> {
        let parse = || serde_json::from_slice::<Value>(data).map_err(|e| format!("no JSON: {e}"));
        match self {
            Self::TransformJson => Ok(vec![transform_of_json(&parse()?)?]),
            Self::TransformsJson => {
                let value = parse()?;
                let all = value.get("transforms").and_then(Value::as_array).ok_or("no transforms")?;
                all.iter().map(transform_of_json).collect()
            }
            Self::TransformProtobuf => Ok(vec![transform_of_protobuf(data)?]),
            Self::TransformsProtobuf => {
                let mut all = Vec::new();
                for field in Fields(data) {
                    if let (1, Field::Bytes(bytes)) = field? {
                        all.push(transform_of_protobuf(bytes)?);
                    }
                }
                Ok(all)
            }
            Self::TransformsCdr => transforms_of_cdr(data),
            Self::PoseCdr => Ok(vec![pose_of_cdr(data)?]),
        }
    }
}

fn named(parent: &str, child: &str, time_ns: i64, translation_m: DVec3, turn: DQuat) -> NamedPose {
    let name = if child.is_empty() { String::new() } else { format!("{child}To{parent}") };
    let is_finite = translation_m.is_finite() && turn.is_finite();
    let pose = match is_finite {
        true => Pose { rotation: rotation(turn), translation_mm: translation_m * MM_PER_M },
        false => Pose::LOST,
    };
    NamedPose { name, pose: StampedPose { time_ns, pose } }
}

fn nanoseconds(seconds: i64, nanoseconds: i64) -> Result<i64, String> {
    let too_far = || format!("a time of {seconds} s");
    seconds.checked_mul(1_000_000_000).and_then(|ns| ns.checked_add(nanoseconds)).ok_or_else(too_far)
}

// ---- JSON

/// A time: `sec` and `nsec`, or `nanosec`.
pub(super) fn time_of(stamp: &Value) -> Result<i64, String> {
    let part = |names: &[&str]| names.iter().find_map(|name| stamp.get(name)?.as_i64());
    match (part(&["sec"]), part(&["nsec", "nanosec"])) {
        (Some(s), Some(ns)) => nanoseconds(s, ns),
        _ => Err("a timestamp without sec and nsec".into()),
    }
}

fn transform_of_json(value: &Value) -> Result<NamedPose, String> {
    let text = |name: &str| value.get(name).and_then(Value::as_str).ok_or_else(|| format!("no {name}"));
    let numbers = |name: &str, parts: &[&str]| -> Result<Vec<f64>, String> {
        let of = |part: &&str| {
            let number = value.get(name).and_then(|value| value.get(part)).and_then(Value::as_f64);
            number.ok_or_else(|| format!("no {name}.{part}"))
        };
        parts.iter().map(of).collect()
    };
    let time_ns = value.get("timestamp").map_or(Ok(0), time_of)?;
    let t = numbers("translation", &["x", "y", "z"])?;
    let q = numbers("rotation", &["x", "y", "z", "w"])?;
    let (parent, child) = (text("parent_frame_id")?, text("child_frame_id")?);
    Ok(named(parent, child, time_ns, DVec3::new(t[0], t[1], t[2]), DQuat::from_xyzw(q[0], q[1], q[2], q[3])))
}

// ---- protobuf

/// The fields of a protobuf message, by their numbers.
struct Fields<'a>(&'a [u8]);

enum Field<'a> {
    Number(u64),
    Double(f64),
    Bytes(&'a [u8]),
}

impl<'a> Fields<'a> {
    fn varint(&mut self) -> Result<u64, String> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let (&byte, rest) = self.0.split_first().ok_or("a message cut short")?;
            self.0 = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err("a number of more than ten bytes".into())
    }

    fn bytes(&mut self, count: u64) -> Result<&'a [u8], String> {
        let count = usize::try_from(count).ok().filter(|&count| count <= self.0.len());
        let (bytes, rest) = self.0.split_at(count.ok_or("a message cut short")?);
        self.0 = rest;
        Ok(bytes)
    }

    fn field(&mut self) -> Result<(u64, Field<'a>), String> {
        let key = self.varint()?;
        let field = match key & 7 {
            0 => Field::Number(self.varint()?),
            1 => {
                let bytes = self.bytes(8)?;
                Field::Double(f64::from_le_bytes(bytes.try_into().unwrap_or_default()))
            }
            2 => {
                let count = self.varint()?;
                Field::Bytes(self.bytes(count)?)
            }
            5 => Field::Bytes(self.bytes(4)?),
            kind => return Err(format!("a field of kind {kind}")),
        };
        Ok((key >> 3, field))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u64, Field<'a>), String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let field = self.field();
        if field.is_err() {
            self.0 = &[];
        }
        Some(field)
    }
}

/// The doubles of a message with fields 1 to N; 0 where one is absent, as protobuf has it.
fn doubles<const N: usize>(bytes: &[u8]) -> Result<[f64; N], String> {
    let mut values = [0.0; N];
    for field in Fields(bytes) {
        if let (number @ 1.., Field::Double(value)) = field?
            && let Some(slot) = values.get_mut(number as usize - 1)
        {
            *slot = value;
        }
    }
    Ok(values)
}

fn transform_of_protobuf(data: &[u8]) -> Result<NamedPose, String> {
    let text =
        |bytes: &[u8]| String::from_utf8(bytes.to_vec()).map_err(|_| "a name that is no UTF-8".to_owned());
    let (mut time_ns, mut parent, mut child) = (0, String::new(), String::new());
    let (mut translation, mut turn) = ([0.0; 3], [0.0; 4]);
    for field in Fields(data) {
        match field? {
            (1, Field::Bytes(bytes)) => {
                let (mut seconds, mut ns) = (0, 0);
                for field in Fields(bytes) {
                    match field? {
                        (1, Field::Number(value)) => seconds = value.cast_signed(),
                        (2, Field::Number(value)) => ns = value.cast_signed(),
                        _ => {}
                    }
                }
                time_ns = nanoseconds(seconds, ns)?;
            }
            (2, Field::Bytes(bytes)) => parent = text(bytes)?,
            (3, Field::Bytes(bytes)) => child = text(bytes)?,
            (4, Field::Bytes(bytes)) => translation = doubles(bytes)?,
            (5, Field::Bytes(bytes)) => turn = doubles(bytes)?,
            _ => {}
        }
    }
    Ok(named(&parent, &child, time_ns, DVec3::from_array(translation), DQuat::from_array(turn)))
}

// ---- CDR

/// Values of a CDR message in their order, each at a multiple of its size after the first four bytes.
struct Cdr<'a> {
    body: &'a [u8],
    at: usize,
    is_little: bool,
    /// The largest alignment: 4 in the second version of the encoding.
    most: usize,
}

impl<'a> Cdr<'a> {
    fn new(data: &'a [u8]) -> Result<Self, String> {
        let (head, body) = data.split_first_chunk::<4>().ok_or("a message cut short")?;
        let (is_little, most) = match [head[0], head[1]] {
            [0, 0] => (false, 8),
            [0, 1] => (true, 8),
            [0, 6] => (false, 4),
            [0, 7] => (true, 4),
            other => return Err(format!("CDR of the kind {other:?}")),
        };
        Ok(Self { body, at: 0, is_little, most })
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let start = self.at.next_multiple_of(N.min(self.most));
        let bytes =
            self.body.get(start..).and_then(|rest| rest.first_chunk::<N>()).ok_or("a message cut short")?;
        self.at = start + N;
        let mut bytes = *bytes;
        if !self.is_little {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn count(&mut self) -> Result<usize, String> {
        Ok(u32::from_le_bytes(self.bytes()?) as usize)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.bytes()?);
        }
        Ok(values)
    }

    /// A text; its length counts the zero at its end.
    fn text(&mut self) -> Result<String, String> {
        let count = self.count()?;
        let bytes =
            self.body.get(self.at..).and_then(|rest| rest.get(..count)).ok_or("a message cut short")?;
        self.at += count;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        String::from_utf8(bytes.to_vec()).map_err(|_| "a name that is no UTF-8".into())
    }

    /// A header: the time and the frame.
    fn header(&mut self) -> Result<(i64, String), String> {
        let seconds = i32::from_le_bytes(self.bytes()?);
        let ns = u32::from_le_bytes(self.bytes()?);
        Ok((nanoseconds(seconds.into(), ns.into())?, self.text()?))
    }
}

fn transforms_of_cdr(data: &[u8]) -> Result<Vec<NamedPose>, String> {
    let mut cdr = Cdr::new(data)?;
    let count = cdr.count()?;
    if count > MAX_TRANSFORMS {
        return Err(format!("{count} transforms, more than {MAX_TRANSFORMS}"));
    }
    let transform = |_| {
        let (time_ns, parent) = cdr.header()?;
        let child = cdr.text()?;
        let [x, y, z, qx, qy, qz, qw] = cdr.numbers()?;
        Ok(named(&parent, &child, time_ns, DVec3::new(x, y, z), DQuat::from_xyzw(qx, qy, qz, qw)))
    };
    (0..count).map(transform).collect()
}

fn pose_of_cdr(data: &[u8]) -> Result<NamedPose, String> {
    let mut cdr = Cdr::new(data)?;
    let (time_ns, parent) = cdr.header()?;
    let [x, y, z, qx, qy, qz, qw] = cdr.numbers()?;
    Ok(named(&parent, "", time_ns, DVec3::new(x, y, z), DQuat::from_xyzw(qx, qy, qz, qw)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `tf2_msgs/msg/TFMessage` with one transform, as ROS 2 writes it.
    fn tf(is_little: bool) -> Vec<u8> {
        let mut out = vec![0, u8::from(is_little), 0, 0];
        let mut put = |bytes: &[u8], align: usize| {
            while (out.len() - 4) % align > 0 {
                out.push(0);
            }
            let swapped: Vec<u8> = bytes.iter().rev().copied().collect();
            out.extend(if is_little || align == 1 { bytes } else { &swapped });
        };
        put(&1_u32.to_le_bytes(), 4);
        put(&7_i32.to_le_bytes(), 4);
        put(&250_000_000_u32.to_le_bytes(), 4);
        for name in ["Tracker\0", "Probe\0"] {
            put(&(name.len() as u32).to_le_bytes(), 4);
            put(name.as_bytes(), 1);
        }
        for number in [0.001, 0.002, -0.003, 0.0, 0.0, 1.0, 0.0_f64] {
            put(&number.to_le_bytes(), 8);
        }
        out
    }

    fn expected() -> NamedPose {
        named(
            "Tracker",
            "Probe",
            7_250_000_000,
            DVec3::new(0.001, 0.002, -0.003),
            DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0),
        )
    }

    #[test]
    fn cdr_is_read_in_both_orders_of_bytes_and_cut_anywhere() {
        assert_eq!(expected().name, "ProbeToTracker");
        assert!((expected().pose.pose.translation_mm - DVec3::new(1.0, 2.0, -3.0)).length() < 1e-12);
        for is_little in [true, false] {
            let bytes = tf(is_little);
            assert_eq!(PoseKind::TransformsCdr.decode(&bytes), Ok(vec![expected()]));
            for end in 0..bytes.len() {
                assert!(PoseKind::TransformsCdr.decode(&bytes[..end]).is_err(), "{end}");
            }
        }
        let mut many = tf(true);
        many[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(PoseKind::TransformsCdr.decode(&many).unwrap_err().contains("4294967295 transforms"));
        many[1] = 9;
        assert!(PoseKind::TransformsCdr.decode(&many).unwrap_err().contains("CDR of the kind"));
    }

    #[test]
    fn protobuf_is_read_and_cut_anywhere() {
        let message =
            |number: u8, content: &[u8]| [&[number << 3 | 2, content.len() as u8], content].concat();
        let double = |number: u8, value: f64| [&[number << 3 | 1][..], &value.to_le_bytes()].concat();
        let translation = [double(1, 0.001), double(2, 0.002), double(3, -0.003)].concat();
        // 250000000 as a varint; zeros are left out.
        let time = [&[8, 7, 16][..], &[0x80, 0xe5, 0x9a, 0x77]].concat();
        let parts = [
            message(1, &time),
            message(2, b"Tracker"),
            message(3, b"Probe"),
            message(4, &translation),
            message(5, &double(3, 1.0)),
            vec![0x78, 1],
        ];
        let bytes = parts.concat();
        assert_eq!(PoseKind::TransformProtobuf.decode(&bytes), Ok(vec![expected()]));
        let whole = message(1, &bytes);
        assert_eq!(PoseKind::TransformsProtobuf.decode(&whole), Ok(vec![expected()]));
        let ends: Vec<usize> = parts
            .iter()
            .scan(0, |end, part| {
                Some({
                    *end += part.len();
                    *end
                })
            })
            .collect();
        for end in 1..bytes.len() {
            assert_eq!(
                PoseKind::TransformProtobuf.decode(&bytes[..end]).is_ok(),
                ends.contains(&end),
                "{end}"
            );
        }
        assert!(PoseKind::TransformProtobuf.decode(&[0x80; 20]).is_err());
    }

    #[test]
    fn json_is_read_and_what_is_absent_is_named() {
        let text = r#"{"timestamp": {"sec": 7, "nsec": 250000000}, "parent_frame_id": "Tracker", "child_frame_id": "Probe",
            "translation": {"x": 0.001, "y": 0.002, "z": -0.003}, "rotation": {"x": 0, "y": 0, "z": 1, "w": 0}}"#;
        assert_eq!(PoseKind::TransformJson.decode(text.as_bytes()), Ok(vec![expected()]));
        let all = format!("{{\"transforms\": [{text}]}}");
        assert_eq!(PoseKind::TransformsJson.decode(all.as_bytes()), Ok(vec![expected()]));
        for (from, to, says) in [
            ("\"y\": 0.002", "\"why\": 1", "no translation.y"),
            ("child_frame_id", "child", "no child_frame_id"),
            ("nsec", "ns", "a timestamp without sec and nsec"),
            ("{", "[", "no JSON"),
        ] {
            let fault = PoseKind::TransformJson.decode(text.replace(from, to).as_bytes()).unwrap_err();
            assert!(fault.contains(says), "{fault}");
        }
    }
}
