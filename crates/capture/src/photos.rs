//! Loads the posed photographs that an importer has listed. All layouts share this step.

use glam::{DMat4, DVec2};
use rayon::prelude::*;

use crate::check::ImageChecks;
use crate::distortion::Distortion;
use crate::error::name_list;
use crate::images::{self, Loaded, dimensions, load_photo, photo_size};
use crate::lens::{Intrinsics, Lens};
use crate::masks::{self, MaskFile};
use crate::truth::TruthFiles;
use crate::{CaptureError, CaptureFiles, CaptureView, GroundTruthView, ImportOptions, undistort};
use relume_scene::{Camera, DisplayRange, ImageRgba, PackedImage, SCENE_PEAK};

/// A photograph an importer has found, before its pixels are read.
#[derive(Debug, Clone)]
pub(super) struct PhotoEntry {
    /// Path of the image in the capture.
    pub image: String,
    /// The file of its mask.
    pub mask: Option<MaskFile>,
    /// Camera-to-world, OpenGL axes, in the world of the [`crate::Capture`].
    pub pose: DMat4,
    /// Intrinsics.
    pub lens: Lens,
    /// Rotation of the light about +Z, degrees counter-clockwise.
    pub light_rotation_deg: f64,
    /// Name of its light group, if the capture states one.
    pub light_group: Option<String>,
    /// The file that states pose and lens, for errors.
    pub stated_in: String,
    /// The entry in that file, e.g. `frames[3]`, for errors.
    pub field: String,
    /// The set's use of the photograph.
    pub split: Split,
    /// Ground-truth layers in the same folder.
    pub truth: TruthFiles,
}

/// The use of a photograph.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Split {
    /// Training, unless the set names no test views at all.
    Train,
    /// Evaluation: the set itself holds the photograph out.
    Test,
}

/// A photograph after its pixels are read.
#[derive(Debug, Clone)]
pub(super) struct LoadedView {
    /// The view.
    pub view: CaptureView,
    /// Share of its stored pixels that are brighter than [`SCENE_PEAK`] and are limited to it, 0 to 1.
    pub limited: f64,
}

/// A warning about the photographs with pixels that are brighter than [`SCENE_PEAK`].
pub(super) fn limited_warning(photos: &[LoadedView]) -> Option<String> {
    let limited: Vec<&LoadedView> = photos.iter().filter(|photo| photo.limited > 0.0).collect();
    let most = limited.iter().map(|photo| photo.limited).fold(0.0, f64::max);
    let names: Vec<String> = limited.iter().map(|photo| photo.view.name.clone()).collect();
    (!names.is_empty()).then(|| {
        format!(
            "photographs of linear light with pixels brighter than {SCENE_PEAK}, which are limited to it: {}, at most {:.2} % of \
             the pixels of one; if that is too much, divide all photographs by the same number: {}",
            names.len(),
            100.0 * most,
            name_list(&names)
        )
    })
}

/// Loads the photographs in parallel and passes each to `image_checks`. The order of the views and the error that is
/// returned depend only on the list.
///
/// # Errors
/// The first photograph in the list whose image, mask, pose or lens is unusable.
pub(super) fn load(
    source: &CaptureFiles,
    photos: &[PhotoEntry],
    options: &ImportOptions,
    image_checks: Option<&ImageChecks>,
) -> Result<Vec<LoadedView>, CaptureError> {
    let views: Vec<_> =
        photos.par_iter().map(|photo| load_one(source, photo, options, image_checks)).collect();
    views.into_iter().collect()
}

/// The sizes to which photographs are reduced, pixels, from their headers, so that a capture that is too large for
/// memory is refused before it is decoded. A file that cannot be read has no size; decoding it returns an error with its name.
///
/// # Errors
/// [`CaptureError::OverLimit`] when the photographs together have more pixels than are allowed.
pub(super) fn sizes(
    source: &CaptureFiles,
    photos: &[PhotoEntry],
    options: &ImportOptions,
) -> Result<Vec<(u32, u32)>, CaptureError> {
    let size = |photo: &PhotoEntry| Some(options.reduced_size(dimensions(source, &photo.image).ok()?));
    let sizes: Vec<(u32, u32)> = photos.par_iter().filter_map(size).collect();
    let total: u64 = sizes.iter().map(|(w, h)| u64::from(*w) * u64::from(*h)).sum();
    let limit = options.limits.max_total_pixels;
    if total > limit {
        let reason = format!("{total} pixels in total, {limit} allowed; reduce the resolution");
        return Err(CaptureError::over_limit(source.label(), "max_total_pixels", reason));
    }
    Ok(sizes)
}

fn load_one(
    source: &CaptureFiles,
    photo: &PhotoEntry,
    options: &ImportOptions,
    image_checks: Option<&ImageChecks>,
) -> Result<LoadedView, CaptureError> {
    let Loaded { mut image, stored, depth, light, .. } = match image_checks {
        None => load_photo(source, &photo.image, photo.lens.approximate_size(), options)?,
        Some(image_checks) => load_and_check(source, photo, options, image_checks)?,
    };
    if let Some(mask) = &photo.mask {
        masks::apply(source, mask, stored, &mut image, options)?;
    }
    if let Some(matrix) = &options.colour_matrix {
        matrix.apply_to_image(&mut image, light.range);
    }
    let (camera, image) = undistorted(photo, stored, image)?;
    let image = match light.range {
        DisplayRange::Unit => PackedImage::new(&image, depth),
        DisplayRange::Extended => PackedImage::scene_referred(&image),
    };
    let truth = if options.load_truth {
        photo.truth.load(source, (image.width, image.height), options)?
    } else {
        GroundTruthView::default()
    };
    let view = CaptureView {
        name: photo.image.clone(),
        camera,
        image,
        light_rotation_deg: photo.light_rotation_deg,
        light_group: photo.light_group.clone(),
        truth,
    };
    Ok(LoadedView { view, limited: light.limited })
}

