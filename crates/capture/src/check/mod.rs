//! Fast checks whether photographs are suitable for training: number, blur, exposure, overlap.

mod faults;
mod findings;
mod image_checks;
mod overlap;
mod photo;

pub use faults::PhotographFaults;
pub use findings::{Finding, FindingKind};
pub(super) use image_checks::ImageChecks;
pub use photo::PhotoStats;

use rayon::prelude::*;

use crate::{CaptureError, PhotosWithoutPoses};

/// The result of [`check_photographs`].
#[derive(Debug, Clone, PartialEq)]
pub struct PhotographsReport {
    /// Statistics of each readable photograph, by name.
    pub photos: Vec<PhotoStats>,
    /// Findings for the photographer, problems first.
    pub findings: Vec<Finding>,
}

impl PhotographsReport {
    /// True if training would fail.
    pub fn has_problems(&self) -> bool {
        self.findings.iter().any(Finding::is_problem)
    }
}

/// Checks every photograph at a reduced size. Blur and overlap are estimates from comparing the photographs with each
/// other.
pub fn check_photographs(photographs: &PhotosWithoutPoses) -> PhotographsReport {
    let names: Vec<&str> = photographs.photos().collect();
    let read = |name: &&str| photo::analyse(name, &photographs.read(name)?);
    let looked: Vec<Result<_, CaptureError>> = names.par_iter().map(read).collect();
    let mut unreadable = Vec::new();
    let (mut photos, mut thumbnails) = (Vec::new(), Vec::new());
    for one in looked {
        match one {
            Ok((stats, thumbnail)) => {
                photos.push(stats);
                thumbnails.push(thumbnail);
            }
            Err(error) => unreadable.push(error.to_string()),
        }
    }
    for (stats, similarity) in photos.iter_mut().zip(overlap::with_nearest(&thumbnails)) {
        stats.overlap = similarity;
    }
    let mut findings = findings::findings(&photos, &unreadable);
    findings.extend(findings::copies(&photos));
    findings.extend(findings::ignored(photographs.ignored()));
    findings.sort_by_key(|finding| finding.kind);
    PhotographsReport { photos, findings }
}
