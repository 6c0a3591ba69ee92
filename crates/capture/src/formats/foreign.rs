//! Recognises files of other kinds that stand in the place of an image or a model.

use super::heif;

/// Recognises a Git LFS pointer, a web page and an MP4 file by the first bytes. Returns a sentence with the kind and the
/// remedy, or `None` for all other files.
pub fn recognise(bytes: &[u8]) -> Option<&'static str> {
    let start = bytes.get(..64).unwrap_or(bytes);
    let trimmed = start.trim_ascii_start().to_ascii_lowercase();
    if start.starts_with(b"version https://git-lfs") {
        return Some("is a Git LFS pointer instead of the file; run `git lfs pull`");
    }
    if trimmed.starts_with(b"<!doctype html") || trimmed.starts_with(b"<html") {
        return Some("is a web page instead of the file; download the file itself");
    }
    let is_mp4 = start.get(4..8) == Some(b"ftyp") && start.get(8..12) != Some(b"crx ");
    (is_mp4 && !heif::is_heif(bytes)).then_some("is a video or another MP4 file instead of an image")
}

/// Recognises images of kinds that Relume does not read, by the first bytes, as [`recognise`] does.
pub(super) fn recognise_image(bytes: &[u8]) -> Option<&'static str> {
    const KINDS: [(&[u8], &str); 7] = [
        (b"GIF8", "is a GIF image; convert it to PNG or JPEG"),
        (b"\0\0\0\x0cjP  \r\n\x87\n", "is a JPEG 2000 image; convert it to PNG or JPEG"),
        (b"\xff\x4f\xff\x51", "is a JPEG 2000 image; convert it to PNG or JPEG"),
        (b"\0\0\0\x0cJXL \r\n\x87\n", "is a JPEG XL image; convert it to PNG or JPEG"),
        (b"\xff\x0a", "is a JPEG XL image; convert it to PNG or JPEG"),
        (b"8BPS", "is a Photoshop file; save it as PNG or JPEG"),
        (b"#?RADIANCE", "is a Radiance HDR image; convert it to EXR"),
    ];
    let is_bmp = bytes.starts_with(b"BM") && bytes.get(6..10) == Some(&[0; 4]);
    let known = KINDS.iter().find(|(start, _)| bytes.starts_with(start)).map(|(_, text)| *text);
    known.or(is_bmp.then_some("is a BMP image; convert it to PNG or JPEG"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pointers_web_pages_and_clips_are_recognised() {
        for (bytes, word) in [
            (&b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n"[..], "git lfs pull"),
            (b"\n <!DOCTYPE html><html></html>", "web page"),
            (b"<HTML>", "web page"),
            (b"\0\0\0\x10ftypisom\0\0\0\0", "video"),
        ] {
            assert!(recognise(bytes).is_some_and(|text| text.contains(word)), "{word}");
        }
        let heic = b"\0\0\0\x10ftypheic\0\0\0\0";
        for other in [&b""[..], b"\x89PNG\r\n\x1a\n", b"ply\nformat ascii 1.0", b"{\"frames\": []}", heic] {
            assert_eq!(recognise(other), None);
        }
    }

    #[test]
    fn images_of_unsupported_kinds_are_named() {
        for (bytes, word) in [
            (&b"GIF89a\x08\0"[..], "GIF"),
            (b"BM6Q\0\0\0\0\0\0", "BMP"),
            (b"\0\0\0\x0cjP  \r\n\x87\n\0\0", "JPEG 2000"),
        ] {
            assert!(recognise_image(bytes).is_some_and(|text| text.contains(word)), "{word}");
        }
        for other in [&b"\xff\xd8\xff\xe0"[..], b"\x89PNG\r\n\x1a\n", b"BMW is no image", b""] {
            assert_eq!(recognise_image(other), None);
        }
    }
}
