//! Messages out of a stream of bytes.

use super::message::{HEADER_BYTES, Header, Message};
use crate::Error;
use std::io::{self, ErrorKind, Read};

/// The longest body that is skipped, bytes. A header that states more is none, and the connection is closed.
pub const MAX_SKIPPED_BYTES: u64 = 1 << 30;

/// Bytes that are asked for at once. What is allocated for a body grows with what has come of it.
const PIECE: usize = 1 << 16;

/// Reads messages one after the other. A read that is interrupted, such as by a socket's timeout, loses
/// nothing.
#[derive(Debug)]
pub struct MessageReader<R> {
    stream: R,
    /// The header of the message that is being read.
    header: Option<Header>,
    /// What has come of its header or body.
    bytes: Vec<u8>,
    /// Bytes of a body that are still to be skipped.
    to_skip: u64,
    /// The highest version of header so far.
    version: Option<u16>,
}

/// What a [`MessageReader`] came to.
#[derive(Debug)]
#[non_exhaustive]
pub enum Step {
    /// A message.
    Message(Message),
    /// A message of a kind that is not known was skipped.
    Unknown,
    /// A message that is not what it should be was skipped; the next can be read.
    Refused(Error),
    /// Nothing came within the stream's timeout.
    Silent,
    /// The stream has ended, or failed as said.
    Closed(io::Result<()>),
    /// What came is no header: nothing more can be read.
    Lost(Error),
}

impl<R: Read> MessageReader<R> {
    /// A reader at the beginning of a message.
    pub fn new(stream: R) -> Self {
        Self { stream, header: None, bytes: Vec::new(), to_skip: 0, version: None }
    }

    /// The highest version of header so far.
    pub fn version(&self) -> Option<u16> {
        self.version
    }

    /// The next message, or what came in its place.
    pub fn step(&mut self) -> Step {
        loop {
            if let Some(step) = self.skip() {
                return step;
            }
            let Some(header) = &self.header else {
                if let Some(step) = self.fill(HEADER_BYTES) {
                    return step;
                }
                let mut bytes = [0; HEADER_BYTES];
                bytes.copy_from_slice(&self.bytes);
                self.bytes.clear();
                match Header::decode(&bytes) {
                    Ok(header) if header.body_bytes > MAX_SKIPPED_BYTES => {
                        return Step::Lost(Error::Recording {
                            field: "bytes of an OpenIGTLink body",
                            found: header.body_bytes.to_string(),
                            expected: format!("at most {MAX_SKIPPED_BYTES}"),
                        });
                    }
                    Ok(header) => {
                        self.version = self.version.max(Some(header.version));
                        self.header = Some(header);
                    }
                    Err(error) => return Step::Lost(error),
                }
                continue;
            };
            let size = match header.check_size() {
                Ok(size) if header.is_known() => size,
                size => {
                    self.to_skip = header.body_bytes;
                    self.header = None;
                    return match size {
                        Ok(_) => Step::Unknown,
                        Err(error) => Step::Refused(error),
                    };
                }
            };
            if let Some(step) = self.fill(size) {
                return step;
            }
            let message = self.header.take().map(|header| header.decode_body(&self.bytes));
            self.bytes = Vec::new();
            return match message {
                Some(Ok(message)) => Step::Message(message),
                Some(Err(error)) => Step::Refused(error),
                None => continue,
            };
        }
    }

    /// Reads until there are so many bytes; `Some` where they have not come.
    fn fill(&mut self, count: usize) -> Option<Step> {
        while self.bytes.len() < count {
            let before = self.bytes.len();
            self.bytes.resize(before + (count - before).min(PIECE), 0);
            let read = self.stream.read(&mut self.bytes[before..]);
            self.bytes.truncate(before + *read.as_ref().unwrap_or(&0));
            if let Some(step) = ended(&read) {
                return Some(step);
            }
        }
        None
    }

    fn skip(&mut self) -> Option<Step> {
        let mut piece = [0; 4096];
        while self.to_skip > 0 {
            let count = piece.len().min(usize::try_from(self.to_skip).unwrap_or(usize::MAX));
            let read = self.stream.read(&mut piece[..count]);
            self.to_skip -= *read.as_ref().unwrap_or(&0) as u64;
            if let Some(step) = ended(&read) {
                return Some(step);
            }
        }
        None
    }
}

fn ended(read: &io::Result<usize>) -> Option<Step> {
    match read {
        Ok(0) => Some(Step::Closed(Ok(()))),
        Ok(_) => None,
        Err(error) => match error.kind() {
            ErrorKind::Interrupted => None,
            ErrorKind::WouldBlock | ErrorKind::TimedOut => Some(Step::Silent),
            kind => Some(Step::Closed(Err(io::Error::new(kind, error.to_string())))),
        },
    }
}
