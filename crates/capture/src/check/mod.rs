//! Whether photographs are fit to be trained on, found out in seconds: number, blur, exposure, overlap.

mod findings;
mod looks;
mod overlap;
mod photo;

pub use findings::Finding;
pub(super) use looks::Looks;
pub use photo::PhotoFacts;

use rayon::prelude::*;

use crate::{CaptureError, Unposed};

/// What was found in photographs.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotographsReport {
    /// Each photograph that can be read, by name.
    pub photos: Vec<PhotoFacts>,
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
pub fn check_photographs(photographs: &Unposed) -> PhotographsReport {
    let names: Vec<&str> = photographs.photos().collect();
    let read = |name: &&str| photo::look_at(name, &photographs.read(name)?);
    let looked: Vec<Result<_, CaptureError>> = names.par_iter().map(read).collect();
    let mut unreadable = Vec::new();
    let (mut photos, mut thumbnails) = (Vec::new(), Vec::new());
    for one in looked {
        match one {
            Ok((facts, thumbnail)) => {
                photos.push(facts);
                thumbnails.push(thumbnail);
            }
            Err(error) => unreadable.push(error.to_string()),
        }
    }
    for (facts, similarity) in photos.iter_mut().zip(overlap::with_nearest(&thumbnails)) {
        facts.overlap = similarity;
    }
    let findings = findings::findings(&photos, &unreadable);
    PhotographsReport { photos, findings }
}
