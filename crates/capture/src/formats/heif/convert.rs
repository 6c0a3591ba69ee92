//! Converts HEIC and AVIF pictures with an installed program of libheif. Files are untrusted, so the program runs with limits
//! on time, memory and output, and few programs run at once.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::boxes;
use crate::formats::{ImageFileError, image_file};
use crate::process_limits::ProcessLimits;

/// Programs that convert HEIC and AVIF, in the order of preference. Both are parts of libheif.
const PROGRAMS: [&str; 2] = ["heif-convert", "heif-dec"];
/// How to install a converter.
pub const CONVERTER_PACKAGE: &str = "apt-get install libheif-examples, or brew install libheif";
/// Time limit of a conversion.
const TIME: Duration = Duration::from_secs(60);
/// Greatest number of conversions at once in this process.
const MAX_CONVERSIONS: usize = 2;
/// Interval at which the running program is checked.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Limit on the program's memory: a constant, and bytes per pixel of the picture.
const MEMORY: (u64, u64) = (1 << 30, 32);
/// Greatest number of files in the folder of a conversion: the input, the messages and the pictures.
const MAX_FILES: usize = 8;
/// Limit on all written files together, which is also the limit on each: a constant, and bytes per pixel: four channels of 16 bits.
const OUTPUT: (u64, u64) = (4 << 20, 8);
/// Bytes of the program's messages that an error shows.
const MAX_MESSAGE: u64 = 400;
/// Quality of JPEG files, 1 to 100.
const JPEG_QUALITY: &str = "97";

/// The installed converter: its path.
pub fn installed_converter() -> Option<PathBuf> {
    find_converter(&std::env::var_os("PATH")?)
}

/// The first converter in the folders of a search path. Relative folders are skipped.
fn find_converter(search_path: &OsStr) -> Option<PathBuf> {
    let folders: Vec<PathBuf> =
        std::env::split_paths(search_path).filter(|folder| folder.is_absolute()).collect();
    let file = |program: &str| {
        let name = format!("{program}{}", std::env::consts::EXE_SUFFIX);
        folders.iter().map(|folder| folder.join(&name)).find(|path| path.is_file())
    };
    PROGRAMS.iter().find_map(|program| file(program))
}

/// The picture as a PNG, upright. Its colour space is that of the header.
///
/// # Errors
/// [`ImageFileError::NoConverter`] without a converter; [`ImageFileError::Damaged`] if the conversion fails or gives
/// another size than the header states.
pub(in crate::formats) fn to_png(bytes: &[u8]) -> Result<Vec<u8>, ImageFileError> {
    convert(bytes, "png", installed_converter())
}

/// The picture as a JPEG with the camera data and the colour profile of the file, upright.
///
/// # Errors
/// As [`to_png`].
pub(in crate::formats) fn to_jpeg(bytes: &[u8]) -> Result<Vec<u8>, ImageFileError> {
    convert(bytes, "jpg", installed_converter())
}

fn convert(bytes: &[u8], ending: &str, converter: Option<PathBuf>) -> Result<Vec<u8>, ImageFileError> {
    let kind = boxes::kind_name(bytes);
    let converter = converter.ok_or(ImageFileError::NoConverter { kind, install: CONVERTER_PACKAGE })?;
    let size = boxes::header(bytes)?.size;
    let name = converter.file_name().unwrap_or_default().display();
    let failed = |error: std::io::Error| ImageFileError::Damaged(format!("{name}: {error}"));
    let _permit = CONVERSIONS.acquire();
    // The folder and its files are removed when this function returns.
    let folder = tempfile::TempDir::new().map_err(failed)?;
    let input = folder.path().join(if kind == "AVIF" { "in.avif" } else { "in.heic" });
    fs::write(&input, bytes).map_err(failed)?;
    let output = folder.path().join(format!("out.{ending}"));
    let messages = folder.path().join("messages");
    let child = Command::new(&converter)
        .args(["-q", JPEG_QUALITY])
        .args([&input, &output])
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(File::create(&messages).map_err(failed)?)
        .spawn()
        .map_err(failed)?;
    let is_success = RunningConverter { child, folder: folder.path(), input_bytes: bytes.len() as u64 }
        .wait(&limits(size), TIME)
        .map_err(failed)?;
    let text = message(&messages);
    if !is_success {
        return Err(ImageFileError::Damaged(format!("{name} failed: {text}")));
    }
    picture_of_size(folder.path(), ending, size).map_err(failed)?.ok_or_else(|| {
        let (width, height) = size;
        ImageFileError::Damaged(format!(
            "{name} wrote no picture of {width}x{height} pixels, which the header states: {text}"
        ))
    })
}

