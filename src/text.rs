//! Text in the encodings that other programs write.

use encoding_rs::{Encoding, WINDOWS_1252};
use std::borrow::Cow;

/// The bytes of a file as text, without its byte order mark: in the encoding of that mark, else UTF-8, and Windows-1252
/// where it is none.
pub(crate) fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    if let Some((encoding, mark)) = Encoding::for_bom(bytes) {
        return encoding.decode_without_bom_handling(&bytes[mark..]).0;
    }
    std::str::from_utf8(bytes)
        .map_or_else(|_| WINDOWS_1252.decode_without_bom_handling(bytes).0, Cow::Borrowed)
}

/// A text of the file for a message: without control characters, not too long.
pub(crate) fn shown(text: &str, length: usize) -> String {
    let mut shown: String =
        text.chars().take(length).map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    if text.chars().nth(length).is_some() {
        shown.push('…');
    }
    shown
}
