//! JSON files of a capture, with errors that name the file and the key.

use serde::de::DeserializeOwned;

use crate::{CaptureError, text};

/// Parses JSON. An error names the file and, where it can be found, the last key before the error.
///
/// # Errors
/// [`CaptureError::Field`] with that key, else [`CaptureError::File`].
pub(super) fn parse_json<T: DeserializeOwned>(file: &str, bytes: &[u8]) -> Result<T, CaptureError> {
    let Some(text) = text::decode(bytes) else {
        let reason = "is not UTF-8 text".to_owned();
        return Err(CaptureError::File { file: file.to_owned(), reason });
    };
    let bytes = text.as_bytes();
    serde_json::from_slice(bytes).map_err(|error| {
        let before = error_offset(bytes, &error);
        // The error repeats a value of the file.
        let error = text::shown(&error.to_string());
        let hint = python_float_at(bytes, before).map_or(String::new(), |token| {
            format!(" ({token} is not JSON; some tools write it for values that are not numbers)")
        });
        let file = file.to_owned();
        match last_key(&bytes[..before]) {
            Some(field) => CaptureError::at_field(&file, field, format!("{error}{hint}")),
            None => CaptureError::File { file, reason: format!("is not valid JSON: {error}{hint}") },
        }
    })
}

/// Byte offset of the error's line and column.
fn error_offset(bytes: &[u8], error: &serde_json::Error) -> usize {
    let lines_before = bytes.split_inclusive(|&b| b == b'\n').take(error.line().saturating_sub(1));
    (lines_before.map(<[u8]>::len).sum::<usize>() + error.column()).min(bytes.len())
}

/// The last `"key":` of a JSON text that was cut at the error.
fn last_key(before: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(before);
    let colon = text.rfind(':')?;
    let end = text[..colon].rfind('"')?;
    let start = text[..end].rfind('"')?;
    let key = &text[start + 1..end];
    (!key.is_empty() && key.len() <= 64 && text[end + 1..colon].trim().is_empty()).then(|| key.to_owned())
}

/// A Python float literal that JSON does not have, at the error.
fn python_float_at(bytes: &[u8], error: usize) -> Option<&'static str> {
    let rest = &bytes[error.saturating_sub(2)..];
    ["NaN", "Infinity"]
        .into_iter()
        .find(|token| rest.windows(token.len()).take(3).any(|w| w == token.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_literal_is_refused_by_key() {
        let text = b"{\n \"frames\": [ {\n  \"transform_matrix\": [[1.0, NaN, 0, 0]] } ] }";
        let error = parse_json::<serde_json::Value>("transforms.json", text).unwrap_err();
        assert_eq!(error.file(), Some("transforms.json"));
        assert_eq!(error.field(), Some("transform_matrix"));
        assert!(error.to_string().contains("NaN"), "{error}");
    }
}
