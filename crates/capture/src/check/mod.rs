//! Whether photographs are fit to be trained on, found out in seconds: number, blur, exposure, overlap.

mod findings;
mod image_checks;
mod overlap;
mod photo;

pub use findings::Finding;
pub(super) use image_checks::ImageChecks;
pub use photo::PhotoStats;

use rayon::prelude::*;

use crate::{CaptureError, PhotosWithoutPoses};

/// What was found in photographs.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotographsReport {
    /// Each photograph that can be read, by name.
    pub photos: Vec<PhotoStats>,
    /// What a photographer should know, problems first.
    pub findings: Vec<Finding>,
}

impl PhotographsReport {
    /// True where a training would be in vain.
    pub fn has_problems(&self) -> bool {
        self.findings.iter().any(|finding| finding.is_problem)
    }
}

/// Looks at every photograph, reduced. Blur and overlap are estimates: each photograph is compared with the others.
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
    let findings = findings::findings(&photos, &unreadable);
    PhotographsReport { photos, findings }
}
