//! Photographs without poses and clips, with COLMAP and ffmpeg and with their failures. Scripts replace both
//! programs, because the tests check how they are called; one ignored test uses the real programs.

#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

use relume_capture::poses::{PoseError, PoseOptions, PoseStage, RunControl, find_poses};
use relume_capture::{ImportLimits, ImportOptions, PhotosWithoutPoses, cameras, import};
use relume_spec::training::UpAxis;
use relume_train::eval::PoseErrors;
use tempfile::TempDir;

use relume_fixtures::data;
use relume_fixtures::small_set::{camera, picture};

/// Number of photographs in a [`Place`].
pub const PHOTOGRAPHS: usize = 8;

/// A folder with photographs, and one with programs, including a script named `colmap`.
pub struct Place {
    folder: TempDir,
}

impl Place {
    /// `matcher` and `mapper` are the script's actions for these commands.
    pub fn new(version: &str, matcher: &str, mapper: &str) -> Self {
        let place = Self { folder: TempDir::new().unwrap() };
        fs::create_dir_all(place.at("photos")).unwrap();
        fs::create_dir_all(place.at("bin")).unwrap();
        for i in 0..PHOTOGRAPHS {
            fs::write(place.at(&format!("photos/{i}.png")), picture(i)).unwrap();
        }
        place.replace(version, matcher, mapper);
        place.write_model(PHOTOGRAPHS);
        place
    }

    /// Replaces the script named `colmap`.
    pub fn replace(&self, version: &str, matcher: &str, mapper: &str) {
        let script = format!(
            "case $1 in\n\
             help) echo 'COLMAP {version} -- Structure-from-Motion' ;;\n\
             feature_extractor) echo \"$@\"; echo 'Processed file [8/8]' ;;\n\
             exhaustive_matcher) echo 'Matching block [1/1, 1/1]'; {matcher} ;;\n\
             mapper) while [ \"$1\" != --output_path ]; do shift; done; out=$2; model={}; {mapper} ;;\n\
             esac\n",
            self.at("model").display()
        );
        self.program("colmap", &script);
    }

    pub fn at(&self, path: &str) -> PathBuf {
        self.folder.path().join(path)
    }

    /// A PATH with the scripts first.
    pub fn path(&self) -> String {
        format!("{}:{}", self.at("bin").display(), std::env::var("PATH").unwrap())
    }

