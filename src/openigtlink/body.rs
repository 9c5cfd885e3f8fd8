//! What messages say.

use super::poly_data::PolyData;
use super::refused;
use super::wire::{Reader, put_matrix, put_name, text};
use crate::Result;

/// What a message says.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Content {
    /// `TRANSFORM`: rows and columns of the upper three rows, the translation in mm in the last column.
    Transform([[f32; 4]; 3]),
    /// `TDATA`: several tools of one moment.
    Tracking(Vec<Tool>),
    /// `POLYDATA`: a mesh or lines.
    PolyData(PolyData),
    /// `STRING`.
    Text(String),
    /// `STATUS`.
    Status(Status),
    /// `GET_STATUS`: asks for a status.
    GetStatus,
    /// A message of another kind.
    Other {
        /// Its kind.
        kind: String,
        /// Its content, without extended header and metadata.
        bytes: Vec<u8>,
    },
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
    /// In words.
    pub message: String,
}

impl Content {
    /// The message's kind in the header.
    pub fn kind(&self) -> &str {
        match self {
            Content::Transform(_) => "TRANSFORM",
            Content::Tracking(_) => "TDATA",
            Content::PolyData(_) => "POLYDATA",
            Content::Text(_) => "STRING",
            Content::Status(_) => "STATUS",
            Content::GetStatus => "GET_STATUS",
            Content::Other { kind, .. } => kind,
        }
    }

    /// Reads a content of some kind.
    pub(super) fn decode(kind: &str, bytes: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(bytes);
        let content = match kind {
            "TRANSFORM" => Content::Transform(reader.matrix()?),
            "TDATA" => Content::Tracking(tools(&mut reader)?),
            "POLYDATA" => return PolyData::decode(bytes).map(Content::PolyData),
            "STRING" => {
                let _encoding = reader.u16()?;
                let length = usize::from(reader.u16()?);
                Content::Text(text(reader.take(length)?))
            }
            "STATUS" => {
                let (code, subcode) = (reader.u16()?, reader.u64()? as i64);
                let error = reader.name(20)?;
                return Ok(Content::Status(Status { code, subcode, error, message: text(reader.rest()) }));
            }
            "GET_STATUS" => Content::GetStatus,
            _ => return Ok(Content::Other { kind: kind.into(), bytes: bytes.to_vec() }),
        };
        match reader.rest().len() {
            0 => Ok(content),
            more => {
                Err(refused("OpenIGTLink message", format!("{more} bytes more"), "none after its content"))
            }
        }
    }

    /// The bytes of the content. A text longer than 65535 bytes, which `STRING` cannot hold, is cut.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        match self {
            Content::Transform(matrix) => put_matrix(&mut bytes, matrix),
            Content::Tracking(tools) => {
                for tool in tools {
                    put_name(&mut bytes, &tool.name, 20);
                    bytes.extend([tool.kind, 0]);
                    put_matrix(&mut bytes, &tool.matrix);
                }
            }
            Content::PolyData(data) => bytes = data.encode(),
            Content::Text(words) => {
                let length = words.len().min(usize::from(u16::MAX));
                let end = (0..=length).rev().find(|&end| words.is_char_boundary(end)).unwrap_or(0);
                bytes.extend(super::UTF_8.to_be_bytes());
                bytes.extend((end as u16).to_be_bytes());
                bytes.extend(words[..end].bytes());
            }
            Content::Status(Status { code, subcode, error, message }) => {
                bytes.extend(code.to_be_bytes());
                bytes.extend(subcode.to_be_bytes());
                put_name(&mut bytes, error, 20);
                bytes.extend(message.bytes().chain([0]));
            }
            Content::GetStatus => {}
            Content::Other { bytes: others, .. } => bytes.clone_from(others),
        }
        bytes
    }
}

/// Bytes of a tool.
const TOOL_BYTES: usize = 70;

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
