//! Messages of OpenIGTLink, the protocol between trackers, PLUS and 3D Slicer: bytes to values and back.
//!
//! Versions 1 to 3 of the protocol (headers 1 and 2, with metadata), their checksum, and the messages that carry poses,
//! contours, meshes and texts. Numbers are big endian. Sizes are checked before anything is allocated, and a body is never
//! trusted to be as long as it says.

mod body;
mod crc64;
mod poly_data;
mod wire;

pub use body::{Content, Status, Tool};
pub use poly_data::PolyData;

use crate::{Error, Result};
use wire::Reader;

/// Bytes of a header.
pub const HEADER_BYTES: usize = 58;
/// The largest body that is read, bytes: an image of 8192 × 8192 pixels.
pub const MAX_BODY_BYTES: u64 = 1 << 26;

/// A message.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Message {
    /// The header's version: 1, or 2 of messages that have metadata.
    pub version: u16,
    /// The device's name. In a header at most 20 bytes; PLUS repeats longer ones in the metadata `IGTL_DEVICE_NAME`.
    pub device: String,
    /// When it was made, s since 1970 in UTC; 0: not known.
    pub time_s: f64,
    /// Of header 2: keys and values, such as `TransformStatus` and `OK`.
    pub metadata: Vec<(String, String)>,
    /// What it says.
    pub content: Content,
}

/// What a header announces.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Header {
    /// 1 or 2.
    pub version: u16,
    /// `TRANSFORM`, `POLYDATA`, …
    pub kind: String,
    /// The device's name.
    pub device: String,
    /// When the message was made, s since 1970 in UTC.
    pub time_s: f64,
    /// Bytes of the body that follows.
    pub body_bytes: usize,
    /// The body's checksum.
    crc: u64,
}

impl Header {
    /// Reads a header.
    ///
    /// # Errors
    /// [`Error::Recording`] where it is of another version, its names are no text, or its body would be longer than
    /// [`MAX_BODY_BYTES`].
    pub fn decode(bytes: &[u8; HEADER_BYTES]) -> Result<Self> {
        let mut reader = Reader::new(bytes);
        let version = reader.u16()?;
        if !(1..=2).contains(&version) {
            return Err(refused("version of an OpenIGTLink header", version, "1 or 2"));
        }
        let kind = reader.name(12)?;
        let device = reader.name(20)?;
        let time_s = reader.u64()? as f64 / FRACTIONS_OF_A_SECOND;
        let body_bytes = reader.u64()?;
        if body_bytes > MAX_BODY_BYTES {
            let expected = format!("at most {MAX_BODY_BYTES}");
            return Err(refused("bytes of an OpenIGTLink body", body_bytes, &expected));
        }
        Ok(Self { version, kind, device, time_s, body_bytes: body_bytes as usize, crc: reader.u64()? })
    }

    /// Reads the body that follows the header.
    ///
    /// # Errors
    /// [`Error::Recording`] where its length or its checksum is not the header's, or it is not what its kind asks for.
    pub fn decode_body(&self, body: &[u8]) -> Result<Message> {
        if body.len() != self.body_bytes {
            return Err(refused("bytes of an OpenIGTLink body", body.len(), &self.body_bytes.to_string()));
        }
        let crc = crc64::of(body);
        if crc != self.crc {
            let expected = format!("{:016x}, the header's", self.crc);
            return Err(refused("checksum of an OpenIGTLink body", format!("{crc:016x}"), &expected));
        }
        let (content, metadata) = match self.version {
            1 => (body, Vec::new()),
            _ => extended(body)?,
        };
        let mut device = self.device.clone();
        if let Some((_, name)) = metadata.iter().find(|(key, _)| key == DEVICE_NAME) {
            device.clone_from(name);
        }
        Ok(Message {
            version: self.version,
            device,
            time_s: self.time_s,
            metadata,
            content: Content::decode(&self.kind, content)?,
        })
    }
}

impl Message {
    /// A message with header 1.
    pub fn new(device: &str, time_s: f64, content: Content) -> Self {
        Self { version: 1, device: device.into(), time_s, metadata: Vec::new(), content }
    }

