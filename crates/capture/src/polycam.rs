//! Polycam's raw data: `keyframes/cameras` has a JSON file of pose and intrinsics for each photograph in `keyframes/images`.

use glam::{DMat4, DVec4};

use crate::json::parse_json;
use crate::json_fields::Fields;
use crate::photo_finder::PhotoFinder;
use crate::photos::{PhotoEntry, Split};
use crate::stated_lens::StatedLens;
use crate::truth::TruthFiles;
use crate::upright::{self, StatedUp, upright};
use crate::{CaptureError, CaptureFiles, Up, WorldUp};

/// Folders of cameras and of their photographs; the first pair that is there is used. The corrected ones exist if Polycam closed
/// the loops of the camera's path.
const FOLDERS: [(&str, &str); 2] = [("corrected_cameras", "corrected_images"), ("cameras", "images")];

/// The folders of a Polycam capture, each with `/` at its end.
pub(super) struct PolycamFolders {
    cameras: String,
    images: String,
}

/// Largest size of a JSON file, bytes.
const MAX_BYTES: usize = 1 << 16;

/// Finds the folders of a Polycam capture: beside each other, with a JSON file of a pose in the first.
pub(super) fn find(source: &CaptureFiles) -> Option<PolycamFolders> {
    let files =
        || source.paths().filter(|path| path.ends_with(".json")).filter_map(|path| path.rsplit_once('/'));
    FOLDERS.iter().find_map(|(cameras, images)| {
        files().find_map(|(folder, name)| {
            let root = folder.strip_suffix(cameras).filter(|root| root.is_empty() || root.ends_with('/'))?;
            let images = format!("{root}{images}");
            let has_images = || source.paths_under(&images).next().is_some();
            let start =
                || source.read_start(&format!("{folder}/{name}"), MAX_BYTES as u64).unwrap_or_default();
            let has_pose = || start().windows(6).any(|text| text == b"\"t_00\"");
            (has_images() && has_pose())
                .then(|| PolycamFolders { cameras: format!("{folder}/"), images: format!("{images}/") })
        })
    })
}

/// The photographs. Polycam's world has +Y up; it is rotated to +Z.
///
/// # Errors
/// Names the JSON file and the field at fault, or counts the photographs if too few are there.
pub(super) fn read(
    source: &CaptureFiles,
    folders: &PolycamFolders,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<(Vec<PhotoEntry>, WorldUp), CaptureError> {
    let mut finder = PhotoFinder::new(source, vec![folders.images.clone()]);
    let mut photos = Vec::new();
    let files = source.paths_under(folders.cameras.trim_end_matches('/'));
    let files: Vec<&str> = files.filter(|path| path.ends_with(".json")).collect();
    let names: Vec<&str> =
        files.iter().map(|file| file[folders.cameras.len()..].trim_end_matches(".json")).collect();
    for (file, image) in files.into_iter().zip(finder.find_all(&names)) {
        let Some(image) = image else { continue };
        let bytes = source.read_start(file, MAX_BYTES as u64 + 1)?;
        if bytes.len() > MAX_BYTES {
            let reason = format!("has more than {MAX_BYTES} bytes");
            return Err(CaptureError::File { file: file.to_owned(), reason });
        }
        let value = parse_json(file, &bytes)?;
        let fields = Fields::new(file, "", &value)?;
        let lens = StatedLens::read(&fields)?.lens().map_err(|(name, reason)| fields.error(name, reason))?;
        photos.push(PhotoEntry {
            image,
            mask: None,
            pose: pose(&fields)?,
            lens,
            light_rotation_deg: 0.0,
            light_group: None,
            stated_in: file.to_owned(),
            field: "camera".to_owned(),
            split: Split::Train,
            truth: TruthFiles::default(),
        });
    }
    finder.finish(&folders.cameras, photos.len(), warnings)?;
    let poses: Vec<_> = photos.iter().map(|photo| photo.pose).collect();
    // The phone knows the direction of gravity, so the cameras' up directions are not needed.
    let world = upright(&poses, &[], up, StatedUp::PlusZ, &mut Vec::new());
    upright::rotate(world.rotation(), &mut photos, &mut []);
    Ok((photos, world))
}

/// Camera-to-world, OpenGL axes, from the fields `t_00` to `t_23`. The rows are permuted so that +Y becomes +Z.
fn pose(fields: &Fields<'_>) -> Result<DMat4, CaptureError> {
    let row = |i: usize| -> Result<DVec4, CaptureError> {
        let mut row = [0.0; 4];
        for (j, value) in row.iter_mut().enumerate() {
            let name = format!("t_{i}{j}");
            *value = fields.number(&name)?.ok_or_else(|| fields.error(&name, "is missing"))?;
        }
        Ok(DVec4::from(row))
    };
    Ok(DMat4::from_cols(row(2)?, row(0)?, row(1)?, DVec4::W).transpose())
}
