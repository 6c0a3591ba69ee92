//! NeRF-synthetic and TensoIR-Synthetic: `transforms_{train,val,test}.json`, RGBA images, optional ground truth.

use relume_spec::training::UpAxis;

use crate::photo_finder::PhotoFinder;
use crate::photos::{PhotoEntry, Split};
use crate::transforms::{self, Transforms};
use crate::truth::{AlbedoEncoding, TruthFiles, albedo_encoding};
use crate::upright::{self, StatedUp, upright};
use crate::{CaptureError, CaptureFiles, Up, WorldUp, layout};

/// The file that marks this layout.
pub(super) const MARKER: &str = "transforms_train.json";

/// The photographs of the set whose training file is `marker`; `transforms_test.json`, or else `transforms_val.json`, is held out.
///
/// # Errors
/// Names the JSON file and field, or counts the images when too few are there.
pub(super) fn read(
    source: &CaptureFiles,
    marker: &str,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<(Vec<PhotoEntry>, WorldUp), CaptureError> {
    let folder = layout::folder_of(marker);
    let albedo = albedo_encoding(source, &folder)?;
    let mut photos = Vec::new();
    let train = transforms::read(source, marker)?;
    let finder = collect(source, &train, Split::Train, albedo, &mut photos);
    finder.finish(marker, photos.len(), warnings)?;
    let held_out = ["transforms_test.json", "transforms_val.json"].map(|name| format!("{folder}{name}"));
    if let Some(file) = held_out.iter().find(|file| source.contains(file)) {
        let test = transforms::read(source, file)?;
        let finder = collect(source, &test, Split::Test, albedo, &mut photos);
        finder.finish(file, photos.len(), warnings)?;
    }
    let has_truth = photos.iter().any(|photo| photo.image.contains("/rgba"));
    if has_truth {
        if ![Up::AUTO, Up::MEAN, UpAxis::Z.into()].contains(&up) {
            let reason = "has ground truth, whose normals have +Z up; `up` must be auto or z".to_owned();
            return Err(CaptureError::File { file: marker.to_owned(), reason });
        }
        return Ok((photos, WorldUp::default()));
    }
    let poses: Vec<_> = photos.iter().map(|photo| photo.pose).collect();
    let world = upright(&poses, &[], up, StatedUp::PlusZ, warnings);
    upright::rotate(world.rotation(), &mut photos, &mut []);
    Ok((photos, world))
}

/// Adds a file's photographs; returns the finder that knows which are missing.
fn collect<'a>(
    source: &'a CaptureFiles,
    set: &Transforms,
    split: Split,
    albedo: AlbedoEncoding,
    photos: &mut Vec<PhotoEntry>,
) -> PhotoFinder<'a> {
    let mut finder =
        PhotoFinder::new(source, vec![layout::folder_of(&set.file), String::new()]).with_same_folders();
    let images = finder.find_all(&set.frames.iter().map(|frame| frame.path.as_str()).collect::<Vec<_>>());
    for (frame, image) in set.frames.iter().zip(images) {
        let Some(image) = image else { continue };
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
            light_group: frame.light_group.clone(),
            stated_in: set.file.clone(),
            field: frame.field.clone(),
            split,
            truth,
        });
    }
    finder
}
