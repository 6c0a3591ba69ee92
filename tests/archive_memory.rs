//! Memory of a hostile archive: `relume capture check` refuses or reads it within a limit that its unpacked size exceeds.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::{Command, Output};

use crate::fuzz::mutated_archives;
use flate2::Compression;
use flate2::write::GzEncoder;
use relume_fixtures::small_set::{blender, gzip, tar};
use tempfile::TempDir;

/// Limit on the data of the process, KiB. The program alone needs a small part of it.
const LIMIT_KIB: u64 = 300_000;
/// Bytes of the hostile part of an archive; more than the limit.
const HOSTILE: u64 = 512 << 20;

/// Number of mutated archives.
const MUTATED: u64 = 150;

/// `relume capture check` with the memory limit.
fn check(archive: &Path) -> Output {
    check_within(LIMIT_KIB, archive)
}

fn check_within(limit_kib: u64, archive: &Path) -> Output {
    let script = format!("ulimit -d {limit_kib}; exec \"$0\" capture check \"$1\"");
    let mut shell = Command::new("sh");
    shell.args(["-c", &script, env!("CARGO_BIN_EXE_relume")]).arg(archive).output().unwrap()
}

fn header(kind: tar::EntryType, name: &str, size: u64) -> tar::Header {
    let mut header = tar::Header::new_gnu();
    header.set_entry_type(kind);
    header.set_path(name).unwrap();
    header.set_size(size);
    header.set_cksum();
    header
}

/// Writes a header, then `HOSTILE` bytes that compress well but not too well.
fn write_hostile(mut out: impl Write, kind: tar::EntryType) {
    out.write_all(header(kind, "large.bin", HOSTILE).as_bytes()).unwrap();
    let mut block = vec![b'a'; 1 << 20];
    let mut state = 1u32;
    for byte in &mut block[..16 << 10] {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *byte = (state >> 24) as u8;
    }
    (0..HOSTILE >> 20).for_each(|_| out.write_all(&block).unwrap());
}

#[test]
fn hostile_tar_headers_are_refused_within_the_memory_limit() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("capture.tar");
    for kind in [tar::EntryType::GNULongName, tar::EntryType::GNULongLink, tar::EntryType::XHeader] {
        let mut file = BufWriter::new(File::create(&path).unwrap());
        // The file is sparse: only its length matters.
        file.write_all(header(kind, "name", HOSTILE).as_bytes()).unwrap();
        file.into_inner().unwrap().set_len(512 + HOSTILE + 1024).unwrap();
        let output = check(&path);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{kind:?}: {said}");
        assert!(said.contains("shorter names") && said.len() < 1000, "{kind:?}: {said}");
    }
}

#[test]
fn a_large_gzipped_tar_is_read_within_the_memory_limit() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("capture.tar.gz");
    let mut out = GzEncoder::new(File::create(&path).unwrap(), Compression::fast());
    write_hostile(&mut out, tar::EntryType::Regular);
    out.write_all(&tar(&blender())).unwrap();
    out.finish().unwrap();
    let output = check(&path);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.starts_with("nerf-synthetic: 3 photographs"), "{said} {output:?}");

    std::fs::write(&path, gzip(&tar(&blender()))).unwrap();
    assert_eq!(check(&path).stdout, output.stdout, "the control: without the large file");
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["capture.tar.gz"], "nothing is left behind");
}

#[test]
fn mutated_archives_are_read_within_the_memory_limit() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("capture.zip");
    // Photographs of a few pixels need a small part of the limit.
    let limit = LIMIT_KIB / 3;
    let ended = |output: &Output| matches!(output.status.code(), Some(0 | 1));
    for (case, archive) in mutated_archives(MUTATED).into_iter().enumerate() {
        std::fs::write(&path, archive).unwrap();
        let output = check_within(limit, &path);
        assert!(ended(&output), "case {case}: {output:?}");
    }
    assert!(!ended(&check_within(4096, &path)), "the control: too little memory for any archive");
}
