//! What messages say.

use super::image::ImageContent;
use super::poly_data::PolyData;
use super::wire::{Reader, UTF_8, cut, put_matrix, put_name, refused, text};
use crate::Result;

/// What a message says.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Content {
    /// `TRANSFORM`: rows and columns of the upper three rows, the translation in mm in the last column.
    Transform([[f32; 4]; 3]),
    /// `TDATA`: several tools of one moment.
    Tracking(Vec<Tool>),
    /// `STT_TDATA`: asks for `TDATA` at most so often, ms; 0: as often as there are any.
    StartTracking(u32),
    /// `IMAGE`.
    Image(ImageContent),
    /// `POINT`: positions, mm; names, colours and sizes are not read.
    Points(Vec<[f32; 3]>),
    /// `POLYDATA`: a mesh or lines.
    PolyData(PolyData),
    /// `STRING`, at most 65535 bytes.
    Text(String),
    /// `STATUS`.
    Status(Status),
    /// `GET_STATUS`: asks for a status.
    GetStatus,
}

/// One tool of a `TDATA` message.
#[derive(Debug, Clone, PartialEq)]
pub struct Tool {
    /// Its name, at most 20 bytes.
    pub name: String,
    /// 1 tracker, 2 instrument of six degrees of freedom, 3 reference, 4 of five degrees.
    pub kind: u8,
    /// As [`Content::Transform`] has it.
    pub matrix: [[f32; 4]; 3],
}

/// How a device is.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Status {
    /// 1: it works; others are kinds of errors.
    pub code: u16,
    /// More about the code.
    pub subcode: i64,
    /// The error's name, at most 20 bytes.
    pub error: String,
    /// In words, at most 65535 bytes.
    pub message: String,
}

impl Status {
    /// That it works, in words.
    pub fn ok(message: impl Into<String>) -> Self {
        Self { code: 1, message: message.into(), ..Self::default() }
    }
}

/// Bytes of a tool.
const TOOL_BYTES: usize = 70;
/// Bytes of a point.
const POINT_BYTES: usize = 136;
/// Bytes of a text, at most.
const MAX_TEXT: usize = u16::MAX as usize;

impl Content {
    /// The message's kind in the header.
    pub fn kind(&self) -> &'static str {
        match self {
            Content::Transform(_) => "TRANSFORM",
            Content::Tracking(_) => "TDATA",
            Content::StartTracking(_) => "STT_TDATA",
            Content::Image(_) => "IMAGE",
            Content::Points(_) => "POINT",
            Content::PolyData(_) => "POLYDATA",
            Content::Text(_) => "STRING",
            Content::Status(_) => "STATUS",
            Content::GetStatus => "GET_STATUS",
        }
    }

    pub(super) fn is_known(kind: &str) -> bool {
        const KINDS: [&str; 9] = [
            "TRANSFORM",
            "TDATA",
            "STT_TDATA",
            "IMAGE",
            "POINT",
            "POLYDATA",
            "STRING",
            "STATUS",
            "GET_STATUS",
        ];
        KINDS.contains(&kind)
    }

    /// Reads a content of some kind.
    pub(super) fn decode(kind: &str, bytes: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(bytes);
        let content = match kind {
            "TRANSFORM" => Content::Transform(reader.matrix()?),
            "TDATA" => Content::Tracking(tools(&mut reader)?),
            "STT_TDATA" => {
                let interval_ms = reader.u32()?;
                let _coordinates = reader.take(32)?;
                Content::StartTracking(interval_ms)
            }
            "IMAGE" => return ImageContent::decode(bytes).map(Content::Image),
            "POINT" => Content::Points(points(&mut reader)?),
            "POLYDATA" => return PolyData::decode(bytes).map(Content::PolyData),
            "STRING" => {
                let _encoding = reader.u16()?;
                let length = usize::from(reader.u16()?);
                Content::Text(text(reader.take(length)?))
            }
            "STATUS" => {
                let (code, subcode) = (reader.u16()?, reader.u64()? as i64);
                let error = reader.name(20)?;
                let words = reader.rest();
                let message = text(&words[..words.len().min(MAX_TEXT)]);
                return Ok(Content::Status(Status { code, subcode, error, message }));
            }
            // The protocol has no content here; some senders fill it.
            "GET_STATUS" => return Ok(Content::GetStatus),
            _ => return Err(refused("kind of an OpenIGTLink message", format!("{kind:?}"), "a known one")),
        };
        match reader.rest().len() {
            0 => Ok(content),
            more => {
                let found = format!("{more} bytes after the content of {kind}");
                Err(refused("OpenIGTLink message", found, "none"))
            }
        }
    }

    /// Adds the bytes of the content.
    pub(super) fn encode(&self, bytes: &mut Vec<u8>) -> Result<()> {
        match self {
            Content::Transform(matrix) => put_matrix(bytes, matrix),
            Content::Tracking(tools) => {
                for tool in tools {
                    put_name(bytes, &tool.name, 20);
                    bytes.extend([tool.kind, 0]);
                    put_matrix(bytes, &tool.matrix);
                }
            }
            Content::StartTracking(interval_ms) => {
                bytes.extend(interval_ms.to_be_bytes());
                put_name(bytes, "", 32);
            }
            Content::Image(image) => image.encode(bytes)?,
            Content::Points(points_mm) => {
                for (k, point) in points_mm.iter().enumerate() {
                    put_name(bytes, &format!("P{k}"), 64);
                    put_name(bytes, "", 32);
                    bytes.extend([255, 255, 0, 255]);
                    bytes.extend(point.iter().flat_map(|x| x.to_be_bytes()));
                    bytes.extend(0_f32.to_be_bytes());
                    put_name(bytes, "", 20);
                }
            }
            Content::PolyData(data) => data.encode(bytes)?,
            Content::Text(words) => {
                let length = u16::try_from(words.len());
                let length =
                    length.map_err(|_| refused("bytes of a STRING", words.len(), "at most 65535"))?;
                bytes.extend(UTF_8.to_be_bytes());
                bytes.extend(length.to_be_bytes());
                bytes.extend(words.bytes());
            }
            Content::Status(Status { code, subcode, error, message }) => {
                bytes.extend(code.to_be_bytes());
                bytes.extend(subcode.to_be_bytes());
                put_name(bytes, error, 20);
                bytes.extend(cut(message, MAX_TEXT).bytes().chain([0]));
            }
            Content::GetStatus => {}
        }
        Ok(())
    }
}

fn tools(reader: &mut Reader) -> Result<Vec<Tool>> {
    let mut tools = Vec::with_capacity(reader.rest().len() / TOOL_BYTES);
    while !reader.rest().is_empty() {
        let name = reader.name(20)?;
        let kind = reader.u8()?;
        let _reserved = reader.u8()?;
        tools.push(Tool { name, kind, matrix: reader.matrix()? });
    }
    Ok(tools)
}

fn points(reader: &mut Reader) -> Result<Vec<[f32; 3]>> {
    let mut points = Vec::with_capacity(reader.rest().len() / POINT_BYTES);
    while !reader.rest().is_empty() {
        let _name_group_colour = reader.take(100)?;
        points.push(reader.point()?);
        let _diameter_owner = reader.take(24)?;
    }
    Ok(points)
}
