//! The text of mesh files.

use std::borrow::Cow;

/// Bytes without the byte order mark of UTF-8.
pub(super) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// The lines of a text, which end in LF, CR LF or CR.
pub(super) fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.split('\n').flat_map(|line| line.strip_suffix('\r').unwrap_or(line).split('\r'))
}

/// A number as C programs print it: also as Microsoft's print those that are not finite, `-nan(ind)` and `1.#INF`.
pub(super) fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| match word.trim_start_matches(['-', '+']).to_ascii_lowercase().as_str() {
        "nan(ind)" | "nan(snan)" | "1.#qnan" | "1.#ind" | "1.#snan" | "1.#qnan0" | "1.#ind00" => {
            Some(f64::NAN)
        }
        "1.#inf" | "1.#inf00" => Some(f64::INFINITY.copysign(if word.starts_with('-') { -1.0 } else { 1.0 })),
        _ => None,
    })
}

/// The lines of a header that binary data may follow, whose lines end like its first one.
pub(super) struct HeaderLines<'a> {
    pub rest: &'a [u8],
    end: u8,
}

impl<'a> HeaderLines<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        let rest = without_mark(bytes);
        // In CR LF it is the LF that ends a line: the CR before it is white space.
        let end = match rest.iter().position(|&b| b == b'\r' || b == b'\n') {
            Some(at) if rest[at] == b'\r' && rest.get(at + 1) != Some(&b'\n') => b'\r',
            _ => b'\n',
        };
        Self { rest, end }
    }

    /// The next line without white space about it; `None` at the end of the file.
    pub fn next(&mut self) -> Option<Cow<'a, str>> {
        let end = self.rest.iter().position(|&b| b == self.end)?;
        let line = &self.rest[..end];
        self.rest = &self.rest[end + 1..];
        Some(String::from_utf8_lossy(line.trim_ascii()))
    }
}