    /// The value of a metadata key.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.iter().find(|(there, _)| there == key).map(|(_, value)| value.as_str())
    }

    /// Header and body. Names are cut to what the header holds.
    ///
    /// # Errors
    /// [`Error::Recording`] where the body would be longer than [`MAX_BODY_BYTES`], or a key of the metadata than 65535
    /// bytes.
    pub fn encode(&self) -> Result<Vec<u8>> {
        let content = self.content.encode();
        let body = match self.version {
            1 => content,
            _ => self.with_metadata(content)?,
        };
        if body.len() as u64 > MAX_BODY_BYTES {
            let expected = format!("at most {MAX_BODY_BYTES}");
            return Err(refused("bytes of an OpenIGTLink body", body.len(), &expected));
        }
        let mut bytes = Vec::with_capacity(HEADER_BYTES + body.len());
        bytes.extend(self.version.to_be_bytes());
        wire::put_name(&mut bytes, self.content.kind(), 12);
        wire::put_name(&mut bytes, &self.device, 20);
        let time = (self.time_s.max(0.0) * FRACTIONS_OF_A_SECOND).round() as u64;
        bytes.extend(time.to_be_bytes());
        bytes.extend((body.len() as u64).to_be_bytes());
        bytes.extend(crc64::of(&body).to_be_bytes());
        bytes.extend(body);
        Ok(bytes)
    }

    /// The extended header, the content, and the metadata.
    fn with_metadata(&self, content: Vec<u8>) -> Result<Vec<u8>> {
        let (mut sizes, mut texts) = (Vec::new(), Vec::new());
        let count = u16::try_from(self.metadata.len())
            .map_err(|_| refused("keys of OpenIGTLink metadata", self.metadata.len(), "at most 65535"))?;
        sizes.extend(count.to_be_bytes());
        for (key, value) in &self.metadata {
            let length = u16::try_from(key.len())
                .map_err(|_| refused("bytes of a key of OpenIGTLink metadata", key.len(), "at most 65535"))?;
            sizes.extend(length.to_be_bytes());
            sizes.extend(UTF_8.to_be_bytes());
            sizes.extend((value.len() as u32).to_be_bytes());
            texts.extend(key.bytes().chain(value.bytes()));
        }
        let mut body = Vec::new();
        body.extend(EXTENDED_BYTES.to_be_bytes());
        body.extend((sizes.len() as u16).to_be_bytes());
        body.extend((texts.len() as u32).to_be_bytes());
        body.extend(0_u32.to_be_bytes());
        Ok([body, content, sizes, texts].concat())
    }
}

/// The metadata key of a device's whole name.
const DEVICE_NAME: &str = "IGTL_DEVICE_NAME";
/// Times are counts of 2⁻³² s.
const FRACTIONS_OF_A_SECOND: f64 = 4_294_967_296.0;
/// Bytes of the extended header.
const EXTENDED_BYTES: u16 = 12;
/// The number of UTF-8 in the registry of character sets.
const UTF_8: u16 = 106;

/// The content of a body with an extended header, and its metadata.
fn extended(body: &[u8]) -> Result<(&[u8], Vec<(String, String)>)> {
    let mut reader = Reader::new(body);
    let header = usize::from(reader.u16()?);
    let sizes = usize::from(reader.u16()?);
    let texts = reader.u32()? as usize;
    let end =
        body.len().checked_sub(sizes.saturating_add(texts)).filter(|&end| header >= 12 && header <= end);
    let Some(end) = end else {
        let found = format!("{header} bytes of extended header, {sizes} and {texts} of metadata");
        return Err(refused("OpenIGTLink body", found, &format!("at most {} in all", body.len())));
    };
    let mut metadata = Vec::new();
    if sizes > 0 {
        let (mut reader, mut texts) =
            (Reader::new(&body[end..end + sizes]), Reader::new(&body[end + sizes..]));
        for _ in 0..reader.u16()? {
            let key = usize::from(reader.u16()?);
            let _encoding = reader.u16()?;
            let value = reader.u32()? as usize;
            metadata.push((wire::text(texts.take(key)?), wire::text(texts.take(value)?)));
        }
    }
    Ok((&body[header..end], metadata))
}

