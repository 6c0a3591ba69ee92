//! Makes a video of frames with ffmpeg.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::server::exports::export_error::ExportError;

/// Interval of checks of the process.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// The path of a program: the path itself, or the first match of a name on PATH.
pub(super) fn find(program: &Path) -> Option<PathBuf> {
    if program.components().count() > 1 {
        return program.is_file().then(|| program.to_owned());
    }
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|folder| folder.join(program)).find(|file| file.is_file())
}

/// Makes an H.264 video of the frames `0001.EXTENSION` and following in `folder`. Equal frames give equal files with the same
/// version of ffmpeg. Blocks.
///
/// # Errors
/// When ffmpeg is missing or fails, or `is_wanted` returns false. The process is then terminated.
pub(super) fn encode(
    ffmpeg: &Path,
    folder: &Path,
    extension: &str,
    frames_per_second: u32,
    to: &Path,
    is_wanted: &dyn Fn() -> bool,
) -> Result<(), ExportError> {
    let ffmpeg = find(ffmpeg).ok_or_else(|| ExportError::failed("ffmpeg is no longer installed"))?;
    let log = folder.join("ffmpeg.log");
    let mut command = Command::new(ffmpeg);
    command.args([
        "-nostdin",
        "-hide_banner",
        "-loglevel",
        "error",
        "-y",
        "-f",
        "image2",
        "-start_number",
        "1",
    ]);
    command
        .args(["-framerate", &frames_per_second.to_string(), "-i"])
        .arg(folder.join(format!("%04d.{extension}")));
    // Two threads leave processors for frames and trainings, and give the same bytes on any machine.
    command.args(["-an", "-c:v", "libx264", "-threads", "2", "-preset", "medium", "-crf", "18"]);
    command.args(["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-map_metadata", "-1"]);
    command.args(["-fflags", "+bitexact", "-flags:v", "+bitexact", "-f", "mp4"]).arg(to);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(File::create(&log)?);
    let mut running = ChildGuard(command.spawn()?);
    let status = loop {
        match running.0.try_wait()? {
            Some(status) => break status,
            None if !is_wanted() => return Err(ExportError::Unwanted),
            None => std::thread::sleep(POLL_INTERVAL),
        }
    };
    if status.success() {
        return Ok(());
    }
    let said = std::fs::read_to_string(&log).unwrap_or_default();
    tracing::error!(%status, said = said.trim_end(), "ffmpeg failed");
    Err(ExportError::failed(format!("ffmpeg failed ({status}); its output is in the server's log")))
}

/// A process that is killed when this is dropped.
struct ChildGuard(Child);

impl Drop for ChildGuard {
    fn drop(&mut self) {
        // Both calls fail only if the process has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