fn limits((width, height): (u32, u32)) -> ProcessLimits {
    let pixels = u64::from(width) * u64::from(height);
    let limit =
        |(constant, per_pixel): (u64, u64)| Some(pixels.saturating_mul(per_pixel).saturating_add(constant));
    ProcessLimits { memory: limit(MEMORY), file_bytes: limit(OUTPUT), ..ProcessLimits::default() }
}

/// The written picture of a size. A converter numbers its outputs if the file contains several pictures.
fn picture_of_size(folder: &Path, ending: &str, size: (u32, u32)) -> std::io::Result<Option<Vec<u8>>> {
    let mut names: Vec<OsString> = Vec::new();
    for entry in fs::read_dir(folder)? {
        names.push(entry?.file_name());
    }
    names.sort();
    let is_output = |name: &&OsString| {
        let name = name.to_string_lossy();
        name.starts_with("out") && name.ends_with(ending)
    };
    for name in names.iter().filter(is_output) {
        let bytes = fs::read(folder.join(name))?;
        if image_file::dimensions(&bytes).is_ok_and(|found| found == size) {
            return Ok(Some(bytes));
        }
    }
    Ok(None)
}

/// The end of the program's messages.
fn message(file: &Path) -> String {
    let mut text = Vec::new();
    // Without messages the error states only the program.
    if let Ok(file) = File::open(file) {
        let _ = file.take(MAX_MESSAGE).read_to_end(&mut text);
    }
    let text = String::from_utf8_lossy(&text).split_whitespace().collect::<Vec<_>>().join(" ");
    if text.is_empty() { "it wrote no message".to_owned() } else { text }
}

/// The conversions of this process.
static CONVERSIONS: Permits = Permits { free: Mutex::new(MAX_CONVERSIONS), freed: Condvar::new() };

/// A number of permits; who finds none waits.
struct Permits {
    free: Mutex<usize>,
    freed: Condvar,
}

/// A permit, returned on drop.
struct Permit<'a>(&'a Permits);

impl Permits {
    fn acquire(&self) -> Permit<'_> {
        let mut free = self.locked();
        while *free == 0 {
            free = self.freed.wait(free).unwrap_or_else(PoisonError::into_inner);
        }
        *free -= 1;
        Permit(self)
    }

    fn locked(&self) -> MutexGuard<'_, usize> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Permit<'_> {
    fn drop(&mut self) {
        *self.0.locked() += 1;
        self.0.freed.notify_one();
    }
}

/// A running converter, killed on drop.
struct RunningConverter<'a> {
    child: Child,
    /// Its working directory, with the input and everything that it writes.
    folder: &'a Path,
    /// Size of the input, bytes.
    input_bytes: u64,
}

