//! The one error type of the crate.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// What can go wrong between a recording and a mesh.
///
/// Messages name the file, the frame, the field, what was found and what was expected, as far as each is known where the
/// error arises. [`source`](std::error::Error::source) gives the system's or the device's own error.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read.
    #[error("{}: cannot read: {source}", path.display())]
    #[non_exhaustive]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file could not be written. Nothing was left behind under its name.
    #[error("{}: cannot write: {source}", path.display())]
    #[non_exhaustive]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Something other than a file could not be written, or an encoder failed.
    #[error("{target}: cannot write: {source}")]
    Output {
        /// What was to be written: standard output, a picture, a figure.
        target: &'static str,
        /// What the system or the encoder said.
        source: std::io::Error,
    },
    /// A connection could not be made, or was lost.
    #[error("connection to {address}: {source}")]
    Connection {
        /// The other side, as it was given.
        address: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file's content is not what its format or its use asks for.
    #[error("{}: {}{field}: found {found}, expected {expected}", path.display(), frame_prefix(*frame))]
    #[non_exhaustive]
    Input {
        /// The file.
        path: PathBuf,
        /// The frame's number in the file, where one is to blame.
        frame: Option<usize>,
        /// The variable, column or quantity.
        field: String,
        /// What was there.
        found: String,
        /// What should have been there.
        expected: String,
    },
    /// A file name's ending names no format that this operation knows.
    #[error("{}: unknown ending {ending:?}, expected one of {expected}", path.display())]
    #[non_exhaustive]
    UnknownEnding {
        /// The file.
        path: PathBuf,
        /// Its ending, without the dot; empty where it has none.
        ending: String,
        /// The endings that would do.
        expected: &'static str,
    },
    /// A setting is outside what makes sense.
    #[error("setting {name}: found {found}, expected {expected}")]
    #[non_exhaustive]
    Setting {
        /// The setting's name, as in the TOML file.
        name: Cow<'static, str>,
        /// Its value.
        found: String,
        /// What would do.
        expected: String,
    },
    /// A frame of a recording in memory cannot be used.
    #[error("frame {frame}: {field}: found {found}, expected {expected}")]
    #[non_exhaustive]
    Frame {
        /// The frame, by [`Recording::number`](crate::recording::Recording::number).
        frame: usize,
        /// The variable, column or quantity.
        field: &'static str,
        /// What was there.
        found: String,
        /// What should have been there.
        expected: String,
    },
    /// A recording in memory cannot be used as a whole.
    #[error("{field}: found {found}, expected {expected}")]
    #[non_exhaustive]
    Recording {
        /// The quantity.
        field: &'static str,
        /// What was there.
        found: String,
        /// What should have been there.
        expected: String,
    },
    /// The points of a section in memory cannot be used.
    #[error("section: {field}: found {found}, expected {expected}")]
    #[non_exhaustive]
    Section {
        /// The array or quantity.
        field: &'static str,
        /// What was there.
        found: String,
        /// What should have been there.
        expected: String,
    },
    /// An iterative solver met numbers that it cannot go on with.
    #[error("{what}: found {found}, expected {expected}")]
    #[non_exhaustive]
    Solver {
        /// The quantity.
        what: &'static str,
        /// What was there.
        found: String,
        /// What should have been there.
        expected: &'static str,
    },
    /// A surface cannot be used for what was asked.
    #[error("surface: {what}: found {found}, expected {expected}")]
    #[non_exhaustive]
    Surface {
        /// The quantity.
        what: String,
        /// What was there.
        found: String,
        /// What should have been there.
        expected: String,
    },
    /// The work was ended before it was done, because the host asked for that.
    #[error("cancelled")]
    Cancelled,
    /// The device failed.
    #[cfg(feature = "gpu")]
    #[error("{0}")]
    Gpu(#[from] crate::gpu::GpuError),
}

/// The crate's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;

fn frame_prefix(frame: Option<usize>) -> String {
    frame.map(|k| format!("frame {k}: ")).unwrap_or_default()
}

/// A text without control characters and of bounded length; twice the same as once.
fn printable(text: &str) -> String {
    const LONGEST: usize = 240;
    let mut shown = String::new();
    for c in text.chars().take(LONGEST + 1) {
        match c {
            '\\' | '"' | '\'' => shown.push(c),
            _ => shown.extend(c.escape_debug()),
        }
    }
    if shown.chars().count() > LONGEST {
        shown = shown.chars().take(LONGEST - 1).chain(['…']).collect();
    }
    shown
}

/// Told of the stage that begins, the number of stages done, and their number in all; on any thread.
pub type StageProgress<'a> = dyn Fn(&'static str, usize, usize) -> ControlFlow<()> + Sync + 'a;

