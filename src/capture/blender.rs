//! NeRF-synthetic and TensoIR-Synthetic: `transforms_{train,val,test}.json`, RGBA images, perhaps truth.

use crate::capture::photos::{Photo, check_missing, locate};
use crate::capture::transforms::{self, Transforms};
use crate::capture::truth::{TruthFiles, albedo_is_srgb};
use crate::capture::{CaptureError, Source};

/// The file that tells this layout.
pub(super) const MARKER: &str = "transforms_train.json";

/// The photographs of the set; `transforms_test.json`, or else `transforms_val.json`, is held out.
///
/// # Errors
/// Names the JSON file and field, or counts the images when too few are there.
pub(super) fn read(source: &Source, warnings: &mut Vec<String>) -> Result<Vec<Photo>, CaptureError> {
    let albedo_is_srgb = albedo_is_srgb(source)?;
    let mut photos = Vec::new();
    let mut missing = Vec::new();
    let train = transforms::read(source, MARKER)?;
    collect(source, &train, false, albedo_is_srgb, &mut photos, &mut missing);
    check_missing(MARKER, photos.len(), missing, warnings)?;
    let held_out = ["transforms_test.json", "transforms_val.json"].into_iter().find(|f| source.contains(f));
    if let Some(file) = held_out {
        let test = transforms::read(source, file)?;
        let mut missing = Vec::new();
        collect(source, &test, true, albedo_is_srgb, &mut photos, &mut missing);
        check_missing(file, photos.len(), missing, warnings)?;
    }
    Ok(photos)
}

fn collect(
    source: &Source,
    set: &Transforms,
    held_out: bool,
    albedo_is_srgb: bool,
    photos: &mut Vec<Photo>,
    missing: &mut Vec<String>,
) {
    for frame in &set.frames {
        let Some(image) = locate(source, &frame.path) else {
            missing.push(frame.path.clone());
            continue;
        };
        let truth =
            if held_out { TruthFiles::beside(source, &image, albedo_is_srgb) } else { TruthFiles::default() };
        photos.push(Photo {
            image,
            mask: None,
            pose: frame.pose,
            lens: frame.lens,
            stated_in: set.file.clone(),
            field: frame.field.clone(),
            held_out,
            truth,
        });
    }
}
