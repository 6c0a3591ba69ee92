//! Runs the stages of COLMAP: features, matches, poses.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::error::PoseError;
use super::process::ExternalProgram;
use super::run_control::{PoseProgress, PoseStage, RunControl};
use super::workspace::Workspace;
use crate::process_limits::ProcessLimits;
use crate::{ImportLimits, PhotosWithoutPoses, Up, cameras_of_colmap};

/// The oldest supported version of COLMAP.
const MIN_VERSION: (u32, u32) = (3, 6);
/// Time limit of the command that prints the version.
const HELP_TIME: Duration = Duration::from_secs(60);
const INSTALL: &str = "apt-get install colmap, brew install colmap, or https://colmap.github.io/install.html; \
                       or use a capture that has poses";

/// Options of [`find_poses`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PoseOptions {
    /// COLMAP: a name to find on PATH, or a path.
    pub program: PathBuf,
    /// Longest side of the photographs for feature extraction, pixels. Larger photographs are reduced.
    pub max_side: u32,
    /// Greatest number of features of a photograph.
    pub max_features: u32,
    /// Threads of COLMAP; `None` for one per processor.
    pub threads: Option<u32>,
    /// Limit on the memory of COLMAP, bytes (on Linux); `None` for no limit.
    pub memory: Option<u64>,
    /// Whether COLMAP runs at low CPU priority (on Linux).
    pub low_priority: bool,
}

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            program: "colmap".into(),
            max_side: 1600,
            max_features: 4096,
            threads: None,
            memory: None,
            low_priority: false,
        }
    }
}

/// The result of [`find_poses`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PoseResult {
    /// Number of photographs.
    pub photographs: usize,
    /// Names of the photographs without a pose; the capture does not include them.
    pub unregistered: Vec<String>,
    /// True if an earlier run had already found the poses.
    pub already_present: bool,
}

/// Finds the poses of `photographs` and writes a capture to the folder `into`: `images/`, `masks/`, `sparse/0/` and
/// COLMAP's output in `colmap.log`. A run that was interrupted is resumed. A complete run is not repeated.
///
/// # Errors
/// [`PoseError`]. The folder is then not a capture, but contains the log.
pub fn find_poses(
    photographs: &PhotosWithoutPoses,
    into: &Path,
    options: &PoseOptions,
    run_control: &mut RunControl<'_>,
) -> Result<PoseResult, PoseError> {
    let workspace = Workspace::fill(into, photographs, run_control)?;
    let already_present = workspace.is_done();
    if !already_present {
        let colmap = Colmap::open(&workspace, options, run_control)?;
        colmap.features(photographs, run_control)?;
        colmap.matches(run_control)?;
        let model = colmap.model(photographs, run_control)?;
        workspace.finish(&model)?;
    }
    let placed = placed(into)?;
    let is_unplaced = |name: &&str| !placed.contains(&photographs.converted_name(name));
    let unregistered: Vec<String> = photographs.photos().filter(is_unplaced).map(str::to_owned).collect();
    Ok(PoseResult { photographs: photographs.photos().len(), unregistered, already_present })
}

/// The version of the installed COLMAP. The program's output is appended to the file `log`.
///
/// # Errors
/// [`PoseError::NotInstalled`], [`PoseError::TooOld`] if [`find_poses`] does not support the version, or the reason
/// why the program does not run.
pub fn colmap_version(options: &PoseOptions, log: &Path) -> Result<(u32, u32), PoseError> {
    let mut progress = |_| {};
    let mut run_control = RunControl::new(HELP_TIME, &mut progress, &|| false);
    let name = options.program.as_os_str();
    let program = ExternalProgram {
        name,
        install: INSTALL,
        log,
        folder: None,
        process_limits: ProcessLimits::default(),
    };
    checked_version(&program, &mut run_control)
}

/// The version that COLMAP reports, if it is supported.
fn checked_version(
    colmap: &ExternalProgram<'_>,
    run_control: &mut RunControl<'_>,
) -> Result<(u32, u32), PoseError> {
    let mut told = Vec::new();
    colmap.run(&["help".as_ref()], run_control, &mut |line, _| told.push(line.to_owned()))?;
    let found = told.iter().find_map(|line| version(line));
    found.filter(|version| *version >= MIN_VERSION).ok_or_else(|| PoseError::TooOld {
        program: colmap.name.display().to_string(),
        found: found.map_or("unknown".to_owned(), |(major, minor)| format!("{major}.{minor}")),
        least: "3.6",
        install: INSTALL,
    })
}

/// The names of the photographs with a pose in the model in `folder`.
fn placed(folder: &Path) -> Result<Vec<String>, PoseError> {
    let cameras = cameras_of_colmap(folder, &ImportLimits::default(), Up::MEAN)?;
    Ok(cameras.into_iter().map(|camera| camera.name).collect())
}

