//! Archives: all kinds give the same capture; attacks and damaged files are refused.

use std::io::{Cursor, Write};

use proptest::prelude::*;

use relume_capture::{CaptureError, ImportLimits, ImportOptions, import};
use relume_fixtures::cases_or;
use relume_fixtures::small_set::{
    Files, blender, colmap, gzip, import_bytes, import_folder, nerfstudio, tar, zip,
};

fn refusal(bytes: &[u8]) -> CaptureError {
    import_bytes(bytes).unwrap_err()
}

/// Imports with limits changed by `edit`.
fn limited(bytes: &[u8], edit: impl FnOnce(&mut ImportLimits)) -> CaptureError {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let mut options = ImportOptions::default();
    edit(&mut options.limits);
    import(file.path(), &options).unwrap_err()
}

/// Replaces every occurrence of a name by another of the same length, in a stored archive's bytes.
fn renamed(mut bytes: Vec<u8>, from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let places: Vec<usize> = bytes
        .windows(from.len())
        .enumerate()
        .filter(|(_, w)| *w == from.as_bytes())
        .map(|(i, _)| i)
        .collect();
    assert!(!places.is_empty());
    places.into_iter().for_each(|i| bytes[i..i + to.len()].copy_from_slice(to.as_bytes()));
    bytes
}

fn with(name: &str) -> Files {
    let mut files = blender();
    files.insert(name.to_owned(), b"x".to_vec());
    files
}

#[test]
fn folder_zip_tar_and_gzipped_tar_give_equal_captures() {
    let files = blender();
    let folder = import_folder(&files).unwrap();
    for bytes in [zip(&files), tar(&files), gzip(&tar(&files))] {
        assert_eq!(import_bytes(&bytes).unwrap(), folder);
    }
}

#[test]
fn truncated_archives_are_refused() {
    let files = blender();
    for whole in [zip(&files), gzip(&tar(&files))] {
        for cut in (0..whole.len()).step_by(7).chain([whole.len() - 1]) {
            assert!(refusal(&whole[..cut]).is_users_fault(), "cut at {cut} of {}", whole.len());
        }
    }
    // A tar ends in 1 KiB of zeros. A cut that removes all of them is detected.
    let whole = tar(&files);
    for cut in (0..whole.len() - 1024).step_by(100) {
        assert_eq!(refusal(&whole[..cut]).code(), "capture_archive_damaged", "cut at {cut}");
    }
}

#[test]
fn archive_bombs_are_refused_by_ratio_size_and_count() {
    let mut files = blender();
    files.insert("bomb.bin".into(), vec![0; 8 << 20]);
    for bytes in [zip(&files), gzip(&tar(&files))] {
        let error = refusal(&bytes);
        assert_eq!((error.code(), error.field()), ("capture_over_limit", Some("max_ratio")), "{error}");
    }
    for bytes in [zip(&blender()), tar(&blender())] {
        assert_eq!(limited(&bytes, |l| l.max_entries = 3).field(), Some("max_entries"));
        assert_eq!(limited(&bytes, |l| l.max_entry_bytes = 50).field(), Some("max_entry_bytes"));
        assert_eq!(limited(&bytes, |l| l.max_total_bytes = 500).field(), Some("max_total_bytes"));
    }
    assert_eq!(limited(&gzip(&tar(&blender())), |l| l.max_gzip_bytes = 5000).field(), Some("max_gzip_bytes"));
    assert_eq!(limited(&zip(&blender()), |l| l.max_total_pixels = 100).field(), Some("max_total_pixels"));
    assert_eq!(limited(&zip(&blender()), |l| l.max_images = 2).field(), Some("max_images"));
}

#[test]
fn wrong_entry_size_is_detected_while_reading() {
    let bytes = zip(&blender());
    // The uncompressed size of each central entry lies 24 bytes behind its signature.
    let at = bytes.windows(4).position(|w| w == b"PK\x01\x02").unwrap() + 24;
    let mut lying = bytes.clone();
    lying[at] = lying[at].wrapping_sub(9);
    assert_eq!(refusal(&lying).code(), "capture_archive_damaged");
}

