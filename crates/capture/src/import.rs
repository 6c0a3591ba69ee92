//! Imports a folder or an archive as a [`Capture`].

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::DVec3;

use crate::check::{Finding, FindingKind, ImageChecks};
use crate::formats::ply_points::Point;
use crate::layout::{self, FoundLayout};
use crate::photos::{self, LoadedView, PhotoEntry, Split};
use crate::text::printable;
use crate::{
    Capture, CaptureError, CaptureFiles, CaptureView, ImportOptions, PhotoCamera, Up, WorldUp, blender,
    bounds, cameras, colmap, identical, images, llff, masks, nerfstudio, polycam, rig, selection, truth,
    turntable,
};
use relume_spec::{CaptureReport, NoteKind, PhotographNote};

/// One in this many views, by sorted name, is held out where the set names no test views.
const HOLD_OUT_EVERY: usize = 8;

/// Imports a folder, zip, tar or tar.gz with any supported layout.
///
/// # Errors
/// [`CaptureError`] names the file and field at fault.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Capture, CaptureError> {
    UndecodedCapture::open(path, options)?.decode()
}

/// A capture whose photographs are located but not decoded.
#[derive(Debug)]
pub struct UndecodedCapture {
    source: CaptureFiles,
    options: ImportOptions,
    layout: Layout,
    warnings: Vec<String>,
    sizes: Vec<(u32, u32)>,
    /// Photographs that are already decoded, by index.
    decoded: BTreeMap<usize, LoadedView>,
}

impl UndecodedCapture {
    /// Reads poses and the headers of all photographs.
    ///
    /// # Errors
    /// As [`import`].
    pub fn open(path: &Path, options: &ImportOptions) -> Result<Self, CaptureError> {
        let source = CaptureFiles::open(path, &options.limits)?;
        let mut warnings = Vec::new();
        let mut layout = read_layout(&source, options.up, &mut warnings)?;
        rig::check(&layout.photos, &layout.points, &mut warnings)?;
        masks::find(&source, &mut layout.photos, &mut warnings);
        let sizes = photos::sizes(&source, &layout.photos, options)?;
        Ok(Self { source, options: *options, layout, warnings, sizes, decoded: BTreeMap::new() })
    }

    /// Widths and heights of the photographs after reduction, pixels, including held-out ones. Photographs that
    /// cannot be read are left out.
    pub fn sizes(&self) -> &[(u32, u32)] {
        &self.sizes
    }

    /// Leaves out all photographs except those with these names. [`Self::decode`] chooses the held-out views from the
    /// remaining ones if the capture itself names none.
    ///
    /// # Errors
    /// [`CaptureError::OverLimit`] as [`Self::open`].
    pub fn retain(&mut self, names: &BTreeSet<&str>) -> Result<(), CaptureError> {
        self.layout.photos.retain(|photo| names.contains(photo.image.as_str()));
        self.decoded.clear();
        self.sizes = photos::sizes(&self.source, &self.layout.photos, &self.options)?;
        Ok(())
    }

    /// The cameras of the photographs at their stored size, in the order of the layout.
    ///
    /// # Errors
    /// As [`import`].
    pub fn cameras(&self) -> Result<Vec<PhotoCamera>, CaptureError> {
        cameras::of_photos(&self.source, &self.layout.photos)
    }

    /// Positions of the sparse points.
    pub fn points(&self) -> impl Iterator<Item = DVec3> {
        self.layout.points.iter().map(|(position, _)| *position)
    }

    /// The direction in the files that became +Z.
    pub fn up(&self) -> &WorldUp {
        &self.layout.up
    }

    /// How many photographs are held out.
    pub fn held_out(&self) -> usize {
        splits(&self.layout.photos).iter().filter(|split| **split == Split::Test).count()
    }

    /// Least number of bytes of memory for a pixel with its mask, over the first, the middle and the last photograph;
    /// 0 without photographs. [`Self::decode`] does not decode these photographs again.
    ///
    /// # Errors
    /// As [`import`], of those photographs.
    pub fn bytes_a_pixel(&mut self) -> Result<f64, CaptureError> {
        let photos = &self.layout.photos;
        let chosen: BTreeSet<usize> =
            (0..photos.len()).step_by((photos.len() / 2).max(1)).chain(photos.len().checked_sub(1)).collect();
        let entries: Vec<_> = chosen.iter().map(|i| photos[*i].clone()).collect();
        let views = photos::load(&self.source, &entries, &self.options, None)?;
        self.decoded = chosen.into_iter().zip(views).collect();
        let bytes_of =
            |LoadedView { view, .. }: &LoadedView| view.image.bytes() as f64 / view.image.len().max(1) as f64;
        Ok(self.decoded.values().map(bytes_of).reduce(f64::min).unwrap_or(0.0))
    }