/// COLMAP with its workspace.
struct Colmap<'a> {
    options: &'a PoseOptions,
    workspace: &'a Workspace,
    log: PathBuf,
    database: PathBuf,
    /// Prefixes of option names, which differ between COLMAP versions.
    groups: OptionGroups,
}

/// Prefixes of the options that version 3.13 renamed.
struct OptionGroups {
    extraction: &'static str,
    matching: &'static str,
}

impl<'a> Colmap<'a> {
    /// Checks the program and creates the scratch folder.
    fn open(
        workspace: &'a Workspace,
        options: &'a PoseOptions,
        run_control: &mut RunControl<'_>,
    ) -> Result<Self, PoseError> {
        let (log, scratch) = (workspace.log(), workspace.scratch());
        fs::create_dir_all(&scratch).map_err(PoseError::io(&scratch))?;
        let groups = OptionGroups { extraction: "SiftExtraction", matching: "SiftMatching" };
        let mut colmap = Self { options, workspace, log, database: scratch.join("database.db"), groups };
        checked_version(&colmap.program(), run_control)?;
        let mut renamed = false;
        colmap.run(&["feature_extractor".as_ref(), "-h".as_ref()], run_control, &mut |line, _| {
            renamed |= line.contains("--FeatureExtraction.use_gpu");
        })?;
        if renamed {
            colmap.groups = OptionGroups { extraction: "FeatureExtraction", matching: "FeatureMatching" };
        }
        Ok(colmap)
    }

    fn run(
        &self,
        arguments: &[&OsStr],
        run_control: &mut RunControl<'_>,
        line: &mut dyn FnMut(&str, &mut RunControl<'_>),
    ) -> Result<(), PoseError> {
        self.program().run(arguments, run_control, line)
    }

    fn program(&self) -> ExternalProgram<'_> {
        let PoseOptions { memory, low_priority, .. } = *self.options;
        let process_limits = ProcessLimits {
            memory,
            low_priority,
            marker: Some(self.workspace.marker()),
            ..ProcessLimits::default()
        };
        let name = self.options.program.as_os_str();
        ExternalProgram { name, install: INSTALL, log: &self.log, folder: None, process_limits }
    }

    /// The option that limits the threads of a command.
    fn threads(&self, group: &str) -> Option<(String, OsString)> {
        Some((format!("{group}.num_threads"), self.options.threads?.to_string().into()))
    }

    /// Runs a command with options and their values. `[done/total]` after `counted` in its output is reported as
    /// progress.
    fn stage(
        &self,
        stage: PoseStage,
        command: &str,
        options: &[(String, OsString)],
        counted: &str,
        run_control: &mut RunControl<'_>,
    ) -> Result<(), PoseError> {
        let flags: Vec<String> = options.iter().map(|(name, _)| format!("--{name}")).collect();
        let pairs =
            flags.iter().zip(options).flat_map(|(flag, (_, value))| [flag.as_ref(), value.as_os_str()]);
        let arguments: Vec<&OsStr> = std::iter::once(command.as_ref()).chain(pairs).collect();
        self.run(&arguments, run_control, &mut |line, run_control| {
            if let Some((done, total)) = count(line, counted) {
                (run_control.progress)(PoseProgress { stage, done, total });
            }
        })
    }

    fn features(
        &self,
        photographs: &PhotosWithoutPoses,
        run_control: &mut RunControl<'_>,
    ) -> Result<(), PoseError> {
        let sift = &self.groups.extraction;
        let one_size = photographs.have_one_size()?;
        let mut options = vec![
            ("database_path".to_owned(), self.database.clone().into()),
            ("image_path".to_owned(), self.workspace.images().into()),
            ("ImageReader.single_camera".to_owned(), u8::from(one_size).to_string().into()),
            ("ImageReader.camera_model".to_owned(), "SIMPLE_RADIAL".into()),
        ];
        options.extend([
            (format!("{sift}.use_gpu"), "0".into()),
            (format!("{sift}.max_image_size"), self.options.max_side.to_string().into()),
            ("SiftExtraction.max_num_features".to_owned(), self.options.max_features.to_string().into()),
        ]);
        options.extend(self.threads(sift));
        self.stage(PoseStage::Features, "feature_extractor", &options, "Processed file", run_control)
    }

    fn matches(&self, run_control: &mut RunControl<'_>) -> Result<(), PoseError> {
        // Small blocks, so that progress is visible: COLMAP's default is one block of fifty photographs.
        const BLOCK: &str = "10";
        let mut options = vec![
            ("database_path".to_owned(), self.database.clone().into()),
            (format!("{}.use_gpu", self.groups.matching), "0".into()),
            ("ExhaustiveMatching.block_size".to_owned(), BLOCK.into()),
        ];
        options.extend(self.threads(self.groups.matching));
        self.stage(PoseStage::Matching, "exhaustive_matcher", &options, "Matching block", run_control)
    }

