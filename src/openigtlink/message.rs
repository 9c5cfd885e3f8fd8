//! Headers, metadata and checksums: bytes to messages and back.

use super::content::Content;
use super::crc64;
use super::time::Timestamp;
use super::wire::{Reader, UTF_8, cut, put_name, refused, text};
use crate::Result;

/// Bytes of a header.
pub const HEADER_BYTES: usize = 58;
/// The largest body that is read, bytes: an image of 8192 × 8192 pixels. A message that is read takes at most
/// eight times its bytes in memory.
pub const MAX_BODY_BYTES: u64 = 1 << 26;
/// Bytes of a device's name in the metadata, at most; of longer ones the beginning is taken.
const MAX_DEVICE_BYTES: usize = 256;
/// Bytes of a device's name in a header.
pub(super) const DEVICE_BYTES: usize = 20;

/// A message.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Message {
    /// The header's version: 1, or 2 of messages that have metadata.
    pub version: u16,
    /// The device's name. A header holds 20 bytes of it; with header 2 a longer one is whole in the metadata
    /// `IGTL_DEVICE_NAME`, from where it is read.
    pub device: String,
    /// When it was made.
    pub time: Timestamp,
    /// Of header 2: keys and values, such as `TransformStatus` and `OK`.
    pub metadata: Vec<(String, String)>,
    /// What it says.
    pub content: Content,
}

/// What a header announces.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Header {
    /// 1 or 2.
    pub version: u16,
    /// `TRANSFORM`, `POLYDATA`, …
    pub kind: String,
    /// The device's name, at most 20 bytes.
    pub device: String,
    /// When the message was made.
    pub time: Timestamp,
    /// Bytes of the body that follows, as stated.
    pub body_bytes: u64,
    /// The body's checksum.
    crc: u64,
}

impl Header {
    /// Reads a header.
    ///
    /// # Errors
    /// [`Error::Recording`](crate::Error::Recording) where it is of another version or its kind is no name:
    /// then these bytes are no header, and nothing after them can be understood.
    pub fn decode(bytes: &[u8; HEADER_BYTES]) -> Result<Self> {
        let mut reader = Reader::new(bytes);
        let version = reader.u16()?;
        if !(1..=2).contains(&version) {
            return Err(refused("version of an OpenIGTLink header", version, "1 or 2"));
        }
        let kind = reader.name(12)?;
        if kind.is_empty() || !kind.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(refused("kind of an OpenIGTLink message", format!("{kind:?}"), "a name in ASCII"));
        }
        let device = reader.name(DEVICE_BYTES)?;
        let time = Timestamp(reader.u64()?);
        Ok(Self { version, kind, device, time, body_bytes: reader.u64()?, crc: reader.u64()? })
    }

    /// Whether messages of this kind are understood. Others are to be skipped.
    pub fn is_known(&self) -> bool {
        Content::is_known(&self.kind)
    }

    /// Refuses bodies longer than [`MAX_BODY_BYTES`], before anything is allocated for them.
    ///
    /// # Errors
    /// [`Error::Recording`](crate::Error::Recording).
    pub fn check_size(&self) -> Result<usize> {
        match self.body_bytes {
            bytes if bytes <= MAX_BODY_BYTES => Ok(bytes as usize),
            bytes => Err(refused(
                "bytes of an OpenIGTLink body",
                format!("{bytes} of {} from {:?}", self.kind, self.device),
                format!("at most {MAX_BODY_BYTES}"),
            )),
        }
    }

    /// Reads the body that follows the header.
    ///
    /// # Errors
    /// [`Error::Recording`](crate::Error::Recording) where its length or its checksum is not the header's, or
    /// it is not what its kind asks for; where its kind is not [known](Self::is_known).
    pub fn decode_body(&self, body: &[u8]) -> Result<Message> {
        if body.len() != self.check_size()? {
            return Err(refused("bytes of an OpenIGTLink body", body.len(), self.body_bytes));
        }
        let crc = crc64::of(body);
        if crc != self.crc {
            return Err(refused(
                "checksum of an OpenIGTLink body",
                format!("{crc:016x} of {} from {:?}", self.kind, self.device),
                format!("{:016x}, the header's", self.crc),
            ));
        }
        let (content, mut metadata) = match self.version {
            1 => (body, Vec::new()),
            _ => extended(body)?,
        };
        let whole_name = metadata.iter().position(|(key, _)| key == DEVICE_NAME);
        let device = whole_name
            .map_or_else(|| self.device.clone(), |k| cut(&metadata.remove(k).1, MAX_DEVICE_BYTES).to_owned());
        let content = Content::decode(&self.kind, content)?;
        Ok(Message { version: self.version, device, time: self.time, metadata, content })
    }
}