impl RunningConverter<'_> {
    /// Waits for the end. Returns whether the program succeeded.
    fn wait(mut self, limits: &ProcessLimits, time: Duration) -> std::io::Result<bool> {
        limits.apply_to(&self.child)?;
        let start = Instant::now();
        loop {
            let status = self.child.try_wait()?;
            // Also after the end: a fast program may write everything between two checks.
            self.check_output(limits)?;
            if let Some(status) = status {
                return Ok(status.success());
            }
            if start.elapsed() >= time {
                let text = format!("the conversion took more than {} seconds", time.as_secs());
                return Err(std::io::Error::new(std::io::ErrorKind::TimedOut, text));
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }

    /// An error if the program has written too many files or too many bytes.
    fn check_output(&self, limits: &ProcessLimits) -> std::io::Result<()> {
        let (mut files, mut bytes) = (0, 0u64);
        for entry in fs::read_dir(self.folder)? {
            files += 1;
            // A file may be removed meanwhile.
            bytes = bytes.saturating_add(entry?.metadata().map_or(0, |file| file.len()));
            if files > MAX_FILES {
                return Err(std::io::Error::other(format!(
                    "the conversion wrote more than {MAX_FILES} files"
                )));
            }
        }
        let written = bytes.saturating_sub(self.input_bytes);
        match limits.file_bytes {
            Some(limit) if written > limit => {
                Err(std::io::Error::other(format!("the conversion wrote more than {limit} bytes")))
            }
            _ => Ok(()),
        }
    }
}

impl Drop for RunningConverter<'_> {
    fn drop(&mut self) {
        // Both calls fail only if the program has already exited.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::os::unix::fs::PermissionsExt;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::super::boxes::tests::heic;
    use super::*;

    /// A stand-in for a converter: a shell script, whose arguments are `-q QUALITY INPUT OUTPUT`.
    fn script(folder: &Path, text: &str) -> PathBuf {
        let path = folder.join("heif-convert");
        fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    fn converted(text: &str) -> Result<Vec<u8>, ImageFileError> {
        let folder = tempfile::TempDir::new().unwrap();
        let png = image_file::encode_png(4, 3, &[[7u8; 3]; 12]).unwrap();
        let small = image_file::encode_png(2, 1, &[[7u8; 3]; 2]).unwrap();
        fs::write(folder.path().join("4x3.png"), png).unwrap();
        fs::write(folder.path().join("2x1.png"), small).unwrap();
        let text = text.replace("FOLDER", folder.path().to_str().unwrap());
        convert(&heic((4, 3), &[]), "png", Some(script(folder.path(), &text)))
    }

    #[test]
    fn converter_output_of_the_stated_size_is_used() {
        let whole = image_file::encode_png(4, 3, &[[7u8; 3]; 12]).unwrap();
        assert_eq!(converted("cp FOLDER/4x3.png $4").unwrap(), whole);
        let several = "cp FOLDER/2x1.png out-1.png; cp FOLDER/4x3.png out-2.png";
        assert_eq!(converted(several).unwrap(), whole, "the main picture is the second");
        let text = converted("cp FOLDER/2x1.png $4").unwrap_err().to_string();
        assert!(text.contains("4x3"), "the control: {text}");
    }

    #[test]
    fn failures_of_the_converter_are_errors_with_its_message() {
        let text = converted("echo bad data >&2; exit 1").unwrap_err().to_string();
        assert!(text.contains("heif-convert") && text.contains("bad data"), "{text}");
        assert!(matches!(converted("true").unwrap_err(), ImageFileError::Damaged(_)), "no output");
        let text = convert(&heic((4, 3), &[]), "png", None).unwrap_err().to_string();
        assert!(
            text.contains("HEIC") && text.contains("libheif-examples") && text.contains("JPEG"),
            "{text}"
        );
    }

    /// Whether a process exists.
    fn is_running(pid: &str) -> bool {
        let test = Command::new("sh").args(["-c", &format!("kill -0 {pid}")]).stderr(Stdio::null()).status();
        test.unwrap().success()
    }

    #[test]
    fn converter_is_killed_at_its_time_limit() {
        let folder = tempfile::TempDir::new().unwrap();
        let running = |child| RunningConverter { child, folder: folder.path(), input_bytes: 0 };
        let child = Command::new("sleep").arg("300").spawn().unwrap();
        let pid = child.id().to_string();
        assert!(is_running(&pid), "the control");
        let error = running(child).wait(&ProcessLimits::default(), Duration::ZERO).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::TimedOut);
        assert!(!is_running(&pid), "{pid} is still running");
        let child = Command::new("true").spawn().unwrap();
        let limits = limits((4000, 3000));
        assert!(running(child).wait(&limits, TIME).unwrap(), "the control");
        assert_eq!(limits.file_bytes, Some((4 << 20) + 96_000_000));
    }

    #[test]
    fn converter_that_writes_too_much_is_killed() {
        let bytes = "for i in 1 2 3 4; do head -c 2000000 /dev/zero > big$i; done";
        let files = "for i in 1 2 3 4 5 6 7 8 9; do : > file$i; done";
        for (text, reason) in [(bytes, "more than 4194400 bytes"), (files, "more than 8 files")] {
            let folder = tempfile::TempDir::new().unwrap();
            let pid = folder.path().join("pid");
            let text = format!("echo $$ > {}; {text}; exec sleep 300", pid.display());
            let converter = script(folder.path(), &text);
            let error = convert(&heic((4, 3), &[]), "png", Some(converter)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
            let pid = fs::read_to_string(pid).unwrap();
            assert!(!is_running(pid.trim()), "{pid} is still running");
        }
        let ended = converted(&format!("{files}; cp FOLDER/4x3.png $4")).unwrap_err().to_string();
        assert!(ended.contains("more than 8 files"), "a program that has already exited: {ended}");
        let few = "for i in 1 2 3 4; do head -c 20000 /dev/zero > big$i; done; cp FOLDER/4x3.png $4";
        assert!(converted(few).is_ok(), "the control");
    }

    #[test]
    fn at_most_two_conversions_run_at_once() {
        let permits = Permits { free: Mutex::new(MAX_CONVERSIONS), freed: Condvar::new() };
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..50 {
                        let _permit = permits.acquire();
                        let now = running.fetch_add(1, Ordering::SeqCst) + 1;
                        most.fetch_max(now, Ordering::SeqCst);
                        std::thread::yield_now();
                        running.fetch_sub(1, Ordering::SeqCst);
                    }
                });
            }
        });
        assert!((1..=2).contains(&most.load(Ordering::SeqCst)), "{most:?}");
        assert_eq!(*permits.locked(), 2, "every permit was returned");
    }

    #[test]
    fn converter_is_found_in_absolute_folders_of_the_search_path() {
        let (folder, empty) = (tempfile::TempDir::new().unwrap(), tempfile::TempDir::new().unwrap());
        let path = script(folder.path(), "true");
        let search = std::env::join_paths([Path::new("."), empty.path(), folder.path()]).unwrap();
        assert_eq!(find_converter(&search), Some(path));
        assert_eq!(find_converter(empty.path().as_os_str()), None);
    }
}
