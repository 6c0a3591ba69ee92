//! Why photographs got no poses.

use std::path::{Path, PathBuf};

use crate::CaptureError;

/// Why photographs got no poses, or a clip no photographs.
#[derive(Debug, thiserror::Error)]
pub enum PoseError {
    /// The program is not on PATH.
    #[error("`{program}` is not installed (it is not on PATH): {install}")]
    NotInstalled {
        /// Its name.
        program: String,
        /// How to get it.
        install: &'static str,
    },
    /// The program is too old, or tells no version.
    #[error("`{program}` is of version {found}; at least {least} is needed: {install}")]
    TooOld {
        /// Its name.
        program: String,
        /// Its version, as it says.
        found: String,
        /// The oldest that is known to do.
        least: &'static str,
        /// How to get another.
        install: &'static str,
    },
    /// The program ended with an error.
    #[error("`{program}` failed ({status}); the end of {log}:\n{end}", log = .log.display())]
    Failed {
        /// Its name and what it did.
        program: String,
        /// Its exit status, as the system says it.
        status: String,
        /// The last lines of its log.
        end: String,
        /// Its log.
        log: PathBuf,
    },
    /// The limit on time was reached.
    #[error("`{program}` was stopped: the limit of {minutes} minutes was reached; its log is {log}", log = .log.display())]
    TimedOut {
        /// Its name and what it did.
        program: String,
        /// The limit on all stages together.
        minutes: u64,
        /// Its log.
        log: PathBuf,
    },
    /// The caller does not want the result any more.
    #[error("cancelled")]
    Cancelled,
    /// Too few photographs show a part of what others show.
    #[error(
        "COLMAP placed {placed} of {photographs} photographs, fewer than half: take them with more overlap, sharp and evenly lit, \
         of things with texture; its log is {log}",
        log = .log.display()
    )]
    TooFewPlaced {
        /// Photographs with a pose.
        placed: usize,
        /// Photographs in all.
        photographs: usize,
        /// COLMAP's log.
        log: PathBuf,
    },
    /// The folder for the result holds something else.
    #[error("{folder}: holds the poses of other photographs; remove it or name another folder", folder = .0.display())]
    FolderNotEmpty(PathBuf),
    /// A file could not be read or written.
    #[error("{file}: {source}", file = .file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A photograph or a file of COLMAP's cannot be used.
    #[error(transparent)]
    Capture(#[from] CaptureError),
}

impl PoseError {
    /// Wraps an error of the file system with its path.
    pub(super) fn io(file: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| Self::Io { file: file.to_owned(), source }
    }
}
