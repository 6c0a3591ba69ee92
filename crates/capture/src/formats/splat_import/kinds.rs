//! The kinds of splat files, recognised by their content.

use crate::formats::ply_table::{PlyError, PlyFile, PlyTable, bad};
use crate::formats::recognise_foreign;
use crate::formats::splat_import::{compressed_ply, splat_records, spz};

/// A file as the table of an ordinary PLY.
pub(super) struct SplatFile {
    /// The splats.
    pub table: PlyTable,
    /// Name of the format, for the model card.
    pub from: &'static str,
    /// Notes on values that the import omits or assumes.
    pub notes: Vec<String>,
}

/// Reads a file of any supported kind.
///
/// # Errors
/// Those of its reader. Other kinds of files are named, with the remedy.
pub(super) fn read(bytes: &[u8]) -> Result<SplatFile, PlyError> {
    if bytes.is_empty() {
        return bad("file", "is empty");
    }
    if bytes.starts_with(b"ply") {
        let file = PlyFile::parse(bytes)?;
        if compressed_ply::is_compressed(&file) {
            let table = compressed_ply::read(&file)?;
            return Ok(SplatFile { table, from: "compressed ply", notes: Vec::new() });
        }
        let table = file.table("vertex", usize::MAX)?;
        return Ok(SplatFile { table, from: "ply", notes: Vec::new() });
    }
    if spz::is_spz(bytes) {
        let (table, notes) = spz::read(bytes)?;
        return Ok(SplatFile { table, from: "spz", notes });
    }
    if splat_records::is_splat(bytes) {
        return Ok(SplatFile { table: splat_records::read(bytes), from: "splat", notes: Vec::new() });
    }
    match unsupported(bytes) {
        Some(what) => bad("file", what),
        None => {
            bad("file", "is none of the splat files that Relume reads: PLY, compressed PLY, SPZ and .splat")
        }
    }
}

/// A sentence with the kind and the remedy for files of other kinds.
fn unsupported(bytes: &[u8]) -> Option<&'static str> {
    if let Some(what) = recognise_foreign(bytes) {
        return Some(what);
    }
    let is_safetensors = bytes.get(8) == Some(&b'{') && bytes.get(5..8) == Some(&[0; 3]);
    // A header of 4096 bytes that begins with version 0.1.
    let is_ksplat = bytes.starts_with(&[0, 1]) && bytes.len() >= 4096;
    Some(match bytes {
        _ if bytes.starts_with(b"PK\x03\x04") => {
            "is a zip archive (.sog or .usdz of splats, or a capture); export splats as PLY; give a capture to `relume train`"
        }
        _ if bytes.starts_with(b"glTF") => "is a glTF file; export the splats as PLY",
        _ if bytes.starts_with(b"#usda") || bytes.starts_with(b"PXR-USDC") => {
            "is a USD file; export the splats as PLY"
        }
        _ if is_safetensors => "is a model of Relume already; it needs no import",
        _ if is_ksplat => "is a .ksplat file; export the splats as PLY",
        _ if bytes.starts_with(&[0x1f, 0x8b]) => "is compressed with gzip; unpack it first",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_other_kinds_are_named_with_a_remedy() {
        let safetensors = [&100u64.to_le_bytes()[..], b"{\"a\":1}"].concat();
        let ksplat = [&[0, 1][..], &[0; 5000]].concat();
        for (bytes, word) in [
            (&b""[..], "empty"),
            (b"PK\x03\x04 zip", ".sog"),
            (b"glTF\x02", "glTF"),
            (b"#usda 1.0", "USD"),
            (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
            (b"<html>", "web page"),
            (b"hello", "PLY, compressed PLY, SPZ and .splat"),
            (&safetensors, "needs no import"),
            (&ksplat, ".ksplat"),
        ] {
            let error = read(bytes).map(|_| ()).unwrap_err();
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
    }
}
