//! The headers of the tus protocol.

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::server::problem::Problem;
use crate::store::{Checksum, UploadRecord};
use relume_api::problem::FieldError;

pub(super) const RESUMABLE: HeaderName = HeaderName::from_static("tus-resumable");
pub(super) const VERSION: HeaderName = HeaderName::from_static("tus-version");
pub(super) const EXTENSION: HeaderName = HeaderName::from_static("tus-extension");
pub(super) const MAX_SIZE: HeaderName = HeaderName::from_static("tus-max-size");
pub(super) const ALGORITHMS: HeaderName = HeaderName::from_static("tus-checksum-algorithm");
pub(super) const LENGTH: HeaderName = HeaderName::from_static("upload-length");
pub(super) const OFFSET: HeaderName = HeaderName::from_static("upload-offset");
pub(super) const EXPIRES: HeaderName = HeaderName::from_static("upload-expires");
pub(super) const METADATA: HeaderName = HeaderName::from_static("upload-metadata");
pub(super) const OVERRIDE: HeaderName = HeaderName::from_static("x-http-method-override");
const CHECKSUM: HeaderName = HeaderName::from_static("upload-checksum");
const DEFER: HeaderName = HeaderName::from_static("upload-defer-length");
const CONCAT: HeaderName = HeaderName::from_static("upload-concat");

/// Maximum bytes of `Upload-Metadata`.
const METADATA_BYTES: usize = 4096;