impl Message {
    /// A message with header 1.
    pub fn new(device: impl Into<String>, time: Timestamp, content: Content) -> Self {
        Self { version: 1, device: device.into(), time, metadata: Vec::new(), content }
    }

    /// The message with header 1 or 2.
    #[must_use]
    pub fn with_version(mut self, version: u16) -> Self {
        self.version = version;
        self
    }

    /// The message with header 2 and one more key and value of metadata.
    #[must_use]
    pub fn with_metadata(mut self, key: impl Into<String>, value: impl Into<String>) -> Self {
        self.version = 2;
        self.metadata.push((key.into(), value.into()));
        self
    }

    /// The value of a metadata key.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.iter().find(|(there, _)| there == key).map(|(_, value)| value.as_str())
    }

    /// Header and body. A header 1 holds 20 bytes of the device's name and no metadata.
    ///
    /// # Errors
    /// [`Error::Recording`](crate::Error::Recording) where the body would be longer than [`MAX_BODY_BYTES`],
    /// and where the content or the metadata is longer than its fields can say.
    pub fn encode(&self) -> Result<Vec<u8>> {
        if !(1..=2).contains(&self.version) {
            return Err(refused("version of an OpenIGTLink header", self.version, "1 or 2"));
        }
        let mut bytes = vec![0; HEADER_BYTES];
        let metadata = match self.version {
            1 => Vec::new(),
            _ => self.put_extended_header(&mut bytes)?,
        };
        self.content.encode(&mut bytes)?;
        bytes.extend(metadata);
        let body = &bytes[HEADER_BYTES..];
        if body.len() as u64 > MAX_BODY_BYTES {
            let expected = format!("at most {MAX_BODY_BYTES}");
            return Err(refused("bytes of an OpenIGTLink body", body.len(), expected));
        }
        let mut header = Vec::with_capacity(HEADER_BYTES);
        header.extend(self.version.to_be_bytes());
        put_name(&mut header, self.content.kind(), 12);
        put_name(&mut header, &self.device, DEVICE_BYTES);
        header.extend(self.time.0.to_be_bytes());
        header.extend((body.len() as u64).to_be_bytes());
        header.extend(crc64::of(body).to_be_bytes());
        bytes[..HEADER_BYTES].copy_from_slice(&header);
        Ok(bytes)
    }

    /// Writes the extended header, and returns the metadata that follow the content.
    fn put_extended_header(&self, bytes: &mut Vec<u8>) -> Result<Vec<u8>> {
        let too_long = |what, found: usize| refused(what, found, "at most 65535");
        let mut pairs: Vec<(&str, &str)> = self.metadata.iter().map(|(k, v)| (&**k, &**v)).collect();
        if self.device.len() > DEVICE_BYTES {
            pairs.push((DEVICE_NAME, &self.device));
        }
        let (mut sizes, mut texts) = (Vec::new(), Vec::new());
        // The sizes of all have to fit 16 bits too.
        let count = u16::try_from(pairs.len()).ok().filter(|&count| count <= 8000);
        let Some(count) = count else {
            return Err(refused("keys of OpenIGTLink metadata", pairs.len(), "at most 8000"));
        };
        sizes.extend(count.to_be_bytes());
        for (key, value) in pairs {
            let length = u16::try_from(key.len());
            let length = length.map_err(|_| too_long("bytes of a key of OpenIGTLink metadata", key.len()))?;
            sizes.extend(length.to_be_bytes());
            sizes.extend(UTF_8.to_be_bytes());
            let value = cut(value, MAX_BODY_BYTES as usize);
            sizes.extend((value.len() as u32).to_be_bytes());
            texts.extend(key.bytes().chain(value.bytes()));
        }
        bytes.extend(EXTENDED_BYTES.to_be_bytes());
        bytes.extend((sizes.len() as u16).to_be_bytes());
        bytes.extend((texts.len() as u32).to_be_bytes());
        bytes.extend(0_u32.to_be_bytes());
        sizes.extend(texts);
        Ok(sizes)
    }
}