    /// Computes the poses. Returns the folder of the model with the most photographs.
    fn model(
        &self,
        photographs: &PhotosWithoutPoses,
        run_control: &mut RunControl<'_>,
    ) -> Result<PathBuf, PoseError> {
        let models = self.workspace.scratch().join("models");
        if models.is_dir() {
            fs::remove_dir_all(&models).map_err(PoseError::io(&models))?;
        }
        fs::create_dir_all(&models).map_err(PoseError::io(&models))?;
        let least = photographs.photos().len().min(10).to_string();
        let threads =
            self.threads("Mapper").map(|(name, value)| (OsString::from(format!("--{name}")), value));
        let images = self.workspace.images().into_os_string();
        let mut arguments: Vec<&OsStr> = vec![
            "mapper".as_ref(),
            "--database_path".as_ref(),
            self.database.as_os_str(),
            "--image_path".as_ref(),
            &images,
            "--output_path".as_ref(),
            models.as_os_str(),
            "--Mapper.min_model_size".as_ref(),
            least.as_ref(),
        ];
        arguments.extend(threads.iter().flat_map(|(name, value)| [name.as_os_str(), value.as_os_str()]));
        let total = photographs.photos().len() as u64;
        self.run(&arguments, run_control, &mut |line, run_control| {
            if let Some(done) = registered(line) {
                let progress = PoseProgress { stage: PoseStage::Mapping, done: done.min(total), total };
                (run_control.progress)(progress);
            }
        })?;
        let mut largest: Option<(usize, PathBuf)> = None;
        let mut folders = Vec::new();
        for entry in fs::read_dir(&models).map_err(PoseError::io(&models))? {
            folders.push(entry.map_err(PoseError::io(&models))?.path());
        }
        folders.sort();
        for folder in folders.into_iter().filter(|folder| folder.is_dir()) {
            let placed = placed(&folder)?.len();
            if largest.as_ref().is_none_or(|(most, _)| placed > *most) {
                largest = Some((placed, folder));
            }
        }
        let photographs = photographs.photos().len();
        let placed = largest.as_ref().map_or(0, |(placed, _)| *placed);
        match largest.filter(|_| placed >= 3 && 2 * placed >= photographs) {
            Some((_, folder)) => Ok(folder),
            None => Err(PoseError::TooFewPlaced { placed, photographs, log: self.log.clone() }),
        }
    }
}

/// Major and minor version in a line like `COLMAP 3.8 -- ...`.
fn version(line: &str) -> Option<(u32, u32)> {
    let (_, rest) = line.split_once("COLMAP ")?;
    let mut numbers = rest.split(|c: char| !c.is_ascii_digit());
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?))
}

/// Done and total of a line like `Processed file [3/24]`. The blocks of a matrix, `Matching block [1/3, 2/3]`, are
/// counted row by row.
fn count(line: &str, counted: &str) -> Option<(u64, u64)> {
    let (_, rest) = line.split_once(counted)?;
    let (counts, _) = rest.split_once('[')?.1.split_once(']')?;
    let pair = |text: &str| -> Option<(u64, u64)> {
        let (done, total) = text.trim().split_once('/')?;
        Some((done.parse().ok()?, total.parse().ok()?))
    };
    match counts.split_once(',') {
        None => pair(counts),
        Some((rows, columns)) => {
            let ((row, rows), (column, columns)) = (pair(rows)?, pair(columns)?);
            Some((row.checked_sub(1)?.checked_mul(columns)?.checked_add(column)?, rows.checked_mul(columns)?))
        }
    }
}

/// Number of registered photographs in a line like `Registering image #5 (6)`.
fn registered(line: &str) -> Option<u64> {
    let (_, rest) = line.split_once("Registering image #")?;
    rest.split_once('(')?.1.split(|c: char| !c.is_ascii_digit()).find(|s| !s.is_empty())?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_and_counts_are_parsed_from_colmap_output() {
        assert_eq!(version("COLMAP 3.8 -- Structure-from-Motion and Multi-View Stereo"), Some((3, 8)));
        assert_eq!(version("COLMAP 3.12.1 (Commit b1b2 on 2025-07-01 with CUDA)"), Some((3, 12)));
        assert_eq!(version("COLMAP 4.0.0.dev0"), Some((4, 0)));
        assert_eq!(version("colmap: command not found"), None);
        assert_eq!(count("Processed file [3/24]", "Processed file"), Some((3, 24)));
        let logged = "I20250701 1 feature_matching.cc:46] Matching block [2/3, 1/3]";
        assert_eq!(count(logged, "Matching block"), Some((4, 9)));
        assert_eq!(count("Matching block [0/3, 1/3]", "Matching block"), None);
        assert_eq!(count("Processed file", "Processed file"), None);
        assert_eq!(registered("Registering image #71 (12)"), Some(12));
        assert_eq!(registered("Registering image #7 (num_reg_frames=9)"), Some(9));
        assert_eq!(registered("  => Image sees 300 / 400 points"), None);
    }
}
