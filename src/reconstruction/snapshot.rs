//! A live vessel as a file, so that a host that was ended goes on where it was.

use super::live::{Live, Vessel};
use crate::output::write_atomically;
use crate::recording::{LiveScreening, Recording};
use crate::settings::Settings;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// What such a file begins with. The control characters are those that a transfer as text would change.
const MAGIC: [u8; 16] = *b"lumenmesh live\r\n";
/// Version of what follows. Another one is due with every change of what a live vessel consists of.
const VERSION: u32 = 10;
/// Bytes before the content: the magic number, the version, the content's checksum and its length.
const HEADER: usize = 32;
/// The largest content, bytes.
const MAX_CONTENT: u64 = 1 << 32;

/// What does not depend on the method; the vessel follows.
#[derive(Serialize, Deserialize)]
struct Common<T, U> {
    /// As TOML.
    settings: String,
    frames: usize,
    kept: U,
    screening: T,
}

impl Live {
    /// Writes the whole state as one file; [`restore`](Self::restore) goes on from there. The file grows as memory does, and
    /// writing it may take longer than a frame.
    ///
    /// # Errors
    /// [`Error::Write`] where the file cannot be written; it is then as before.
    pub fn snapshot(&self, path: &Path) -> Result<()> {
        let bytes = self.state().map_err(|e| e.in_file(path))?;
        write_atomically(path, |file| file.write_all(&bytes))
    }

    /// The bytes of a [snapshot](Self::snapshot), for a host that writes them while the next frame is computed.
    ///
    /// # Errors
    /// [`Error::Recording`] where the state has no form as bytes.
    pub fn state(&self) -> Result<Vec<u8>> {
        let common = Common {
            settings: self.settings.to_toml()?,
            frames: self.frames,
            kept: self.kept.as_ref().map(|recording| &recording.frames),
            screening: &self.screening,
        };
        let failed = |e: postcard::Error| Error::Recording {
            field: "state",
            found: e.to_string(),
            expected: "what can be written".into(),
        };
        let mut content = postcard::to_stdvec(&common).map_err(failed)?;
        content = match &self.vessel {
            Vessel::Cylinders(cylinders) => postcard::to_extend(cylinders.state(), content),
            Vessel::Sweep(sweep) => postcard::to_extend(&**sweep, content),
        }
        .map_err(failed)?;
        let mut state = MAGIC.to_vec();
        state.extend(VERSION.to_le_bytes());
        state.extend(crc32fast::hash(&content).to_le_bytes());
        state.extend((content.len() as u64).to_le_bytes());
        state.extend(content);
        Ok(state)
    }

    /// A vessel as it was when the [snapshot](Self::snapshot) was written, with its settings. What follows is the same, to
    /// the last bit, as if it had never ended.
    ///
    /// # Errors
    /// [`Error::Read`] where the file cannot be read, [`Error::Input`] where it is no snapshot, is damaged, or was written by
    /// another version, and [`Error::Setting`] where its settings ask for a device that is not there.
    pub fn restore(path: &Path) -> Result<Self> {
        let content = content(path)?;
        let broken = || Error::input(path, "content", "a state that does not hold together", "a snapshot");
        let (common, rest) = postcard::take_from_bytes::<Common<LiveScreening, Option<Vec<_>>>>(&content)
            .map_err(|_| broken())?;
        let settings: Settings = Settings::parse(&common.settings).map_err(|_| broken())?;
        let mut live = Live::new(&settings)?;
        let rest = match &mut live.vessel {
            Vessel::Cylinders(cylinders) => cylinders.go_on(rest),
            Vessel::Sweep(sweep) => sweep.go_on(rest),
        };
        let kept = common.kept.as_ref().map_or(common.frames, Vec::len);
        if rest != Some(&[]) || kept != common.frames || !common.screening.is_sound() {
            return Err(broken());
        }
        live.frames = common.frames;
        live.kept = common.kept.map(|frames| Recording { frames });
        live.screening = common.screening;
        Ok(live)
    }
}

/// The content of a snapshot that is whole and of this version.
fn content(path: &Path) -> Result<Vec<u8>> {
    let failed = |source| Error::read(path, source);
    let refused =
        |field: &str, found: String, expected: String| Err(Error::input(path, field, found, expected));
    let file = File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(HEADER as u64 + MAX_CONTENT).read_to_end(&mut bytes).map_err(failed)?;
    let begins = bytes.len().min(MAGIC.len());
    if bytes[..begins] != MAGIC[..begins] || bytes.is_empty() {
        return refused("content", "another kind of file".into(), "a snapshot of a live vessel".into());
    }
    let Some((header, _)) = bytes.split_first_chunk::<HEADER>() else {
        return refused("content", format!("{} bytes", bytes.len()), format!("at least {HEADER}"));
    };
    let four = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let (version, checksum) = (four(16), four(20));
    let length = u64::from(four(24)) | u64::from(four(28)) << 32;
    if version != VERSION {
        return refused("version", version.to_string(), format!("{VERSION}, which this lumenmesh writes"));
    }
    bytes.drain(..HEADER);
    if bytes.len() as u64 != length {
        return refused(
            "content",
            format!("{} bytes", bytes.len()),
            format!("{length}: the file is not whole"),
        );
    }
    if crc32fast::hash(&bytes) != checksum {
        return refused("content", "bytes that have changed".into(), "those of the checksum".into());
    }
    Ok(bytes)
}
