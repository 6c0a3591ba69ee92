//! Extracts the sharpest frame of each interval of a clip with ffmpeg.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::error::PoseError;
use super::process::ExternalProgram;
use super::run_control::{PoseProgress, PoseStage, RunControl};
use crate::formats::image_file;
use crate::process_limits::ProcessLimits;
use crate::{CaptureError, sharpness};

const INSTALL: &str = "apt-get install ffmpeg, brew install ffmpeg, or https://ffmpeg.org/download.html";
/// The oldest supported release. Builds that state no release are assumed to be newer.
const MIN_VERSION: u32 = 4;
/// Number of frames of an interval that are compared.
const CANDIDATES: usize = 5;
/// Greatest number of kept frames per second; frames closer together show the same image.
const MAX_FRAMES_PER_SECOND: f64 = 5.0;
/// File extensions of clips.
const ENDINGS: [&str; 7] = ["mp4", "mov", "m4v", "mkv", "webm", "avi", "mts"];

/// Options of [`frames_of_clip`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClipOptions {
    /// ffmpeg: a name to find on PATH, or a path.
    pub ffmpeg: PathBuf,
    /// ffprobe, which reports the duration of a clip: a name to find on PATH, or a path.
    pub ffprobe: PathBuf,
    /// Number of frames to keep, at least 3. Short clips give fewer.
    pub frames: usize,
}

impl Default for ClipOptions {
    fn default() -> Self {
        Self { ffmpeg: "ffmpeg".into(), ffprobe: "ffprobe".into(), frames: 80 }
    }
}

/// True for a file with the extension of a clip.
pub fn is_clip(path: &Path) -> bool {
    let ending = path.extension().and_then(OsStr::to_str).unwrap_or_default().to_ascii_lowercase();
    ENDINGS.contains(&ending.as_str()) && path.is_file()
}

/// Writes the sharpest frame of each interval of `clip`, upright, as `0001.jpg` and so on into the folder `into`,
/// which must not exist. Returns the number of frames. The folder appears when it is complete; it includes ffmpeg's
/// output as `ffmpeg.log`.
///
/// # Errors
/// [`PoseError`]. Partial results and the log remain in a folder named `into` plus `.part`, which the next call
/// replaces.
pub fn frames_of_clip(
    clip: &Path,
    into: &Path,
    options: &ClipOptions,
    run_control: &mut RunControl<'_>,
) -> Result<usize, PoseError> {
    let clip = clip.canonicalize().map_err(PoseError::io(clip))?;
    let mut part = into.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    if part.is_dir() {
        fs::remove_dir_all(&part).map_err(PoseError::io(&part))?;
    }
    fs::create_dir_all(&part).map_err(PoseError::io(&part))?;
    let part = part.canonicalize().map_err(PoseError::io(&part))?;
    let seconds = duration(&clip, &part, options, run_control)?;
    let frames = options.frames.max(3).min((seconds * MAX_FRAMES_PER_SECOND).ceil().max(1.0) as usize);
    let candidates = extract(&clip, &part, frames, seconds, options, run_control)?;
    let chosen = sharpest(&candidates)?;
    for (index, candidate) in chosen.iter().enumerate() {
        let name = part.join(format!("{:04}.jpg", index + 1));
        fs::rename(&candidates[*candidate], name).map_err(PoseError::io(&candidates[*candidate]))?;
    }
    for file in candidates.iter().filter(|file| file.exists()) {
        fs::remove_file(file).map_err(PoseError::io(file))?;
    }
    fs::rename(&part, into).map_err(PoseError::io(into))?;
    Ok(chosen.len())
}

/// Duration of a clip, seconds.
fn duration(
    clip: &Path,
    part: &Path,
    options: &ClipOptions,
    run_control: &mut RunControl<'_>,
) -> Result<f64, PoseError> {
    let log = part.join("ffmpeg.log");
    let name = options.ffprobe.as_os_str();
    let ffprobe = ExternalProgram {
        name,
        install: INSTALL,
        log: &log,
        folder: None,
        process_limits: ProcessLimits::default(),
    };
    let mut release = None;
    ffprobe.run(&["-version".as_ref()], run_control, &mut |line, _| release = release.or(version(line)))?;
    if let Some(found) = release.filter(|release| *release < MIN_VERSION) {
        return Err(PoseError::TooOld {
            program: options.ffprobe.display().to_string(),
            found: found.to_string(),
            least: "4",
            install: INSTALL,
        });
    }
    let asked = ["-v", "error", "-show_entries", "format=duration", "-of", "csv=p=0"].map(OsStr::new);
    let mut seconds = None;
    ffprobe.run(&[&asked[..], &[clip.as_os_str()]].concat(), run_control, &mut |line, _| {
        seconds = seconds.or(line.parse().ok().filter(|s: &f64| s.is_finite() && *s > 0.0));
    })?;
    seconds.ok_or_else(|| {
        let reason = "is not a video clip of known duration".to_owned();
        CaptureError::File { file: clip.display().to_string(), reason }.into()
    })
}