fn refused(field: &'static str, found: impl ToString, expected: &str) -> Error {
    Error::Recording { field, found: found.to_string(), expected: expected.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(message: &Message) -> Message {
        let bytes = message.encode().unwrap();
        let (header, body) = bytes.split_first_chunk().unwrap();
        Header::decode(header).unwrap().decode_body(body).unwrap()
    }

    fn contents() -> Vec<Content> {
        let matrix = [[1.0, 0.0, 0.0, 10.0], [0.0, 0.0, -1.0, 20.5], [0.0, 1.0, 0.0, -30.0]];
        let strip = PolyData {
            points_mm: vec![[1.0, 2.0, 3.0]; 4],
            strips: vec![vec![0, 1, 2, 3]],
            scalars: vec![("support".into(), vec![1.0; 4]), ("standard_error_mm".into(), vec![0.5; 4])],
            ..PolyData::default()
        };
        vec![
            Content::Transform(matrix),
            Content::Tracking(vec![Tool { name: "Probe".into(), kind: 2, matrix }; 2]),
            Content::PolyData(strip),
            Content::Text("{\"frame\": 1, \"unit\": \"µm\"}".into()),
            Content::Status(Status { code: 1, subcode: -2, error: "none".into(), message: "ready".into() }),
            Content::GetStatus,
        ]
    }

    #[test]
    fn every_message_comes_back() {
        for content in contents() {
            let message = Message::new("ProbeToTracker", 1_700_000_000.25, content.clone());
            assert_eq!(round_trip(&message), message);
            let metadata = vec![("TransformStatus".into(), "OK".into()), ("é".into(), String::new())];
            let message = Message { version: 2, metadata, ..message };
            assert_eq!(round_trip(&message), message);
        }
    }

    #[test]
    fn a_long_name_is_cut_in_the_header_and_whole_in_the_metadata() {
        let name = "ProbeToTrackerReference";
        let mut message = Message::new(name, 0.0, Content::GetStatus);
        assert_eq!(round_trip(&message).device, &name[..20]);
        message.version = 2;
        message.metadata.push((DEVICE_NAME.into(), name.into()));
        assert_eq!(round_trip(&message).device, name);
    }

    /// The bytes that libOpenIGTLink makes of three points, one triangle and a scalar.
    #[test]
    fn poly_data_has_the_bytes_of_the_reference_library() {
        let data = PolyData {
            points_mm: vec![[1.0, 2.0, 3.0]; 3],
            polygons: vec![vec![0, 1, 2]],
            scalars: vec![("support".into(), vec![5.0, 6.0, 7.0])],
            ..PolyData::default()
        };
        let mut golden = Vec::new();
        let words = |words: &[u32]| words.iter().flat_map(|w| w.to_be_bytes()).collect::<Vec<u8>>();
        golden.extend(words(&[3, 0, 0, 0, 0, 1, 16, 0, 0, 1]));
        golden.extend(words(&[0x3f80_0000, 0x4000_0000, 0x4040_0000].repeat(3)));
        golden.extend(words(&[3, 0, 1, 2]));
        golden.extend([0, 1, 0, 0, 0, 3]);
        golden.extend(*b"support\0");
        golden.extend(words(&[0x40a0_0000, 0x40c0_0000, 0x40e0_0000]));
        assert_eq!(Content::PolyData(data).encode(), golden);
        assert_eq!(golden.len(), 118);
        assert_eq!(crc64::of(&golden), 0xf285_446a_c462_9e91);
    }

    #[test]
    fn a_transform_is_written_column_by_column() {
        let matrix = [[11.0, 12.0, 13.0, 1.0], [21.0, 22.0, 23.0, 2.0], [31.0, 32.0, 33.0, 3.0]];
        let expected = [11.0_f32, 21.0, 31.0, 12.0, 22.0, 32.0, 13.0, 23.0, 33.0, 1.0, 2.0, 3.0];
        let bytes: Vec<u8> = expected.iter().flat_map(|x| x.to_be_bytes()).collect();
        assert_eq!(Content::Transform(matrix).encode(), bytes);
    }

    #[test]
    fn what_is_wrong_is_refused() {
        let good = Message::new("Probe", 0.0, Content::Text("frame".into())).encode().unwrap();
        let decode = |bytes: &[u8]| {
            let (header, body) = bytes.split_first_chunk().unwrap();
            Header::decode(header).and_then(|header| header.decode_body(body))
        };
        assert!(decode(&good).is_ok());
        let spoiled = |at: usize| {
            let mut bytes = good.clone();
            bytes[at] ^= 0x40;
            decode(&bytes).unwrap_err().to_string()
        };
        assert!(spoiled(0).contains("version"));
        assert!(spoiled(42).contains("at most"));
        assert!(spoiled(good.len() - 1).contains("checksum"));
        assert!(decode(&good[..good.len() - 1]).unwrap_err().to_string().contains("bytes"));
    }

    /// Bodies that say anything, with the right checksum: a value or an error, and no allocation that the body's own length
    /// does not bear.
    #[test]
    fn arbitrary_bodies_are_values_or_errors() {
        let mut state = 1_u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        let inputs = std::env::var("LUMENMESH_FUZZ_INPUTS").map_or(20_000, |n| n.parse().unwrap());
        let (mut accepted, mut refused) = (0, 0);
        for _ in 0..inputs {
            let content = contents().swap_remove(random() % 6);
            let version = 1 + (random() % 2) as u16;
            let metadata = vec![("a".into(), "b".into())];
            let message = Message { version, metadata, ..Message::new("x", 0.0, content) };
            let bytes = message.encode().unwrap();
            let (header, body) = bytes.split_first_chunk().unwrap();
            let mut body = body.to_vec();
            for _ in 0..random() % 4 {
                let at = random() % (body.len() + 1);
                match random() % 3 {
                    0 => body.truncate(at),
                    1 if at < body.len() => body[at] = [0, 1, 0x7f, 0x80, 0xff][random() % 5],
                    _ => body.insert(at, random() as u8),
                }
            }
            let mut header = Header::decode(header).unwrap();
            (header.body_bytes, header.crc) = (body.len(), crc64::of(&body));
            match header.decode_body(&body) {
                Ok(_) => accepted += 1,
                Err(_) => refused += 1,
            }
        }
        assert!(accepted > 0 && refused > 0, "{accepted} accepted, {refused} refused");
    }
}