#[test]
fn escaping_paths_are_refused() {
    for (honest, evil) in [
        ("aa/x.png", "../x.png"),
        ("b/cc/x.png", "b/../x.png"),
        ("a/x.png", "//x.png"),
        ("cc/x.png", "C:/x.png"),
        ("ab/x.png", "..\\x.png"),
    ] {
        let error = refusal(&renamed(zip(&with(honest)), honest, evil));
        assert_eq!((error.code(), error.file()), ("capture_archive_unsafe", Some(evil)), "{error}");
    }
    let mut builder = tar::Builder::new(Vec::new());
    let mut header = tar::Header::new_gnu();
    header.as_old_mut().name[..9].copy_from_slice(b"../../etc");
    header.set_size(1);
    header.set_cksum();
    builder.append(&header, &b"x"[..]).unwrap();
    assert_eq!(refusal(&builder.into_inner().unwrap()).code(), "capture_archive_unsafe");
}

#[test]
fn duplicate_entries_are_refused() {
    let twice = renamed(zip(&with("train/r_9.png")), "train/r_9.png", "train/r_1.png");
    assert_eq!(refusal(&twice).code(), "capture_archive_unsafe");
    let twice: Vec<u8> = {
        let mut builder = tar::Builder::new(Vec::new());
        for name in ["a.txt", "./a.txt"] {
            let mut header = tar::Header::new_gnu();
            header.set_size(1);
            builder.append_data(&mut header, name, &b"x"[..]).unwrap();
        }
        builder.into_inner().unwrap()
    };
    assert_eq!((refusal(&twice).code(), refusal(&twice).file()), ("capture_archive_unsafe", Some("a.txt")));
}

#[test]
fn links_devices_and_encrypted_entries_are_refused() {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    writer.add_symlink("link", "/etc/passwd", zip::write::SimpleFileOptions::default()).unwrap();
    let error = refusal(&writer.finish().unwrap().into_inner());
    assert_eq!((error.code(), error.file()), ("capture_archive_unsafe", Some("link")));
    for kind in [tar::EntryType::Symlink, tar::EntryType::Link, tar::EntryType::Char, tar::EntryType::Fifo] {
        let mut builder = tar::Builder::new(Vec::new());
        let mut header = tar::Header::new_gnu();
        header.set_entry_type(kind);
        header.set_size(0);
        header.set_path("link").unwrap();
        header.set_link_name("/etc/passwd").unwrap();
        header.set_cksum();
        builder.append(&header, &b""[..]).unwrap();
        let error = refusal(&builder.into_inner().unwrap());
        assert_eq!((error.code(), error.file()), ("capture_archive_unsafe", Some("link")), "{kind:?}");
    }
    let mut locked = zip(&blender());
    let central = locked.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
    locked[central + 8] |= 1;
    locked[6] |= 1;
    assert_eq!(refusal(&locked).code(), "capture_archive_unsafe");
}

#[test]
fn refused_archive_leaves_no_files_on_disk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("evil.zip");
    std::fs::write(&path, renamed(zip(&with("aa/x.png")), "aa/x.png", "../x.png")).unwrap();
    import(&path, &ImportOptions::default()).unwrap_err();
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, ["evil.zip"]);
    assert!(!folder.path().parent().unwrap().join("x.png").exists());
}

