//! Makes a video of frames with ffmpeg.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::server::exports::export_error::ExportError;

/// Interval of checks of the process.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// The filters from the sRGB values of the frames to Y'CbCr: matrix of BT.709, limited range, 4:2:0.
///
/// By default ffmpeg takes the matrix of BT.601 and writes no tags. Players then assume BT.709, and show red as (255, 24, 0).
///
/// The transfer function is tagged as BT.709, like primaries and matrix. Players show such a video without a change of its
/// values, which are sRGB like those of the frames. The tag of sRGB (iec61966-2-1) names the curve of the frames, but is unusual
/// in H.264, and not all players and editors know it.
const TO_BT709: &str = "scale=out_color_matrix=bt709:out_range=tv:flags=bicubic+accurate_rnd+full_chroma_int,format=yuv420p,\
     setparams=range=tv:color_primaries=bt709:color_trc=bt709:colorspace=bt709";
/// The same tags for the encoder, because older versions of ffmpeg do not take all of them from the filters.
const TAGS: [&str; 8] =
    ["-color_range", "tv", "-color_primaries", "bt709", "-color_trc", "bt709", "-colorspace", "bt709"];

/// The path of a program: the path itself, or the first match of a name on PATH.
pub(super) fn find(program: &Path) -> Option<PathBuf> {
    if program.components().count() > 1 {
        return program.is_file().then(|| program.to_owned());
    }
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|folder| folder.join(program)).find(|file| file.is_file())
}

/// Makes an H.264 video of the frames `0001.EXTENSION` and following in `folder`: BT.709, limited range, tagged. Equal frames give
/// equal files with the same version of ffmpeg. Blocks.
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
    command.args(["-vf", TO_BT709]).args(TAGS);
    command.args(["-movflags", "+faststart", "-map_metadata", "-1"]);
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

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use relume_capture::formats::image_file::{encode_jpeg, encode_png};
    use tempfile::TempDir;

    /// The colours of the chart, in rows of four.
    const CHART: [[u8; 3]; 12] = [
        [255, 0, 0],
        [0, 255, 0],
        [0, 0, 255],
        [255, 255, 0],
        [0, 255, 255],
        [255, 0, 255],
        [255, 255, 255],
        [0, 0, 0],
        [128, 128, 128],
        [200, 100, 50],
        [30, 60, 90],
        [244, 244, 244],
    ];
    /// Side of a colour of the chart, pixels.
    const PATCH: usize = 32;
    const WIDTH: usize = 4 * PATCH;
    const HEIGHT: usize = 3 * PATCH;

    /// Runs a program that must succeed.
    fn output(command: &mut Command) -> Vec<u8> {
        let output = command.output().unwrap();
        assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    }

    /// The colours in the middle of the patches of the first frame, decoded with a matrix and limited range.
    fn decoded(video: &Path, matrix: &str) -> Vec<[u8; 3]> {
        let filters = format!(
            "scale=in_color_matrix={matrix}:in_range=tv:flags=accurate_rnd+full_chroma_int,format=rgb24"
        );
        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg.args(["-v", "error", "-i"]).arg(video);
        ffmpeg.args(["-vf", &filters, "-frames:v", "1", "-f", "rawvideo", "-"]);
        let bytes = output(&mut ffmpeg);
        assert_eq!(bytes.len(), WIDTH * HEIGHT * 3);
        let middle = |i: usize| ((i / 4) * PATCH + PATCH / 2) * WIDTH + (i % 4) * PATCH + PATCH / 2;
        (0..CHART.len()).map(|i| bytes.as_chunks::<3>().0[middle(i)]).collect()
    }

    /// The largest difference of a channel from the chart, of 255.
    fn error(shown: &[[u8; 3]]) -> u8 {
        let pairs = shown.as_flattened().iter().zip(CHART.as_flattened());
        pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap()
    }

    #[test]
    #[ignore = "needs ffmpeg with libx264, and ffprobe"]
    fn a_video_is_tagged_as_bt709_and_shows_the_right_colours() {
        let pixels: Vec<[u8; 3]> =
            (0..WIDTH * HEIGHT).map(|i| CHART[i / WIDTH / PATCH * 4 + i % WIDTH / PATCH]).collect();
        let (width, height) = (WIDTH as u32, HEIGHT as u32);
        let png = encode_png(width, height, &pixels).unwrap();
        let jpeg = encode_jpeg(width, height, &pixels, 90).unwrap();
        for (extension, frame) in [("png", png), ("jpg", jpeg)] {
            let folder = TempDir::new().unwrap();
            let (still, video) =
                (folder.path().join(format!("0001.{extension}")), folder.path().join("a.mp4"));
            fs::write(&still, frame).unwrap();
            encode(Path::new("ffmpeg"), folder.path(), extension, 24, &video, &|| true).unwrap();
            let entries = "stream=pix_fmt,color_range,color_space,color_transfer,color_primaries";
            let mut ffprobe = Command::new("ffprobe");
            ffprobe.args(["-v", "error", "-show_entries", entries, "-of", "csv=p=0"]).arg(&video);
            let tags = String::from_utf8(output(&mut ffprobe)).unwrap();
            assert_eq!(tags.trim(), "yuv420p,tv,bt709,bt709,bt709", "{extension}");
            let shown = decoded(&video, "bt709");
            assert!(error(&shown) <= 3, "{extension}: {shown:?}");
            assert!(error(&decoded(&video, "bt601")) > 15, "the control: another matrix");

            let untagged = folder.path().join("untagged.mp4");
            let mut plain = Command::new("ffmpeg");
            plain.args(["-v", "error", "-i"]).arg(&still).args(["-c:v", "libx264", "-pix_fmt", "yuv420p"]);
            output(plain.arg(&untagged));
            let red = decoded(&untagged, "bt709")[0];
            assert!(red[1] > 15, "the control: the default of ffmpeg shows red as {red:?}");
        }
    }
}