/// 400, which names a header.
pub(super) fn wrong(name: &str, detail: impl Into<String>) -> Problem {
    let (pointer, detail) = (format!("header/{name}"), detail.into());
    let mut problem = Problem::new(StatusCode::BAD_REQUEST, "invalid-header", "A header is invalid")
        .detail(format!("{name}: {detail}"));
    problem.errors.push(FieldError { pointer, detail });
    problem
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// The value of a header in bytes.
fn bytes(headers: &HeaderMap, name: &HeaderName, shown: &str) -> Result<u64, Problem> {
    let digits = |t: &&str| !t.is_empty() && t.bytes().all(|c| c.is_ascii_digit());
    let number = text(headers, name).filter(digits).and_then(|t| t.parse().ok());
    // The database cannot count larger uploads.
    let number = number.filter(|n| *n <= i64::MAX as u64);
    number.ok_or_else(|| wrong(shown, "is required and must be a whole number of bytes"))
}

/// The length of a new upload.
pub(super) fn length(headers: &HeaderMap) -> Result<u64, Problem> {
    for (name, shown) in [(DEFER, "Upload-Defer-Length"), (CONCAT, "Upload-Concat")] {
        if headers.contains_key(name) {
            return Err(wrong(shown, "belongs to an extension that is not in Tus-Extension"));
        }
    }
    bytes(headers, &LENGTH, "Upload-Length")
}

/// The offset of a chunk.
pub(super) fn offset(headers: &HeaderMap) -> Result<u64, Problem> {
    bytes(headers, &OFFSET, "Upload-Offset")
}

/// `Upload-Metadata`, as sent.
pub(super) fn metadata(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    if !headers.contains_key(METADATA) {
        return Ok(None);
    }
    let refused = |why: &str| wrong("Upload-Metadata", why);
    let sent = text(headers, &METADATA).ok_or_else(|| refused("must be ASCII"))?;
    if sent.len() > METADATA_BYTES {
        return Err(refused("must have at most 4096 bytes"));
    }
    let is_pair = |pair: &str| {
        let (key, value) = pair.split_once(' ').unwrap_or((pair, ""));
        !key.is_empty() && STANDARD.decode(value).is_ok()
    };
    let is_good = sent.is_empty() || sent.split(',').map(str::trim).all(is_pair);
    is_good
        .then(|| Some(sent.to_owned()))
        .ok_or_else(|| refused("must be keys and Base64 values, e.g. filename Yy56aXA=,filetype YQ=="))
}

/// The file name in `Upload-Metadata`.
pub(super) fn filename(metadata: &str) -> Option<String> {
    let pairs = metadata.split(',').filter_map(|pair| pair.trim().split_once(' '));
    let (_, value) = pairs.into_iter().find(|(key, _)| *key == "filename")?;
    String::from_utf8(STANDARD.decode(value).ok()?).ok()
}

/// The expected checksum of a chunk.
pub(super) fn checksum(headers: &HeaderMap) -> Result<Option<Checksum>, Problem> {
    let Some(value) = headers.get(CHECKSUM) else { return Ok(None) };
    let (algorithm, digest) = value.to_str().ok().and_then(|t| t.split_once(' ')).unwrap_or(("", ""));
    let digest = STANDARD.decode(digest.trim()).unwrap_or_default();
    match (algorithm, digest.len()) {
        ("sha1", 20) => Ok(Some(Checksum::Sha1(digest))),
        ("sha256", 32) => Ok(Some(Checksum::Sha256(digest))),
        _ => Err(wrong("Upload-Checksum", "must be sha1 or sha256, a space, and the digest in Base64")),
    }
}

/// Writes offset, length and expiry time of an upload.
pub(super) fn write_headers(headers: &mut HeaderMap, upload: &UploadRecord) {
    headers.insert(OFFSET, HeaderValue::from(upload.offset()));
    if let Ok(until) = HeaderValue::from_str(&http_date(upload.expires_ms)) {
        headers.insert(EXPIRES, until);
    }
}

/// A time in the format of HTTP (RFC 9110, IMF-fixdate).
fn http_date(ms: i64) -> String {
    let time = jiff::Timestamp::from_millisecond(ms).unwrap_or_default();
    time.strftime("%a, %d %b %Y %H:%M:%S GMT").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_str(value).unwrap())])
    }

    #[test]
    fn upload_length_accepts_only_decimal_digits() {
        assert_eq!(length(&with(LENGTH, "12")).unwrap(), 12);
        for odd in ["", "-1", "+1", "1.0", "0x1", "1 ", "99999999999999999999", "9223372036854775808"] {
            let refused = length(&with(LENGTH, odd)).unwrap_err();
            assert_eq!(
                (refused.status, refused.errors[0].pointer.as_str()),
                (400, "header/Upload-Length"),
                "{odd}"
            );
        }
        assert!(length(&HeaderMap::new()).is_err() && offset(&HeaderMap::new()).is_err());
        assert!(
            length(&with(DEFER, "1")).unwrap_err().detail.as_ref().unwrap().contains("Upload-Defer-Length")
        );
    }

    #[test]
    fn upload_metadata_pairs_are_parsed_with_the_filename() {
        let sent = "filetype YQ==,filename c2Nhbi56aXA=,private";
        assert_eq!(metadata(&with(METADATA, sent)).unwrap().as_deref(), Some(sent));
        assert_eq!(filename(sent).as_deref(), Some("scan.zip"));
        assert_eq!((filename("private"), metadata(&HeaderMap::new()).unwrap()), (None, None));
        for odd in ["filename c2Nhbi56aXA", "filename scan.zip!", "a YQ==,,b YQ==", " "] {
            assert_eq!(metadata(&with(METADATA, odd)).unwrap_err().status, 400, "{odd:?}");
        }
        assert!(metadata(&with(METADATA, &format!("a {}", "YQ==".repeat(2000)))).is_err());
    }

    #[test]
    fn upload_checksum_must_match_the_algorithm_length() {
        let known = checksum(&with(CHECKSUM, "sha1 Kq5sNclPz7QV2+lfQIuc6R7oRu0=")).unwrap();
        assert!(matches!(known, Some(Checksum::Sha1(digest)) if digest.len() == 20));
        for odd in
            ["sha256 Kq5sNclPz7QV2+lfQIuc6R7oRu0=", "md5 Kq5sNclPz7QV2+lfQIuc6R7oRu0=", "sha1", "sha1 !"]
        {
            assert_eq!(checksum(&with(CHECKSUM, odd)).unwrap_err().status, 400, "{odd}");
        }
    }

    #[test]
    fn times_are_formatted_as_http_dates() {
        assert_eq!(http_date(784_111_777_000), "Sun, 06 Nov 1994 08:49:37 GMT");
    }
}
