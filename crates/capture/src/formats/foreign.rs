//! Recognises files of other kinds that stand in the place of an image or a model.

/// Recognises a Git LFS pointer, a web page, a HEIC or AVIF picture and an MP4 file by the first bytes. Returns a sentence with the
/// kind and the remedy, or `None` for all other files.
pub fn recognise(bytes: &[u8]) -> Option<&'static str> {
    let start = bytes.get(..64).unwrap_or(bytes);
    let trimmed = start.trim_ascii_start().to_ascii_lowercase();
    if start.starts_with(b"version https://git-lfs") {
        return Some("is a Git LFS pointer instead of the file; run `git lfs pull`");
    }
    if trimmed.starts_with(b"<!doctype html") || trimmed.starts_with(b"<html") {
        return Some("is a web page instead of the file; download the file itself");
    }
    if start.get(4..8) == Some(b"ftyp") {
        let brands = [&b"heic"[..], b"heix", b"hevc", b"mif1", b"msf1", b"avif", b"avis"];
        return Some(match start.get(8..12) {
            Some(brand) if brands.contains(&brand) => {
                "is a HEIC or AVIF picture, which Relume does not read; convert it to JPEG, e.g. with heif-convert"
            }
            _ => "is a video or another MP4 file instead of an image",
        });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pointers_web_pages_and_phone_pictures_are_recognised() {
        for (bytes, word) in [
            (&b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n"[..], "git lfs pull"),
            (b"\n <!DOCTYPE html><html></html>", "web page"),
            (b"<HTML>", "web page"),
            (b"\0\0\0\x18ftypheic\0\0\0\0", "HEIC"),
            (b"\0\0\0\x18ftypavif\0\0\0\0", "AVIF"),
            (b"\0\0\0\x18ftypisom\0\0\0\0", "video"),
        ] {
            assert!(recognise(bytes).is_some_and(|text| text.contains(word)), "{word}");
        }
        for other in [&b""[..], b"\x89PNG\r\n\x1a\n", b"ply\nformat ascii 1.0", b"{\"frames\": []}"] {
            assert_eq!(recognise(other), None);
        }
    }
}
