//! Imports a folder or an archive as a [`Capture`].

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::capture::photos::{self, PhotoEntry, Split};
use crate::capture::{
    Capture, CaptureError, CaptureView, ImportOptions, Source, blender, bounds, colmap, llff, nerfstudio,
    truth,
};
use crate::formats::image_file;
use crate::formats::ply_points::Point;

/// One in this many views, by sorted name, is held out where the set names no test views.
const HOLD_OUT_EVERY: usize = 8;

/// Imports a folder, zip, tar or tar.gz, whatever supported layout it holds.
///
/// # Errors
/// [`CaptureError`] names the file and field at fault.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Capture, CaptureError> {
    read(&Source::open(path, &options.limits)?, options)
}

/// Reports what an import would find. Every file is decoded and checked as by [`import`], but images are reduced
/// to thumbnails at once, so that a capture of any size needs little memory; `options.max_side` is ignored.
///
/// # Errors
/// As [`import`], except that the limit on all pixels together cannot be reached.
pub fn inspect(path: &Path, options: &ImportOptions) -> Result<CaptureReport, CaptureError> {
    let source = Source::open(path, &options.limits)?;
    let capture = read(&source, &ImportOptions { max_side: Some(THUMBNAIL), ..*options })?;
    let mut report = capture.report();
    if let Some(view) = capture.train.first() {
        let stored = image_file::dimensions(&source.read(&view.name)?);
        (report.width, report.height) = stored.map_err(|e| CaptureError::image(&view.name, e))?;
    }
    Ok(report)
}

/// Longest side of the images that [`inspect`] keeps, pixels.
const THUMBNAIL: u32 = 64;

fn read(source: &Source, options: &ImportOptions) -> Result<Capture, CaptureError> {
    let mut warnings = Vec::new();
    let (layout, photos, points) = read_layout(source, &mut warnings)?;
    let views = photos::load(source, &photos, options)?;
    let (train, test) = split(&photos, views);
    let has_alpha = train.iter().any(|v| v.image.pixels.iter().any(|p| p[3] < 1.0));
    let bounds = bounds::bounds(&train, &points, has_alpha);
    let lights = truth::lights(source, &test, &mut warnings)?;
    let (lit_by, grey_card) = (None, None);
    Ok(Capture { layout, train, test, points, bounds, has_alpha, lights, lit_by, grey_card, warnings })
}

/// The layout's name, its photographs and its points.
pub(super) type Layout = (String, Vec<PhotoEntry>, Vec<Point>);

pub(super) fn read_layout(source: &Source, warnings: &mut Vec<String>) -> Result<Layout, CaptureError> {
    if source.contains(blender::MARKER) {
        let photos = blender::read(source, warnings)?;
        let in_own_folders = photos.iter().all(|p| p.image.contains("/rgba"));
        let layout = if in_own_folders { "tensoir" } else { "nerf-synthetic" };
        return Ok((layout.to_owned(), photos, Vec::new()));
    }
    if source.contains(nerfstudio::MARKER) {
        let (photos, points) = nerfstudio::read(source, warnings)?;
        return Ok(("nerfstudio".to_owned(), photos, points));
    }
    if let Some(files) = colmap::find(source) {
        let (photos, points) = colmap::read(source, files, warnings)?;
        return Ok(("colmap".to_owned(), photos, points));
    }
    if source.contains(llff::MARKER) {
        return Ok(("llff".to_owned(), llff::read(source, warnings)?, Vec::new()));
    }
    let first: Vec<&str> = source.paths().take(5).collect();
    let reason = if first.is_empty() {
        "there are no files".to_owned()
    } else {
        format!("the files begin with {}", first.join(", "))
    };
    Err(CaptureError::UnknownLayout { reason })
}

/// Whether some layout is there, sound or not.
pub(super) fn has_layout(source: &Source) -> bool {
    let markers = [blender::MARKER, nerfstudio::MARKER, llff::MARKER];
    markers.iter().any(|marker| source.contains(marker)) || colmap::find(source).is_some()
}

/// What each photograph is used for: as the set says, else every [`HOLD_OUT_EVERY`]th by sorted name is held out.
pub(super) fn splits(photos: &[PhotoEntry]) -> Vec<Split> {
    let mut splits: Vec<Split> = photos.iter().map(|p| p.split).collect();
    if !splits.contains(&Split::Test) {
        let mut by_name: Vec<usize> = (0..photos.len()).collect();
        by_name.sort_by(|&a, &b| photos[a].image.cmp(&photos[b].image));
        by_name.iter().step_by(HOLD_OUT_EVERY).for_each(|&i| splits[i] = Split::Test);
    }
    splits
}

/// Training and held-out views.
fn split(photos: &[PhotoEntry], views: Vec<CaptureView>) -> (Vec<CaptureView>, Vec<CaptureView>) {
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (view, split) in views.into_iter().zip(splits(photos)) {
        match split {
            Split::Train => train.push(view),
            Split::Test => test.push(view),
        }
    }
    (train, test)
}

/// What validation found in a capture.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CaptureReport {
    /// The layout that was recognised, e.g. `nerf-synthetic`, `nerfstudio`, `colmap`, `llff`.
    pub layout: String,
    /// Photographs to train on.
    pub train_images: usize,
    /// Held-out photographs.
    pub test_images: usize,
    /// Width of the first training image, pixels.
    pub width: u32,
    /// Height of the first training image, pixels.
    pub height: u32,
    /// Sparse points.
    pub points: usize,
    /// True when the alpha channel carries a mask.
    pub has_alpha: bool,
    /// True when some held-out view has ground truth beyond its photograph.
    pub has_ground_truth: bool,
    /// Lights whose maps were found.
    pub lights: Vec<String>,
    /// Centre of the region of interest, capture units.
    pub centre: [f64; 3],
    /// Radius of the region of interest, capture units.
    pub radius: f64,
    /// What a user should know but that did not stop the import, e.g. missing images by name.
    pub warnings: Vec<String>,
}

impl Capture {
    /// A summary of the capture.
    pub fn report(&self) -> CaptureReport {
        let (width, height) = self.train.first().map_or((0, 0), |v| (v.image.width, v.image.height));
        CaptureReport {
            layout: self.layout.clone(),
            train_images: self.train.len(),
            test_images: self.test.len(),
            width,
            height,
            points: self.points.len(),
            has_alpha: self.has_alpha,
            has_ground_truth: self.test.iter().any(|v| v.truth != Default::default()),
            lights: self.lights.keys().cloned().collect(),
            centre: self.bounds.centre.to_array(),
            radius: self.bounds.radius,
            warnings: self.warnings.clone(),
        }
    }
}