/// Frames of the clip in order, [`CANDIDATES`] for each that is kept.
fn extract(
    clip: &Path,
    part: &Path,
    frames: usize,
    seconds: f64,
    options: &ClipOptions,
    run_control: &mut RunControl<'_>,
) -> Result<Vec<PathBuf>, PoseError> {
    let wanted = frames * CANDIDATES;
    let log = part.join("ffmpeg.log");
    // ffmpeg runs in the folder, because it would read a percent sign in the folder's path as a number pattern.
    let ffmpeg = ExternalProgram {
        name: options.ffmpeg.as_os_str(),
        install: INSTALL,
        log: &log,
        folder: Some(part),
        process_limits: ProcessLimits::default(),
    };
    let (rate, most) = (format!("fps={}", wanted as f64 / seconds), wanted.to_string());
    let before = ["-nostdin", "-hide_banner", "-nostats", "-progress", "pipe:1", "-i"].map(OsStr::new);
    let after = ["-vf", &rate, "-frames:v", &most, "-q:v", "2", "candidate_%06d.jpg"].map(OsStr::new);
    ffmpeg.run(
        &[&before[..], &[clip.as_os_str()], &after].concat(),
        run_control,
        &mut |line, run_control| {
            if let Some(done) = line.strip_prefix("frame=").and_then(|n| n.trim().parse().ok()) {
                (run_control.progress)(PoseProgress { stage: PoseStage::Frames, done, total: wanted as u64 });
            }
        },
    )?;
    let candidate = |i: usize| part.join(format!("candidate_{i:06}.jpg"));
    Ok((1..=wanted).map(candidate).take_while(|file| file.is_file()).collect())
}

/// The index of the sharpest of each [`CANDIDATES`] consecutive files.
fn sharpest(candidates: &[PathBuf]) -> Result<Vec<usize>, PoseError> {
    let sharpness = |file: &PathBuf| {
        let bytes = fs::read(file).map_err(PoseError::io(file))?;
        let reduced = |size| crate::ImportOptions::at_most(sharpness::SIDE).reduced_size(size);
        let image = image_file::decode_reduced(&bytes, image_file::DEFAULT_MAX_PIXELS, reduced);
        let (image, _) = image.map_err(|error| CaptureError::image(&file.display().to_string(), error))?;
        Ok::<_, PoseError>(sharpness::sharpness(&image))
    };
    let values: Vec<_> = candidates.par_iter().map(sharpness).collect();
    let values = values.into_iter().collect::<Result<Vec<_>, _>>()?;
    let sharpest = |(group, values): (usize, &[f64])| {
        let (best, _) = values.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        Some(group * CANDIDATES + best)
    };
    Ok(values.chunks(CANDIDATES).enumerate().filter_map(sharpest).collect())
}

/// The release in a line like `ffprobe version 5.1.6-0+deb12u1 Copyright ...`.
fn version(line: &str) -> Option<u32> {
    let (_, rest) = line.split_once(" version ")?;
    let digits = rest.trim_start_matches('n').split(|c: char| !c.is_ascii_digit()).next()?;
    // Development builds state a date instead of a release.
    digits.parse().ok().filter(|release| *release < 1000)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::image_file::encode_jpeg;

    #[test]
    fn sharpest_frame_of_each_interval_is_kept() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = |i: usize| {
            // Stripes of one width whose contrast is highest for frames 3, 6 and 11.
            let contrast = if [3, 6, 11].contains(&i) { 90 } else { 20 };
            let grey = |x: usize| if (x / 2).is_multiple_of(2) { 128 - contrast } else { 128 + contrast };
            let pixels: Vec<[u8; 3]> = (0..24 * 24).map(|p| [grey(p % 24); 3]).collect();
            let path = folder.path().join(format!("{i}.jpg"));
            fs::write(&path, encode_jpeg(24, 24, &pixels, 95).unwrap()).unwrap();
            path
        };
        let candidates: Vec<PathBuf> = (0..12).map(file).collect();
        assert_eq!(sharpest(&candidates).unwrap(), [3, 6, 11]);
        fs::write(&candidates[4], "no picture").unwrap();
        assert!(sharpest(&candidates).is_err());
    }

    #[test]
    fn clips_and_ffmpeg_versions_are_recognised() {
        assert_eq!(version("ffprobe version 5.1.6-0+deb12u1 Copyright (c) 2007"), Some(5));
        assert_eq!(version("ffmpeg version n7.0 Copyright"), Some(7));
        assert_eq!(version("ffmpeg version 20240101-git"), None);
        assert_eq!(version("built with gcc 12"), None);
        let folder = tempfile::TempDir::new().unwrap();
        let clip = folder.path().join("a.MP4");
        assert!(!is_clip(&clip), "the file does not exist");
        fs::write(&clip, "x").unwrap();
        assert!(is_clip(&clip) && !is_clip(folder.path()));
    }
}