    /// Decodes the photographs.
    ///
    /// # Errors
    /// As [`import`].
    pub fn decode(self) -> Result<Capture, CaptureError> {
        Ok(self.decode_and_check(None)?.0)
    }

    /// Decodes the photographs and passes each to `image_checks`. Also returns the files that they came from.
    fn decode_and_check(
        self,
        image_checks: Option<&ImageChecks>,
    ) -> Result<(Capture, CaptureFiles), CaptureError> {
        let Self { source, options, layout, mut warnings, mut decoded, .. } = self;
        let Layout { name: layout, photos, mut points, up } = layout;
        let missing = photos.iter().enumerate().filter(|(i, _)| !decoded.contains_key(i));
        let missing: Vec<PhotoEntry> = missing.map(|(_, photo)| photo.clone()).collect();
        let mut loaded = photos::load(&source, &missing, &options, image_checks)?.into_iter();
        let views: Vec<_> =
            (0..photos.len()).filter_map(|i| decoded.remove(&i).or_else(|| loaded.next())).collect();
        warnings.extend(photos::limited_warning(&views));
        let views: Vec<_> = views.into_iter().map(|loaded| loaded.view).collect();
        warnings.extend(masks::check(&views)?);
        warnings.extend(identical::check(&views, &splits(&photos)));
        let (mut train, mut test) = split(&photos, views);
        let turntable = turntable::derive_rotations(
            &mut train.iter_mut().chain(&mut test).collect::<Vec<_>>(),
            options.turntable,
        )?;
        let has_alpha = train.iter().any(|v| !v.image.is_opaque());
        let bounds = bounds::bounds(&train, &points, has_alpha);
        let lights = truth::lights(&source, &test, &mut warnings)?;
        if let Some(matrix) = &options.colour_matrix {
            points.iter_mut().for_each(|(_, colour)| *colour = matrix.apply(*colour));
        }
        let (measured_light, grey_card, colour_chart) = (None, None, None);
        let capture = Capture {
            layout,
            train,
            test,
            points,
            bounds,
            has_alpha,
            lights,
            measured_light,
            grey_card,
            colour_chart,
            up,
            turntable,
            warnings,
        };
        Ok((capture, source))
    }
}

/// Reports what an import would find. Every file is decoded and checked as by [`import`], but images are reduced to
/// thumbnails at once, so a capture of any size needs little memory; `options.max_side` is ignored.
///
/// # Errors
/// As [`import`], except that the limit on all pixels together cannot be reached.
pub fn inspect(path: &Path, options: &ImportOptions) -> Result<CaptureReport, CaptureError> {
    let image_checks = ImageChecks::default();
    let undecoded = UndecodedCapture::open(path, &ImportOptions { max_side: Some(THUMBNAIL), ..*options })?;
    let lenses: BTreeMap<String, _> = undecoded
        .layout
        .photos
        .iter()
        .map(|photo| (photo.image.clone(), photo.lens.approximate_size()))
        .collect();
    let (capture, source) = undecoded.decode_and_check(Some(&image_checks))?;
    let mut report = capture.report();
    let noted = |finding: Finding| PhotographNote {
        kind: if finding.kind == FindingKind::Note { NoteKind::Fact } else { NoteKind::Hint },
        text: printable(&finding.text),
        photographs: finding.photos,
    };
    report.notes.extend(image_checks.findings().into_iter().map(noted));
    if let Some(view) = capture.train.first() {
        let lens_size = lenses.get(&view.name).copied().flatten();
        (report.width, report.height) = images::photo_size(&source, &view.name, lens_size)?;
    }
    Ok(report)
}

/// Longest side of the images that [`inspect`] keeps, pixels.
const THUMBNAIL: u32 = 64;

/// The contents of a capture before its photographs are decoded.
#[derive(Debug)]
pub(super) struct Layout {
    /// Name of the layout.
    pub name: String,
    pub photos: Vec<PhotoEntry>,
    /// Sparse points; none in most layouts.
    pub points: Vec<Point>,
    /// The direction in the files that became +Z.
    pub up: WorldUp,
}

