//! Extracts the sharpest frame of each interval of a clip with ffmpeg.

use std::ffi::OsStr;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::clip_probe::{ClipFacts, HighRange};
use super::error::PoseError;
use super::process::ExternalProgram;
use super::run_control::{PoseProgress, PoseStage, RunControl};
use crate::formats::image_file;
use crate::process_limits::ProcessLimits;
use crate::{CaptureError, sharpness};

const INSTALL: &str = "apt-get install ffmpeg, brew install ffmpeg, or https://ffmpeg.org/download.html";
/// The oldest supported release. Builds that state no release are assumed to be newer.
const MIN_VERSION: u32 = 4;
/// Greatest number of frames of an interval that are compared.
const CANDIDATES: usize = 5;
/// Frames per second of the extracted pictures, a number without meaning.
const OUTPUT_RATE: u32 = 25;
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

/// Writes the sharpest frame of each interval of `clip`, upright and with a standard dynamic range, as `0001.jpg` and so on
/// into the folder `into`, which must not exist. Returns the number of frames. The folder appears when it is complete; it
/// includes ffmpeg's output as `ffmpeg.log`. If ffmpeg lacks the filters for the high dynamic range of a clip, the colours are
/// not converted, and `ffmpeg.log` has a warning.
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
    let (facts, seconds) = probe(&clip, &part, options, run_control)?;
    let maps_tones = match facts.high_range() {
        Some(range) => can_map_tones(&part, range, options, run_control)?,
        None => false,
    };
    let plan = FramePlan::new(options.frames, seconds, facts.frame_count(seconds));
    let filters = format!("{},{}", plan.filters(), facts.colour_filters(maps_tones));
    let candidates = extract(&clip, &part, &plan, &filters, options, run_control)?;
    let chosen = sharpest(&candidates, plan.candidates)?;
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

/// The frames to extract from a clip.
#[derive(Debug, PartialEq)]
struct FramePlan {
    /// Number of intervals, each of which gives a frame.
    frames: usize,
    /// Number of frames of an interval that are compared.
    candidates: usize,
    /// Seconds between two compared frames.
    step: f64,
}

impl FramePlan {
    /// At most `wanted` intervals of a clip with a duration and a number of frames. No more frames are compared than the
    /// clip has: otherwise neighbours would be copies.
    fn new(wanted: usize, seconds: f64, clip_frames: usize) -> Self {
        let by_time = (seconds * MAX_FRAMES_PER_SECOND).ceil().max(1.0) as usize;
        let frames = wanted.max(3).min(by_time).min(clip_frames.max(1));
        let candidates = (clip_frames / frames).clamp(1, CANDIDATES);
        Self { frames, candidates, step: seconds / (frames * candidates) as f64 }
    }

    fn total(&self) -> usize {
        self.frames * self.candidates
    }

    /// The filters of ffmpeg that select the first frame of each step. The selected frames get consecutive times at
    /// [`OUTPUT_RATE`], so that ffmpeg neither copies nor drops frames.
    fn filters(&self) -> String {
        let step = self.step;
        format!(
            "select='isnan(prev_selected_t)+gt(floor(t/{step}),floor(prev_selected_t/{step}))',settb=1/90000,\
             setpts=N/{OUTPUT_RATE}/TB"
        )
    }
}

/// The program ffmpeg or ffprobe.
fn external<'a>(name: &'a Path, log: &'a Path, folder: Option<&'a Path>) -> ExternalProgram<'a> {
    let process_limits = ProcessLimits::default();
    ExternalProgram { name: name.as_os_str(), install: INSTALL, log, folder, process_limits }
}

/// What ffprobe states about a clip, and its duration, seconds.
fn probe(
    clip: &Path,
    part: &Path,
    options: &ClipOptions,
    run_control: &mut RunControl<'_>,
) -> Result<(ClipFacts, f64), PoseError> {
    let log = part.join("ffmpeg.log");
    let ffprobe = external(&options.ffprobe, &log, None);
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
    let asked = ClipFacts::ARGUMENTS.map(OsStr::new);
    let mut facts = ClipFacts::default();
    let arguments = [&asked[..], &[clip.as_os_str()]].concat();
    let probed = ffprobe.run(&arguments, run_control, &mut |line, _| facts.read_line(line));
    probed.map_err(|error| match error {
        PoseError::Failed { end, .. } => {
            let reason =
                format!("is not a video clip that ffmpeg reads: {}", end.lines().next().unwrap_or_default());
            unusable(clip, &reason)
        }
        other => other,
    })?;
    let unusable = || unusable(clip, "is not a video clip of known duration");
    let seconds = facts.seconds.ok_or_else(unusable)?;
    Ok((facts, seconds))
}

fn unusable(clip: &Path, reason: &str) -> PoseError {
    CaptureError::File { file: clip.display().to_string(), reason: reason.to_owned() }.into()
}