#[test]
fn files_that_are_no_capture_archive_give_clear_errors() {
    assert_eq!(refusal(b"").code(), "capture_archive_damaged");
    assert_eq!(refusal(b"just some text").code(), "capture_archive_damaged");
    assert_eq!(refusal(&[0; 4096]).code(), "capture_layout_unknown");
    let noise: Vec<u8> = (0..2048u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let said = refusal(&noise).to_string();
    assert!(
        said.contains("not a readable zip") && said.chars().all(|c| (' '..='~').contains(&c)),
        "{said:?}"
    );
    let files = Files::from([("holiday.jpg".to_owned(), vec![1])]);
    let error = refusal(&zip(&files));
    assert_eq!(error.code(), "capture_layout_unknown");
    assert!(error.to_string().contains("holiday.jpg"), "{error}");
    let nowhere = import(std::path::Path::new("/no/such/capture.zip"), &ImportOptions::default());
    assert_eq!(nowhere.unwrap_err().code(), "capture_io");
}

fn flipped(mut bytes: Vec<u8>, flips: &[(usize, u8)]) -> Vec<u8> {
    for &(at, with) in flips {
        let at = at % bytes.len();
        bytes[at] ^= with;
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases_or(300), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn importer_does_not_panic_on_flipped_bytes(
        which in 0usize..4,
        flips in prop::collection::vec((any::<usize>(), 1u8..), 1..6),
    ) {
        let bytes = match which {
            0 => zip(&blender()),
            1 => tar(&nerfstudio(|set| set["k1"] = serde_json::json!(0.1))),
            2 => tar(&colmap()),
            _ => gzip(&tar(&blender())),
        };
        let _ = import_bytes(&flipped(bytes, &flips));
    }

    #[test]
    fn importer_refuses_random_bytes_after_a_magic_number(
        magic in prop::sample::select(vec![&b"PK\x03\x04"[..], b"\x1f\x8b\x08\x00", b"ustar"]),
        garbage in prop::collection::vec(any::<u8>(), 0..2000),
    ) {
        let mut bytes = magic.to_vec();
        bytes.write_all(&garbage).unwrap();
        prop_assert!(import_bytes(&bytes).is_err());
    }
}

/// A tar whose first header has this type and content, before a complete capture.
fn with_extension(kind: tar::EntryType, content: &[u8]) -> Vec<u8> {
    let mut builder = tar::Builder::new(Vec::new());
    let mut header = tar::Header::new_gnu();
    header.set_entry_type(kind);
    header.set_path("extension").unwrap();
    header.set_size(content.len() as u64);
    header.set_cksum();
    builder.append(&header, content).unwrap();
    let mut bytes = builder.into_inner().unwrap();
    bytes.truncate(bytes.len() - 1024);
    [bytes, tar(&blender())].concat()
}

#[test]
fn long_names_and_headers_are_refused_before_they_are_read() {
    use tar::EntryType::{GNULongLink, GNULongName, XHeader};
    for kind in [GNULongName, GNULongLink, XHeader] {
        let error = refusal(&with_extension(kind, &vec![b'a'; 2 << 20]));
        let said = error.to_string();
        assert_eq!(error.code(), "capture_archive_unsafe", "{kind:?}: {said}");
        assert!(said.contains("shorter names") && said.len() < 1000, "{kind:?}: {} bytes", said.len());
    }
    let renamed = import_bytes(&with_extension(GNULongName, b"notes.txt\0")).unwrap().warnings;
    assert!(renamed.iter().any(|w| w.contains("r_0")), "the control: a short name is used: {renamed:?}");
    let long = refusal(&zip(&with(&"x".repeat(5000))));
    assert_eq!(long.code(), "capture_archive_unsafe");
    assert!(long.to_string().len() < 1000, "{long}");
    let names: Files = (0..400).map(|i| (format!("{i:03}{}", "y".repeat(700)), vec![1])).collect();
    for bytes in [zip(&names), tar(&names)] {
        assert_eq!(limited(&bytes, |l| l.max_header_bytes = 100_000).field(), Some("max_header_bytes"));
        assert_eq!(refusal(&bytes).code(), "capture_layout_unknown", "the control");
    }
}

#[test]
fn pax_names_are_read_and_contradicting_sizes_are_refused() {
    let record = |key: &str, value: &str| {
        let rest = format!(" {key}={value}\n");
        let length = (rest.len()..).find(|n| n.to_string().len() + rest.len() == *n).unwrap();
        format!("{length}{rest}").into_bytes()
    };
    let pax = |key: &str, value: &str| with_extension(tar::EntryType::XHeader, &record(key, value));
    let renamed = import_bytes(&pax("path", "elsewhere/notes.txt")).unwrap().warnings;
    assert!(renamed.iter().any(|w| w.contains("r_0")), "the first photograph has another name: {renamed:?}");
    let first = blender().into_values().next().unwrap().len().to_string();
    import_bytes(&pax("size", &first)).unwrap();
    assert_eq!(refusal(&pax("size", "7")).code(), "capture_archive_unsafe");
    let escape = refusal(&pax("path", "../x.png"));
    assert_eq!((escape.code(), escape.file()), ("capture_archive_unsafe", Some("../x.png")));
}

#[test]
fn a_gzipped_tar_is_unpacked_without_a_name_on_disk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture.tar.gz");
    std::fs::write(&path, gzip(&tar(&blender()))).unwrap();
    let open = relume_capture::CaptureFiles::open(&path, &ImportLimits::default()).unwrap();
    assert_eq!(open.read("train/r_1.png").unwrap(), blender()["train/r_1.png"]);
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, ["capture.tar.gz"]);
}

#[test]
fn names_in_pose_files_have_no_control_characters() {
    for name in ["images/a\0b.png", "images/a\nb.png", &"z".repeat(2000)] {
        let error =
            import_folder(&nerfstudio(|set| set["frames"][2]["file_path"] = name.into())).unwrap_err();
        assert_eq!(error.field(), Some("frames[2].file_path"), "{error}");
        assert!(!error.to_string().contains('\0') && error.to_string().len() < 1000, "{error}");
    }
    let strange = import_folder(&nerfstudio(|set| set["w"] = "a\0b".into())).unwrap_err();
    assert!(!strange.to_string().contains('\0'), "{strange}");
}