/// Reads the poses of any layout. Each photograph occurs once.
pub(super) fn read_layout(
    source: &CaptureFiles,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<Layout, CaptureError> {
    let mut layout = read_any_layout(source, up, warnings)?;
    rig::remove_repeated(&mut layout.photos, warnings)?;
    Ok(layout)
}

fn read_any_layout(
    source: &CaptureFiles,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<Layout, CaptureError> {
    let Some(found) = layout::find(source)? else {
        return Err(unknown_layout(source)?);
    };
    let no_points = |(photos, up)| (photos, Vec::new(), up);
    let (name, (photos, points, up)) = match found {
        FoundLayout::Blender(marker) => {
            let (photos, up) = blender::read(source, &marker, up, warnings)?;
            let in_own_folders = photos.iter().all(|p| p.image.contains("/rgba"));
            (if in_own_folders { "tensoir" } else { "nerf-synthetic" }, (photos, Vec::new(), up))
        }
        FoundLayout::Nerfstudio(marker) => ("nerfstudio", nerfstudio::read(source, &marker, up, warnings)?),
        FoundLayout::Colmap(files) => ("colmap", colmap::read(source, &files, up, warnings)?),
        FoundLayout::Llff(marker) => ("llff", no_points(llff::read(source, &marker, up, warnings)?)),
        FoundLayout::Polycam(folders) => {
            ("polycam", no_points(polycam::read(source, &folders, up, warnings)?))
        }
    };
    Ok(Layout { name: name.to_owned(), photos, points, up })
}

/// The error for files without a known layout.
///
/// # Errors
/// [`CaptureError::File`] if the only images are camera raw files, and the errors of reading the files.
fn unknown_layout(source: &CaptureFiles) -> Result<CaptureError, CaptureError> {
    let has_photographs = !selection::select(source)?.photos.is_empty();
    if !has_photographs {
        selection::refuse_raw_files(source)?;
    }
    let first: Vec<&str> = source.paths().take(5).collect();
    let (capture, names) = (source.label(), first.join(", "));
    let reason = match (first.is_empty(), has_photographs) {
        (true, _) => format!("{capture} has no files"),
        (false, false) => format!("{capture} has no photographs; its first files are {names}"),
        (false, true) => format!("the first files of {capture} are {names}"),
    };
    Ok(CaptureError::UnknownLayout { reason, has_photographs })
}

/// The use of each photograph: as the set states, else every [`HOLD_OUT_EVERY`]th by sorted name is held out.
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

impl Capture {
    /// What the capture states or the importer derived from its evidence, in words: the up direction, the rotations of the light, and the light
    /// groups.
    pub fn facts(&self) -> impl Iterator<Item = String> {
        self.up.note.clone().into_iter().chain(self.turntable.clone()).chain(self.light_groups_in_words())
    }

    /// A summary of the capture. Its only notes are [`Self::facts`].
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
            lights: self.lights.keys().map(|name| printable(name)).collect(),
            centre: self.bounds.centre.to_array(),
            radius: self.bounds.radius,
            warnings: self.warnings.iter().map(|warning| printable(warning)).collect(),
            notes: self
                .facts()
                .map(|text| PhotographNote {
                    text: printable(&text),
                    kind: NoteKind::Fact,
                    photographs: Vec::new(),
                })
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn report_filters_notes_and_warnings_by_photograph() {
        let note = |text: &str, photographs: &[&str]| PhotographNote {
            text: text.to_owned(),
            kind: NoteKind::Hint,
            photographs: photographs.iter().map(|&name| name.to_owned()).collect(),
        };
        let report = CaptureReport {
            notes: vec![note("blurred", &["a/1.jpg", "a/2.jpg"]), note("dark", &["a/2.jpg"])],
            warnings: [
                "a/1.jpg: is odd",
                "2 are missing: b/1.jpg, a/1.jpg.",
                "a/1.jpg.png is odd",
                "xa/1.jpg",
            ]
            .map(str::to_owned)
            .to_vec(),
            ..CaptureReport::default()
        };
        assert_eq!(
            report.about("a/1.jpg"),
            ["blurred", "a/1.jpg: is odd", "2 are missing: b/1.jpg, a/1.jpg."]
        );
        assert_eq!(report.about("a/2.jpg"), ["blurred", "dark"]);
        assert_eq!(report.about("1.jpg"), [""; 0], "the control: another file");
    }
}