/// Keys and values.
type Metadata = Vec<(String, String)>;

/// The metadata key of a device's whole name.
const DEVICE_NAME: &str = "IGTL_DEVICE_NAME";
/// Bytes of the extended header.
const EXTENDED_BYTES: u16 = 12;

/// The content of a body with an extended header, and its metadata.
fn extended(body: &[u8]) -> Result<(&[u8], Metadata)> {
    let mut reader = Reader::new(body);
    let header = usize::from(reader.u16()?);
    let sizes = usize::from(reader.u16()?);
    let texts = reader.u32()? as usize;
    let end = body.len().checked_sub(sizes.saturating_add(texts));
    let Some(end) = end.filter(|&end| header >= usize::from(EXTENDED_BYTES) && header <= end) else {
        let found = format!("{header} bytes of extended header, {sizes} and {texts} of metadata");
        return Err(refused("OpenIGTLink body", found, format!("at least 12, and {} in all", body.len())));
    };
    let mut metadata = Vec::new();
    if sizes > 0 {
        let mut values = Reader::new(&body[end + sizes..]);
        let mut sizes = Reader::new(&body[end..end + sizes]);
        let count = usize::from(sizes.u16()?);
        if count * 8 > sizes.rest().len() {
            let expected = format!("what {} bytes hold", sizes.rest().len());
            return Err(refused("keys of OpenIGTLink metadata", count, expected));
        }
        metadata.reserve_exact(count);
        for _ in 0..count {
            let key = usize::from(sizes.u16()?);
            let _encoding = sizes.u16()?;
            let value = sizes.u32()? as usize;
            metadata.push((text(values.take(key)?), text(values.take(value)?)));
        }
    }
    Ok((&body[header..end], metadata))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::openigtlink::{ImageContent, PolyData, Status, Tool};
    use crate::recording::PixelType;

    const MATRIX: [[f32; 4]; 3] = [[1.0, 0.0, 0.0, 10.0], [0.0, 0.0, -1.0, 20.5], [0.0, 1.0, 0.0, -30.0]];

    fn decoded(bytes: &[u8]) -> Result<Message> {
        let (header, body) = bytes.split_first_chunk().unwrap();
        Header::decode(header)?.decode_body(body)
    }

    fn contents() -> Vec<Content> {
        let strip = PolyData {
            points_mm: vec![[1.0, 2.0, 3.0]; 4],
            strips: vec![vec![0, 1, 2, 3]],
            scalars: vec![("support".into(), vec![1.0; 4]), ("standard_error_mm".into(), vec![0.5; 4])],
            ..PolyData::default()
        };
        let line =
            PolyData { points_mm: vec![[1.0; 3]; 3], lines: vec![vec![0, 1, 2, 0]], ..Default::default() };
        let image = ImageContent {
            size: [2, 3, 1],
            components: 1,
            kind: PixelType::U16,
            big_endian: true,
            matrix: MATRIX,
            pixels: (0..12).collect(),
        };
        vec![
            Content::Transform(MATRIX),
            Content::Tracking(vec![Tool { name: "Probe".into(), kind: 2, matrix: MATRIX }; 2]),
            Content::StartTracking(50),
            Content::Image(image),
            Content::Points(vec![[1.0, -2.0, 0.0], [0.5, 0.25, 0.0]]),
            Content::PolyData(strip),
            Content::PolyData(line),
            Content::Text("{\"frame\": 1, \"unit\": \"µm\"}".into()),
            Content::Status(Status { code: 1, subcode: -2, error: "none".into(), message: "ready".into() }),
            Content::GetStatus,
        ]
    }

    #[test]
    fn every_message_comes_back() {
        for content in contents() {
            assert!(Content::is_known(content.kind()));
            let message = Message::new("ProbeToTracker", Timestamp((1_700_000_000 << 32) | 5), content);
            assert_eq!(decoded(&message.encode().unwrap()).unwrap(), message);
            for message in [
                message.clone().with_version(2),
                message.clone().with_metadata("TransformStatus", "OK").with_metadata("é", ""),
            ] {
                assert_eq!(decoded(&message.encode().unwrap()).unwrap(), message);
            }
        }
    }

    #[test]
    fn a_long_name_is_cut_in_a_header_and_whole_in_the_metadata() {
        let name = "ProbeToTrackerReference";
        let message = Message::new(name, Timestamp::UNKNOWN, Content::GetStatus);
        assert_eq!(decoded(&message.encode().unwrap()).unwrap().device, &name[..20]);
        let message = message.with_version(2);
        let bytes = message.encode().unwrap();
        assert_eq!(decoded(&bytes).unwrap(), message);
        assert!(bytes.windows(16).any(|w| w == b"IGTL_DEVICE_NAME"));
    }

    fn words(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|w| w.to_be_bytes()).collect()
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
        let mut golden = words(&[3, 0, 0, 0, 0, 1, 16, 0, 0, 1]);
        golden.extend(words(&[0x3f80_0000, 0x4000_0000, 0x4040_0000].repeat(3)));
        golden.extend(words(&[3, 0, 1, 2]));
        golden.extend([0, 1, 0, 0, 0, 3]);
        golden.extend(*b"support\0");
        golden.extend(words(&[0x40a0_0000, 0x40c0_0000, 0x40e0_0000]));
        assert_eq!(golden.len(), 118);
        let message = Message::new("Lumen", Timestamp::UNKNOWN, Content::PolyData(data));
        let bytes = message.encode().unwrap();
        assert_eq!(bytes[HEADER_BYTES..], golden);
        assert_eq!(bytes[50..58], 0xf285_446a_c462_9e91_u64.to_be_bytes());
        assert_eq!(bytes[42..50], 118_u64.to_be_bytes());
        assert_eq!(bytes[..14], *b"\0\x01POLYDATA\0\0\0\0");
    }

    #[test]
    fn a_transform_is_written_column_by_column() {
        let matrix = [[11.0, 12.0, 13.0, 1.0], [21.0, 22.0, 23.0, 2.0], [31.0, 32.0, 33.0, 3.0]];
        let expected = [11.0_f32, 21.0, 31.0, 12.0, 22.0, 32.0, 13.0, 23.0, 33.0, 1.0, 2.0, 3.0];
        let bytes: Vec<u8> = expected.iter().flat_map(|x| x.to_be_bytes()).collect();
        let message = Message::new("x", Timestamp::UNKNOWN, Content::Transform(matrix));
        assert_eq!(message.encode().unwrap()[HEADER_BYTES..], bytes);
    }

    /// An error's text.
    fn refused(bytes: &[u8]) -> String {
        decoded(bytes).map(|message| format!("{message:?}")).unwrap_err().to_string()
    }

    #[test]
    fn what_is_wrong_is_refused() {
        let good = Message::new("Probe", Timestamp::UNKNOWN, Content::Text("frame".into())).encode().unwrap();
        assert!(decoded(&good).is_ok());
        let spoiled = |at: usize| {
            let mut bytes = good.clone();
            bytes[at] ^= 0x40;
            refused(&bytes)
        };
        assert!(spoiled(0).contains("version"));
        assert!(spoiled(42).contains("at most"));
        assert!(spoiled(good.len() - 1).contains("checksum"));
        assert!(refused(&good[..good.len() - 1]).contains("bytes"));
        let mut unknown = good.clone();
        unknown[2] = 1;
        assert!(refused(&unknown).contains("name in ASCII"));
    }

    /// A body with the right checksum, as header 1 has it.
    fn message_of(kind: &str, body: &[u8]) -> Vec<u8> {
        let mut bytes = 1_u16.to_be_bytes().to_vec();
        put_name(&mut bytes, kind, 12);
        put_name(&mut bytes, "x", 20);
        bytes.extend(0_u64.to_be_bytes());
        bytes.extend((body.len() as u64).to_be_bytes());
        bytes.extend(crc64::of(body).to_be_bytes());
        bytes.extend(body);
        bytes
    }

    #[test]
    fn counts_that_the_body_does_not_bear_are_refused() {
        const MANY: u32 = u32::MAX;
        for (counts, expected) in [
            ([MANY, 0, 0, 0, 0, 0, 0, 0, 0, 0], "points"),
            ([0, MANY, MANY, MANY, MANY, MANY, MANY, MANY, MANY, 0], "bytes of cells"),
            ([0, 0, 0, 0, 0, 0, 0, 0, 0, MANY], "attributes"),
            ([0, 0, 0, MANY, 0, 0, 0, 0, 0, 0], "cells"),
        ] {
            let text = refused(&message_of("POLYDATA", &words(&counts)));
            assert!(text.contains("POLYDATA") && text.contains(expected), "{text}");
        }
        // A line of more points than it has bytes for, and one of a point that is not there.
        let mut line = words(&[1, 0, 0, 1, 8, 0, 0, 0, 0, 0, 0, 0, 0]);
        for (cell, expected) in [([MANY, 0], "bytes left"), ([1, 1], "point 1")] {
            line.truncate(52);
            line.extend(words(&cell));
            assert!(refused(&message_of("POLYDATA", &line)).contains(expected));
        }
        let mut image = vec![0, 1, 255, 11, 1, 1];
        image.extend([0xff; 6]);
        image.extend([0; 54]);
        image.extend([0xff; 6]);
        assert!(refused(&message_of("IMAGE", &image)).contains("IMAGE"));
        assert!(refused(&message_of("POINT", &[0; 135])).contains("bytes left"));
        assert!(refused(&message_of("TDATA", &[0; 71])).contains("bytes left"));
        assert!(refused(&message_of("STRING", &[0, 3, 0, 9, b'a'])).contains("bytes left"));
        assert!(refused(&message_of("TRANSFORM", &[0; 49])).contains("1 bytes after"));
        assert!(refused(&message_of("COMMAND", &[])).contains("known"));
        let mut extended = message_of("GET_STATUS", &[0, 12, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0]);
        extended[1] = 2;
        assert!(refused(&extended).contains("of metadata"));
        let mut keys = message_of("GET_STATUS", &[0, 12, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff]);
        keys[1] = 2;
        assert!(refused(&keys).contains("keys of OpenIGTLink metadata"));
    }

    #[test]
    fn what_does_not_fit_is_not_sent() {
        for content in [
            Content::Text("x".repeat(65_536)),
            Content::Image(ImageContent {
                size: [2, 2, 1],
                components: 1,
                kind: PixelType::U8,
                big_endian: false,
                matrix: MATRIX,
                pixels: vec![0; 3],
            }),
        ] {
            let encoded = Message::new("x", Timestamp::UNKNOWN, content).encode();
            assert!(matches!(encoded, Err(Error::Recording { .. })));
        }
        assert!(Message::new("x", Timestamp::UNKNOWN, Content::GetStatus).with_version(3).encode().is_err());
    }
}