/// [`Error::Cancelled`] where a callback asks to end.
pub(crate) fn unless_cancelled(asked: ControlFlow<()>) -> Result<()> {
    match asked {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}

impl Error {
    /// The same with the number of a frame in its file in the place of that in a list.
    pub(crate) fn with_number(self, number: impl Fn(usize) -> usize) -> Self {
        match self {
            Self::Frame { frame, field, found, expected } => {
                Self::Frame { frame: number(frame), field, found, expected }
            }
            other => other,
        }
    }

    /// An [`Error::Read`] of a file or folder.
    pub fn read(path: impl Into<PathBuf>, source: std::io::Error) -> Self {
        Error::Read { path: path.into(), source }
    }

    /// An [`Error::Write`] of a file or folder.
    pub fn write(path: impl Into<PathBuf>, source: std::io::Error) -> Self {
        Error::Write { path: path.into(), source }
    }

    /// An [`Error::Setting`], by the setting's name in the TOML file.
    pub fn setting(
        name: impl Into<Cow<'static, str>>,
        found: impl ToString,
        expected: impl ToString,
    ) -> Self {
        Error::Setting { name: name.into(), found: found.to_string(), expected: expected.to_string() }
    }

    /// Settings that cannot be read out of the text of a TOML file: where, and why.
    pub(crate) fn settings(path: &Path, text: &str, error: &toml::de::Error) -> Self {
        let Some(before) = error.span().and_then(|span| text.get(..span.start)) else {
            return Self::input(path, "settings", error.to_string().trim_end().replace('\n', " "), "TOML");
        };
        let line = before.matches('\n').count() + 1;
        // A value of the wrong kind says itself what was expected.
        let (found, expected) =
            error.message().split_once(", expected ").unwrap_or((error.message(), "TOML"));
        let found = found.strip_prefix("found ").unwrap_or(found);
        Self::input(path, "settings", format!("line {line}: {found}"), expected.to_owned())
    }

    /// An [`Error::Input`] about a whole file or variable. What comes from the file is made fit for a terminal: control
    /// characters are escaped, and what is long is cut.
    pub fn input(
        path: &Path,
        field: impl Into<String>,
        found: impl ToString,
        expected: impl ToString,
    ) -> Self {
        Error::Input {
            path: path.to_owned(),
            frame: None,
            field: printable(&field.into()),
            found: printable(&found.to_string()),
            expected: printable(&expected.to_string()),
        }
    }

    /// As [`in_file`](Self::in_file), for an error about one frame of a file, by the frame's number there.
    #[must_use]
    pub(crate) fn in_frame_of(self, path: &Path, number: usize) -> Self {
        match self.in_file(path) {
            Error::Input { path, field, found, expected, frame } => {
                Error::Input { path, frame: frame.or(Some(number)), field, found, expected }
            }
            other => other,
        }
    }

    /// Says which file an error came from: turns [`Error::Frame`], [`Error::Recording`] and [`Error::Surface`] into
    /// [`Error::Input`] and leaves every other error as it is.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Error::Frame { frame, field, found, expected } => Error::Input {
                path: path.to_owned(),
                frame: Some(frame),
                field: field.to_owned(),
                found,
                expected,
            },
            Error::Recording { field, found, expected } => Error::input(path, field, found, expected),
            Error::Surface { what, found, expected } => Error::input(path, what, found, expected),
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_file_holds_is_shown_without_control_characters_and_cut() {
        for (text, shown) in [
            ("it's \"a\" \\ b, 2 mm² → °", "it's \"a\" \\ b, 2 mm² → °"),
            ("\x1b[31m\r\n\u{feff}\u{202e}", "\\u{1b}[31m\\r\\n\\u{feff}\\u{202e}"),
        ] {
            assert_eq!(printable(text), shown);
            assert_eq!(printable(shown), shown);
        }
        let cut = printable(&"é".repeat(1000));
        assert_eq!((cut.chars().count(), cut.ends_with("é…")), (240, true));
        assert_eq!(printable(&cut), cut);
    }
}
