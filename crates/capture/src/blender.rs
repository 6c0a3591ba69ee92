//! NeRF-synthetic and TensoIR-Synthetic: `transforms_{train,val,test}.json`, RGBA images, optional ground truth.

use crate::photos::{PhotoEntry, Split, check_missing, locate};
use crate::transforms::{self, Transforms};
use crate::truth::{AlbedoEncoding, TruthFiles, albedo_encoding};
use crate::{CaptureError, CaptureFiles};

/// The file that marks this layout.
pub(super) const MARKER: &str = "transforms_train.json";

/// The photographs of the set; `transforms_test.json`, or else `transforms_val.json`, is held out.
///
/// # Errors
/// Names the JSON file and field, or counts the images when too few are there.
pub(super) fn read(
    source: &CaptureFiles,
    warnings: &mut Vec<String>,
) -> Result<Vec<PhotoEntry>, CaptureError> {
    let albedo = albedo_encoding(source)?;
    let mut photos = Vec::new();
    let train = transforms::read(source, MARKER)?;
    let missing = collect(source, &train, Split::Train, albedo, &mut photos);
    check_missing(MARKER, photos.len(), missing, warnings)?;
    let held_out = ["transforms_test.json", "transforms_val.json"].into_iter().find(|f| source.contains(f));
    if let Some(file) = held_out {
        let test = transforms::read(source, file)?;
        let missing = collect(source, &test, Split::Test, albedo, &mut photos);
        check_missing(file, photos.len(), missing, warnings)?;
    }
    Ok(photos)
}

/// Adds a file's photographs; returns the paths of those that are missing.
fn collect(
    source: &CaptureFiles,
    set: &Transforms,
    split: Split,
    albedo: AlbedoEncoding,
    photos: &mut Vec<PhotoEntry>,
) -> Vec<String> {
    let mut missing = Vec::new();
    for frame in &set.frames {
        let Some(image) = locate(source, &frame.path) else {
            missing.push(frame.path.clone());
            continue;
        };
        let truth = match split {
            Split::Train => TruthFiles::default(),
            Split::Test => TruthFiles::beside(source, &image, albedo),
        };
        photos.push(PhotoEntry {
            image,
            mask: None,
            pose: frame.pose,
            lens: frame.lens,
            light_rotation_deg: frame.light_rotation_deg,
            stated_in: set.file.clone(),
            field: frame.field.clone(),
            split,
            truth,
        });
    }
    missing
}