/// Whether ffmpeg has the filters that map the tones of a high dynamic range. Without them, adds a warning to the log.
fn can_map_tones(
    part: &Path,
    range: HighRange,
    options: &ClipOptions,
    run_control: &mut RunControl<'_>,
) -> Result<bool, PoseError> {
    let log = part.join("ffmpeg.log");
    let ffmpeg = external(&options.ffmpeg, &log, None);
    let mut found = [("zscale", false), ("tonemap", false)];
    let arguments = ["-hide_banner", "-filters"].map(OsStr::new);
    ffmpeg.run(&arguments, run_control, &mut |line, _| {
        let name = line.split_whitespace().nth(1);
        found
            .iter_mut()
            .filter(|(filter, _)| name == Some(filter))
            .for_each(|(_, is_there)| *is_there = true);
    })?;
    let Some((filter, _)) = found.iter().find(|(_, is_there)| !is_there) else { return Ok(true) };
    let warning = format!(
        "warning: the clip has a high dynamic range ({range:?}), and this ffmpeg has no filter `{filter}`: the frames have wrong \
         colours; install a complete ffmpeg, or save the clip with a standard dynamic range"
    );
    let mut file = fs::OpenOptions::new().append(true).open(&log).map_err(PoseError::io(&log))?;
    writeln!(file, "{warning}").map_err(PoseError::io(&log))?;
    Ok(false)
}

/// The frames that the sharpness check compares, in the order of the clip. Each belongs to one interval.
fn extract(
    clip: &Path,
    part: &Path,
    plan: &FramePlan,
    filters: &str,
    options: &ClipOptions,
    run_control: &mut RunControl<'_>,
) -> Result<Vec<PathBuf>, PoseError> {
    let log = part.join("ffmpeg.log");
    // ffmpeg runs in the folder, because it would read a percent sign in the folder's path as a number pattern.
    let ffmpeg = external(&options.ffmpeg, &log, Some(part));
    let (rate, most) = (OUTPUT_RATE.to_string(), plan.total().to_string());
    let before = ["-nostdin", "-hide_banner", "-nostats", "-progress", "pipe:1", "-i"].map(OsStr::new);
    let after = ["-vf", filters, "-r", &rate, "-frames:v", &most, "-q:v", "2", "candidate_%06d.jpg"];
    let total = plan.total() as u64;
    ffmpeg.run(
        &[&before[..], &[clip.as_os_str()], &after.map(OsStr::new)].concat(),
        run_control,
        &mut |line, run_control| {
            if let Some(done) = line.strip_prefix("frame=").and_then(|n| n.trim().parse().ok()) {
                (run_control.progress)(PoseProgress { stage: PoseStage::Frames, done, total });
            }
        },
    )?;
    let candidate = |i: usize| part.join(format!("candidate_{i:06}.jpg"));
    Ok((1..=plan.total()).map(candidate).take_while(|file| file.is_file()).collect())
}