/// [`load_photo`] that first loads an image large enough for `image_checks`, then reduces it.
fn load_and_check(
    source: &CaptureFiles,
    photo: &PhotoEntry,
    options: &ImportOptions,
    image_checks: &ImageChecks,
) -> Result<Loaded, CaptureError> {
    let side = options.max_side.map_or(ImageChecks::SIDE, |side| side.max(ImageChecks::SIDE));
    let larger = ImportOptions { max_side: Some(side), ..*options };
    let loaded = load_photo(source, &photo.image, photo.lens.approximate_size(), &larger)?;
    image_checks.add(&photo.image, &loaded);
    let (width, height) = options.reduced_size(loaded.stored);
    Ok(Loaded { image: loaded.image.resized(width, height), ..loaded })
}

/// The photograph without its mask file, colours clamped to [0, 1]; `straight` removes the lens distortion.
///
/// # Errors
/// Names the image, or the file and field of an unusable pose or lens.
pub(super) fn picture(
    source: &CaptureFiles,
    photo: &PhotoEntry,
    options: &ImportOptions,
    straight: bool,
) -> Result<ImageRgba, CaptureError> {
    let Loaded { image, stored, light, .. } =
        load_photo(source, &photo.image, photo.lens.approximate_size(), options)?;
    let image = images::shown(image, light.range);
    if straight { Ok(undistorted(photo, stored, image)?.1) } else { Ok(image) }
}

/// An image of a photograph of `stored` pixels with the lens distortion removed, and its camera.
fn undistorted(
    photo: &PhotoEntry,
    stored: (u32, u32),
    image: ImageRgba,
) -> Result<(Camera, ImageRgba), CaptureError> {
    let intrinsics = intrinsics(photo, stored)?;
    let camera = camera(photo, intrinsics, stored)?.resized(image.width, image.height);
    match photo.lens.distortion {
        Distortion::None => Ok((camera, image)),
        distortion => {
            undistort::undistort(&camera, &distortion, &image).map_err(|reason| bent(photo, reason))
        }
    }
}

/// The camera of a photograph at its stored size, distortion removed. Only the header of the image is read.
///
/// # Errors
/// Names the image, or the file and field of an unusable pose or lens.
pub(super) fn stored_camera(source: &CaptureFiles, photo: &PhotoEntry) -> Result<Camera, CaptureError> {
    camera_at(photo, photo_size(source, &photo.image, photo.lens.approximate_size())?)
}

/// The camera of a photograph of `stored` pixels, distortion removed.
///
/// # Errors
/// Names the file and field of an unusable pose or lens.
pub(super) fn camera_at(photo: &PhotoEntry, stored: (u32, u32)) -> Result<Camera, CaptureError> {
    let camera = camera(photo, intrinsics(photo, stored)?, stored)?;
    match photo.lens.distortion {
        Distortion::None => Ok(camera),
        distortion => undistort::pinhole(&camera, &distortion).map_err(|reason| bent(photo, reason)),
    }
}

/// The camera of a photograph of `stored` pixels, distortion removed, and the positions in its picture of `points` of the stored photograph,
/// pixels; `None` for a point that the lens cannot image.
///
/// # Errors
/// Names the file and field of an unusable pose or lens.
pub(super) fn straightened<const N: usize>(
    photo: &PhotoEntry,
    stored: (u32, u32),
    points: [DVec2; N],
) -> Result<(Camera, [Option<DVec2>; N]), CaptureError> {
    let distorted = camera(photo, intrinsics(photo, stored)?, stored)?;
    let straight = camera_at(photo, stored)?;
    let moved = points.map(|point| {
        let x = (point.x - distorted.cx) / distorted.fx;
        let y = (point.y - distorted.cy) / distorted.fy;
        let p = photo.lens.distortion.undistort(DVec2::new(x, y))?;
        Some(DVec2::new(straight.fx * p.x + straight.cx, straight.fy * p.y + straight.cy))
    });
    Ok((straight, moved))
}

/// The intrinsics at the stored size. An error also names the photograph.
fn intrinsics(photo: &PhotoEntry, stored: (u32, u32)) -> Result<Intrinsics, CaptureError> {
    photo.lens.resolve(&photo.stated_in, stored).map_err(|error| match error {
        CaptureError::Field { file, field, reason } => {
            CaptureError::Field { file, field, reason: format!("{reason} ({})", photo.image) }
        }
        other => other,
    })
}

/// The error for a lens that cannot be converted to a pinhole.
fn bent(photo: &PhotoEntry, reason: String) -> CaptureError {
    CaptureError::at_field(&photo.stated_in, format!("{}.k1", photo.field), reason)
}

fn camera(photo: &PhotoEntry, intrinsics: Intrinsics, stored: (u32, u32)) -> Result<Camera, CaptureError> {
    let camera = Camera::from_opengl(&photo.pose, stored, intrinsics.focal, intrinsics.centre);
    camera.map_err(|error| {
        CaptureError::at_field(&photo.stated_in, format!("{}.{}", photo.field, error.field), error.reason)
    })
}
