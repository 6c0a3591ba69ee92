//! Errors of pose estimation.

use std::path::{Path, PathBuf};

use crate::CaptureError;

/// Errors of pose estimation and of the extraction of frames from a clip.
#[derive(Debug, thiserror::Error)]
pub enum PoseError {
    /// The program is not on PATH.
    #[error("`{program}` is not installed (it is not on PATH): {install}")]
    NotInstalled {
        /// Name of the program.
        program: String,
        /// How to install it.
        install: &'static str,
    },
    /// The program is too old, or does not report a version.
    #[error("`{program}` has version {found}; at least {least} is required: {install}")]
    TooOld {
        /// Name of the program.
        program: String,
        /// The version that it reports.
        found: String,
        /// The oldest supported version.
        least: &'static str,
        /// How to install another version.
        install: &'static str,
    },
    /// The program exited with an error.
    #[error("`{program}` failed ({status}); last lines of {log}:\n{end}", log = .log.display())]
    Failed {
        /// Name of the program and its command.
        program: String,
        /// Exit status as the operating system describes it.
        status: String,
        /// Last lines of the log.
        end: String,
        /// Path of the log.
        log: PathBuf,
    },
    /// The time limit was reached.
    #[error("`{program}` was stopped at the limit of {minutes} minutes; the log is {log}", log = .log.display())]
    TimedOut {
        /// Name of the program and its command.
        program: String,
        /// The limit on all stages together, minutes.
        minutes: u64,
        /// Path of the log.
        log: PathBuf,
    },
    /// The caller cancelled the work.
    #[error("cancelled")]
    Cancelled,
    /// COLMAP found poses for too few photographs.
    #[error(
        "COLMAP placed {placed} of {photographs} photographs; at least 3, and half of them, are required: take sharp, evenly lit \
         photographs of textured objects with more overlap; the log is {log}",
        log = .log.display()
    )]
    TooFewPlaced {
        /// Photographs with a pose.
        placed: usize,
        /// Number of photographs.
        photographs: usize,
        /// Path of COLMAP's log.
        log: PathBuf,
    },
    /// The folder for the result contains other photographs.
    #[error("{folder}: contains the poses of other photographs; remove it or choose another folder", folder = .0.display())]
    FolderNotEmpty(PathBuf),
    /// A file could not be read or written.
    #[error("{file}: {source}", file = .file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A photograph or a file from COLMAP cannot be used.
    #[error(transparent)]
    Capture(#[from] CaptureError),
}

impl PoseError {
    /// Wraps an error of the file system with its path.
    pub(super) fn io(file: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| Self::Io { file: file.to_owned(), source }
    }
}