/// The index of the sharpest of each `count` consecutive files.
fn sharpest(candidates: &[PathBuf], count: usize) -> Result<Vec<usize>, PoseError> {
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
        Some(group * count + best)
    };
    Ok(values.chunks(count.max(1)).enumerate().filter_map(sharpest).collect())
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
        assert_eq!(sharpest(&candidates, CANDIDATES).unwrap(), [3, 6, 11]);
        fs::write(&candidates[4], "no picture").unwrap();
        assert!(sharpest(&candidates, CANDIDATES).is_err());
    }

    #[test]
    fn no_more_frames_are_compared_than_the_clip_has() {
        let plan = |wanted, seconds, frames| {
            let plan = FramePlan::new(wanted, seconds, frames);
            (plan.frames, plan.candidates)
        };
        assert_eq!(plan(80, 60.0, 1800), (80, 5));
        assert_eq!(plan(80, 6.0, 48), (30, 1), "8 frames a second");
        assert_eq!(plan(80, 6.0, 144), (30, 4));
        assert_eq!(plan(80, 10.0, 7), (7, 1));
        assert_eq!(plan(0, 0.1, 0), (1, 1));
        for frames in 1..400 {
            let plan = FramePlan::new(80, 6.0, frames);
            assert!(plan.total() <= frames && plan.step * plan.total() as f64 <= 6.0 + 1e-9, "{plan:?}");
        }
    }

    /// The frames of a clip with the transfer function `transfer`, by stand-ins for ffprobe and for an ffmpeg with these
    /// filters: the log with the arguments.
    #[cfg(unix)]
    fn log_of_clip(transfer: &str, filters: &str) -> String {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::TempDir::new().unwrap();
        let at = |name: &str| folder.path().join(name);
        let program = |name: &str, text: String| {
            fs::write(at(name), format!("#!/bin/sh\n{text}\n")).unwrap();
            fs::set_permissions(at(name), fs::Permissions::from_mode(0o755)).unwrap();
            at(name)
        };
        fs::write(at("frame.jpg"), encode_jpeg(16, 16, &[[90; 3]; 256], 90).unwrap()).unwrap();
        fs::write(at("clip.mp4"), "a clip").unwrap();
        let frame = at("frame.jpg").display().to_string();
        let options = ClipOptions {
            ffprobe: program(
                "ffprobe",
                format!("echo color_transfer={transfer}; echo duration=1; echo nb_frames=1"),
            ),
            ffmpeg: program(
                "ffmpeg",
                format!(
                    "case \"$*\" in *-filters*) for f in {filters}; do echo \" .. $f V->V\"; done;; \
                     *) echo \"$@\"; cp {frame} candidate_000001.jpg;; esac"
                ),
            ),
            frames: 3,
        };
        let mut ignored = |_| {};
        let mut run_control = RunControl::new(std::time::Duration::from_secs(600), &mut ignored, &|| false);
        assert_eq!(frames_of_clip(&at("clip.mp4"), &at("frames"), &options, &mut run_control).unwrap(), 1);
        fs::read_to_string(at("frames/ffmpeg.log")).unwrap()
    }

    #[test]
    #[cfg(unix)]
    fn hdr_clips_are_read_without_the_filters_with_a_warning() {
        let warned = |log: &str| log.contains("warning") && log.contains("zscale") && log.contains("Hlg");
        let log = log_of_clip("arib-std-b67", "scale tonemap");
        assert!(warned(&log) && log.contains("scale=in_color_matrix") && !log.contains("mobius"), "{log}");
        let log = log_of_clip("arib-std-b67", "scale tonemap zscale");
        assert!(!warned(&log) && log.contains("mobius"), "the control: {log}");
        let log = log_of_clip("bt709", "scale");
        assert!(!log.contains("warning") && log.contains("scale=in_color_matrix"), "the control: {log}");
    }

    /// Makes a clip with ffmpeg and returns its frames, as decoded pictures.
    fn frames_of(source: &[&str]) -> Vec<relume_scene::ImageRgba> {
        let folder = tempfile::TempDir::new().unwrap();
        let (clip, into) = (folder.path().join("100% a.mp4"), folder.path().join("frames"));
        let start = ["-loglevel", "error", "-f", "lavfi"];
        let status =
            std::process::Command::new("ffmpeg").args(start).args(source).arg(&clip).status().unwrap();
        assert!(status.success());
        let mut ignored = |_| {};
        let mut run_control = RunControl::new(std::time::Duration::from_secs(600), &mut ignored, &|| false);
        let count = frames_of_clip(&clip, &into, &ClipOptions::default(), &mut run_control).unwrap();
        let read = |i: usize| {
            let bytes = fs::read(into.join(format!("{i:04}.jpg"))).unwrap();
            image_file::decode(&bytes, 1 << 20).unwrap()
        };
        (1..=count).map(read).collect()
    }

    #[test]
    #[ignore = "needs ffmpeg and ffprobe"]
    fn frames_of_a_slow_clip_are_all_different() {
        let frames = frames_of(&["-i", "testsrc2=size=64x48:rate=8:duration=3", "-c:v", "mpeg4"]);
        assert!((12..=15).contains(&frames.len()), "{}", frames.len());
        assert!(frames.windows(2).all(|pair| pair[0] != pair[1]), "no copies");
    }

    #[test]
    #[ignore = "needs ffmpeg with zscale, x265 and ffprobe"]
    fn high_dynamic_range_clips_look_like_standard_ones() {
        let colours = "color=c=0xb04030:size=64x48:rate=10:duration=1";
        let plain = &frames_of(&["-i", colours, "-c:v", "mpeg4", "-q:v", "1"])[0];
        let pixel =
            |image: &relume_scene::ImageRgba| [0, 1, 2].map(|k| image.pixels[24 * 64 + 32][k] * 255.0);
        let near = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 8.0);
        assert!(near(pixel(plain), [176.0, 64.0, 48.0]), "{:?}", pixel(plain));
        for transfer in ["arib-std-b67", "smpte2084"] {
            let filter = format!(
                "format=gbrp,setparams=color_primaries=bt709:color_trc=iec61966-2-1:colorspace=gbr:range=pc,\
                 zscale=t=linear:npl=203,format=gbrpf32le,\
                 zscale=p=bt2020:t={transfer}:m=bt2020nc:r=limited:npl=203,format=yuv420p10le"
            );
            let tags = ["-color_primaries", "bt2020", "-color_trc", transfer, "-colorspace", "bt2020nc"];
            let encoder = ["-c:v", "libx265", "-x265-params", "log-level=none:crf=4"];
            let source = [&["-i", colours, "-vf", &filter][..], &encoder, &tags].concat();
            let found = pixel(&frames_of(&source)[0]);
            assert!(near(found, pixel(plain)), "{transfer}: {found:?} {:?}", pixel(plain));
        }
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