    fn program(&self, name: &str, script: &str) {
        let path = self.at("bin").join(name);
        fs::write(&path, format!("#!/bin/sh\n{script}")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    /// The model that the script finds: the first `count` photographs.
    pub fn write_model(&self, count: usize) {
        fs::create_dir_all(self.at("model")).unwrap();
        let first = camera(0);
        let lens = format!("1 PINHOLE 8 6 {} {} 4 3\n", first.fx, first.fy);
        let image = |i: usize| {
            let ([w, x, y, z], [a, b, c]) = camera(i).to_colmap();
            format!("{i} {w} {x} {y} {z} {a} {b} {c} 1 {i}.png\n\n")
        };
        fs::write(self.at("model/cameras.txt"), lens).unwrap();
        fs::write(self.at("model/images.txt"), (0..count).map(image).collect::<String>()).unwrap();
        fs::write(self.at("model/points3D.txt"), "").unwrap();
    }

    /// Runs this program with the scripts first on PATH, or, without `with_tools`, with an empty PATH.
    fn relume(&self, arguments: &[&str], with_tools: bool) -> Output {
        let path = if with_tools { self.path() } else { String::new() };
        let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
        command.args(arguments).current_dir(self.folder.path()).env("PATH", path).output().unwrap()
    }

    fn fails_with(&self, arguments: &[&str], with_tools: bool, words: &[&str]) {
        let output = self.relume(arguments, with_tools);
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{message}");
        words.iter().for_each(|word| assert!(message.contains(word), "{word}: {message}"));
    }

    /// [`find_poses`] with the script, and the reported progress.
    fn find(&self, limit: Duration, cancelled: bool) -> (Result<usize, PoseError>, Vec<PoseStage>) {
        let photographs =
            PhotosWithoutPoses::open(&self.at("photos"), &ImportLimits::default()).unwrap().unwrap();
        let options = PoseOptions { program: self.at("bin/colmap"), ..PoseOptions::default() };
        let (mut stages, is_cancelled) = (Vec::new(), || cancelled);
        let mut progress = |progress: relume_capture::poses::PoseProgress| stages.push(progress.stage);
        let mut run_control = RunControl::new(limit, &mut progress, &is_cancelled);
        let found = find_poses(&photographs, &self.at("found"), &options, &mut run_control);
        (found.map(|poses| poses.unregistered.len()), stages)
    }
}

pub const COPY: &str = "cp -r $model $out/0";
const POSES: [&str; 3] = ["capture", "poses", "photos"];
const LONG: Duration = Duration::from_secs(600);

#[test]
fn photographs_become_a_trainable_capture_and_poses_are_reused() {
    let place = Place::new("3.8", ":", COPY);
    let train =
        ["train", "photos", "--preset", "draft", "--set", "iterations=4", "--device", "cpu", "--out", "m"];
    let trained = place.relume(&train, true);
    let said = String::from_utf8_lossy(&trained.stderr);
    assert!(trained.status.success() && said.contains("8 of 8 photographs have poses"), "{said}");
    assert!(place.at("m").exists());
    let capture = import(&place.at("photos.poses"), &ImportOptions::default()).unwrap();
    assert_eq!((capture.layout.as_str(), capture.train.len() + capture.test.len()), ("colmap", PHOTOGRAPHS));
    let log = fs::read_to_string(place.at("photos.poses/colmap.log")).unwrap();
    assert!(log.contains("Processed file [8/8]") && log.contains("--ImageReader.single_camera 1"), "{log}");
    assert!(!place.at("photos.poses/colmap").exists(), "what nobody needs is gone");

    let again = place.relume(&POSES, false);
    let said = String::from_utf8_lossy(&again.stderr);
    assert!(again.status.success() && said.contains("by an earlier run"), "{said}");
    assert!(String::from_utf8_lossy(&again.stdout).ends_with("photos.poses\n"));
    fs::write(place.at("photos/more.png"), picture(9)).unwrap();
    place.fails_with(&POSES, true, &["poses of other photographs"]);
    fs::remove_file(place.at("photos/more.png")).unwrap();
    fs::write(place.at("photos/0.png"), picture(9)).unwrap();
    place.fails_with(&POSES, true, &["poses of other photographs"]);
}

#[test]
fn missing_old_or_failing_colmap_gives_an_error_with_reason() {
    let place = Place::new("3.8", ":", COPY);
    place.fails_with(&POSES, false, &["`colmap` is not installed", "apt-get install colmap"]);
    Place::new("3.5", ":", COPY).fails_with(&POSES, true, &["version 3.5", "at least 3.6"]);
    let broken = Place::new("3.8", "echo 'no more memory'; exit 1", COPY);
    broken.fails_with(&POSES, true, &["colmap exhaustive_matcher", "no more memory", "colmap.log"]);
    Place::new("3.8", "kill -9 $$", COPY).fails_with(&POSES, true, &["failed (signal: 9"]);
    Place::new("3.8", ":", ":").fails_with(&POSES, true, &["placed 0 of 8 photographs"]);
    let damaged = Place::new("3.8", ":", "cp -r $model $out/0; echo x > $out/0/images.txt");
    damaged.fails_with(&POSES, true, &["images.txt"]);
    assert!(!damaged.at("photos.poses/sparse").exists(), "there is no capture where poses failed");
}

#[test]
fn unposed_photographs_are_counted_and_half_must_have_poses() {
    let place = Place::new("3.8", ":", COPY);
    place.write_model(3);
    assert!(matches!(
        place.find(LONG, false).0,
        Err(PoseError::TooFewPlaced { placed: 3, photographs: 8, .. })
    ));
    place.write_model(6);
    let (found, stages) = place.find(LONG, false);
    assert_eq!(found.unwrap(), 2);
    assert_eq!(stages, [PoseStage::Features, PoseStage::Matching]);
}

#[test]
fn largest_of_several_colmap_models_is_used() {
    let two = "mkdir $out/0; cp $model/* $out/0; head -2 $out/0/images.txt > $out/0/i; mv $out/0/i $out/0/images.txt; cp -r $model $out/1";
    let place = Place::new("3.8", ":", two);
    assert_eq!(place.find(LONG, false).0.unwrap(), 0);
}

#[test]
fn colmap_is_stopped_after_timeout_or_cancellation() {
    let place = Place::new("3.8", "exec sleep 300", COPY);
    let (ended, _) = place.find(Duration::from_secs(2), false);
    assert!(
        matches!(&ended, Err(PoseError::TimedOut { program, .. }) if program.contains("exhaustive_matcher")),
        "{ended:?}"
    );
    assert!(matches!(place.find(LONG, true).0, Err(PoseError::Cancelled)));
    place.program("colmap", "exit 7");
    let quick = Place::new("3.8", ":", COPY);
    fs::copy(quick.at("bin/colmap"), place.at("bin/colmap")).unwrap();
    assert_eq!(place.find(LONG, false).0.unwrap(), 0, "and the next run goes on");
}

/// Scripts for ffmpeg: a clip of ten seconds, whose frames are the photographs of `place`, repeated.
fn with_clip(place: &Place) {
    fs::write(place.at("walk.mp4"), "no clip, but no one looks").unwrap();
    place.program(
        "ffprobe",
        "case $1 in -version) echo 'ffprobe version 5.1.6' ;; *) echo duration=10.0 ;; esac\n",
    );
    let script = "while [ \"$1\" != -frames:v ]; do shift; done; n=1\n\
                  while [ $n -le $2 ]; do cp PHOTOS/$((n % 8)).png $(printf candidate_%06d.jpg $n); n=$((n + 1)); done\n\
                  echo frame=$2\n";
    place.program("ffmpeg", &script.replace("PHOTOS", &place.at("photos").display().to_string()));
}

#[test]
fn clip_becomes_photographs_or_gives_a_clear_error() {
    let place = Place::new("3.8", ":", "exit 1");
    with_clip(&place);
    let clip = ["capture", "poses", "walk.mp4", "--clip-frames", "6"];
    place.fails_with(&clip, false, &["`ffprobe` is not installed", "apt-get install ffmpeg"]);
    // COLMAP fails, after the frames have been extracted.
    place.fails_with(&clip, true, &["colmap mapper"]);
    let mut frames: Vec<_> =
        fs::read_dir(place.at("walk.frames")).unwrap().map(|e| e.unwrap().file_name()).collect();
    frames.sort();
    assert_eq!(frames.len(), 7, "six frames and a log: {frames:?}");
    assert_eq!((frames[0].to_str(), frames[6].to_str()), (Some("0001.jpg"), Some("ffmpeg.log")));
    assert!(!place.at("walk.frames.part").exists());

    fs::remove_dir_all(place.at("walk.frames")).unwrap();
    place.program(
        "ffprobe",
        "case $1 in -version) echo 'ffprobe version 3.4' ;; *) echo duration=10.0 ;; esac\n",
    );
    place.fails_with(&clip, true, &["`ffprobe` has version 3", "at least 4"]);
    place.program("ffprobe", "case $1 in -version) ;; *) echo duration=N/A ;; esac\n");
    place.fails_with(&clip, true, &["walk.mp4", "not a video clip of known duration"]);
    place.program("ffprobe", "case $1 in -version) ;; *) echo duration=10.0 ;; esac\n");
    place.program("ffmpeg", "echo 'moov atom not found'; exit 1\n");
    place.fails_with(&clip, true, &["ffmpeg", "moov atom not found"]);
    assert!(!place.at("walk.frames").exists(), "no half of a clip is taken for photographs");
}

#[test]
fn capture_check_exit_code_reports_photograph_problems() {
    let place = Place::new("3.8", ":", COPY);
    let few = place.relume(&["capture", "check", "photos", "--each"], true);
    let told = String::from_utf8_lossy(&few.stdout);
    assert_eq!(few.status.code(), Some(1));
    assert!(told.contains("problem: too few photographs (8)") && told.contains("3.png  8x6"), "{told}");
    for i in 0..40 {
        let noise = |p: usize| [((p * p * 7 + p * 13) % 251) as u8; 3];
        let pixels: Vec<[u8; 3]> = (0..64 * 48).map(|p| noise(p + i / 2)).collect();
        let png = relume_capture::formats::image_file::encode_png(64, 48, &pixels).unwrap();
        fs::create_dir_all(place.at("many")).unwrap();
        fs::write(place.at(&format!("many/{i}.png")), png).unwrap();
    }
    let many = place.relume(&["capture", "check", "many"], true);
    let told = String::from_utf8_lossy(&many.stdout);
    assert!(many.status.success() && told.ends_with("\nsuitable for training\n"), "{told}");
    fs::write(place.at("many/x.jpg"), "no picture").unwrap();
    let damaged = place.relume(&["capture", "check", "many"], true);
    let told = String::from_utf8_lossy(&damaged.stdout);
    assert!(!damaged.status.success() && told.contains("x.jpg"), "{told}");
    place.fails_with(&["capture", "check", "bin"], true, &["no photographs"]);
}

#[test]
#[ignore = "needs COLMAP and RELUME_TEST_DATA (see CONTRIBUTING.md), and minutes"]
fn colmap_finds_the_poses_of_phone_photographs() {
    let folder = TempDir::new().unwrap();
    let photos = folder.path().join("photos");
    fs::create_dir(&photos).unwrap();
    let capture = data("captures/beer71_colmap");
    for (i, photo) in fs::read_dir(capture.join("images")).unwrap().map(|e| e.unwrap().path()).enumerate() {
        if i % 3 == 0 {
            fs::copy(&photo, photos.join(photo.file_name().unwrap())).unwrap();
        }
    }
    let photographs = PhotosWithoutPoses::open(&photos, &ImportLimits::default()).unwrap().unwrap();
    let mut progress = |_| {};
    let mut run_control = RunControl::new(Duration::from_secs(3600), &mut progress, &|| false);
    let into: &Path = &folder.path().join("found");
    let poses = find_poses(&photographs, into, &PoseOptions::default(), &mut run_control).unwrap();
    assert!(poses.unregistered.len() <= 2, "{:?}", poses.unregistered);
    let named = |path: &Path| {
        let list = cameras(path, &ImportLimits::default(), UpAxis::Auto).unwrap().into_iter();
        list.map(|photo| (photo.name.rsplit('/').next().unwrap().to_owned(), photo.camera))
            .collect::<std::collections::BTreeMap<_, _>>()
    };
    let (found, stated) = (named(into), named(&capture));
    let pairs: Vec<_> = found.iter().map(|(name, camera)| (*camera, stated[name])).collect();
    let (found, mut truth): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
    let (rotation, position) = PoseErrors::of(&found, &truth).unwrap().medians();
    assert!(rotation < 1.0 && position < 0.05, "{rotation} degrees, {position}");
    truth.rotate_left(5);
    // The poses cannot be compared if no two of them agree.
    let control = PoseErrors::of(&found, &truth);
    assert!(control.is_none_or(|e| e.medians().1 > 0.1), "the control: cameras of other photographs");
}
