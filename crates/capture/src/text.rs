//! Text files in the encodings that editors and programs on Windows write.

use std::borrow::Cow;

/// The text of a file in UTF-8 or UTF-16, without its byte order mark. UTF-16 needs the mark. `None` for other encodings.
pub(crate) fn decode(bytes: &[u8]) -> Option<Cow<'_, str>> {
    let utf16 = |rest: &[u8], unit: fn([u8; 2]) -> u16| {
        let (pairs, rest) = rest.as_chunks::<2>();
        let units = pairs.iter().map(|pair| unit(*pair));
        let text: Result<String, _> = char::decode_utf16(units).collect();
        text.ok().filter(|_| rest.is_empty()).map(Cow::Owned)
    };
    match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => std::str::from_utf8(rest).ok().map(Cow::Borrowed),
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => std::str::from_utf8(bytes).ok().map(Cow::Borrowed),
    }
}

/// Longest name of a file in a capture, bytes.
const NAME_BYTES: usize = 1024;
/// Longest name or value that a message repeats, bytes.
const SHOWN_BYTES: usize = 256;

/// The reason why `name` cannot be the name of a file in a capture.
pub(crate) fn fault_of_name(name: &str) -> Option<&'static str> {
    if name.len() > NAME_BYTES {
        return Some("is longer than 1024 bytes; give files and folders shorter names");
    }
    name.contains(char::is_control)
        .then_some("contains a control character, e.g. a NUL or a line break; rename the file")
}

/// A name or value of a file, as messages repeat it: the first 256 bytes and the number of the omitted bytes, with U+FFFD in
/// place of control characters.
pub(crate) fn shown(text: &str) -> String {
    let end = text.floor_char_boundary(SHOWN_BYTES);
    let start = printable(&text[..end]);
    match text.len() - end {
        0 => start,
        more => format!("{start}... ({more} more bytes)"),
    }
}

/// A text with U+FFFD in place of control characters, which a database may refuse and a terminal may obey.
pub(crate) fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_read_in_utf8_and_utf16_with_a_byte_order_mark() {
        let text = "größe 1\n";
        let marked = |mark: &[u8], units: Vec<u8>| [mark, &units].concat();
        let little = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        for bytes in [
            text.as_bytes().to_vec(),
            marked(&[0xef, 0xbb, 0xbf], text.as_bytes().to_vec()),
            marked(&[0xff, 0xfe], little),
            marked(&[0xfe, 0xff], big),
        ] {
            assert_eq!(decode(&bytes).as_deref(), Some(text), "{bytes:?}");
        }
        assert_eq!(decode(b"gr\xf6\xdfe"), None, "Latin-1");
        assert_eq!(decode(&[0xff, 0xfe, 0x41]), None, "half a character");
    }

    #[test]
    fn names_in_messages_are_short_and_without_control_characters() {
        assert_eq!(shown("train/größe 1.png"), "train/größe 1.png", "the control");
        assert_eq!(shown("a\0b\nc"), "a\u{fffd}b\u{fffd}c");
        assert_eq!(shown(&"é".repeat(200)), format!("{}... (144 more bytes)", "é".repeat(128)));
        assert_eq!(fault_of_name("train/größe 1.png"), None, "the control");
        for name in ["a\0", "a\nb.png", &"x".repeat(1025)] {
            assert!(fault_of_name(name).is_some(), "{name:?}");
        }
    }
}
