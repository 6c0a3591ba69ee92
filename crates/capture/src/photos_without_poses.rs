//! Photographs without poses: the input of pose estimation.

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use crate::formats::is_heif;
use crate::masks::{self, MaskFile};
use crate::selection::{self, IgnoredFile, Selection};
use crate::text::fault_of_name;
use crate::{CaptureError, CaptureFiles, ImportLimits, images, layout};

/// Bytes at the start of a file that tell whether it is a HEIC picture.
const HEIF_START: u64 = 1024;

/// The photographs of a folder or an archive without poses.
#[derive(Debug)]
pub struct PhotosWithoutPoses {
    source: CaptureFiles,
    photos: BTreeMap<String, Photo>,
    ignored: Vec<IgnoredFile>,
}

#[derive(Debug)]
struct Photo {
    mask: Option<MaskFile>,
    /// Whether it is a HEIC or AVIF picture, by its content.
    is_heif: bool,
}

impl PhotosWithoutPoses {
    /// Opens a folder, zip, tar or tar.gz. `None` if it contains a layout with poses, or no photograph.
    ///
    /// # Errors
    /// [`CaptureError`] when it cannot be opened or is over a limit; [`CaptureError::File`] if its only images are raw files
    /// of a camera.
    pub fn open(path: &Path, limits: &ImportLimits) -> Result<Option<Self>, CaptureError> {
        let source = CaptureFiles::open(path, limits)?;
        if layout::is_present(&source) { Ok(None) } else { Self::of(source) }
    }

    /// The photographs of `path`, whether or not the files include poses. `None` without photographs.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn ignoring_poses(path: &Path, limits: &ImportLimits) -> Result<Option<Self>, CaptureError> {
        Self::of(CaptureFiles::open(path, limits)?)
    }

    fn of(source: CaptureFiles) -> Result<Option<Self>, CaptureError> {
        let Selection { photos: names, ignored } = selection::select(&source)?;
        if names.is_empty() {
            selection::refuse_raw_files(&source)?;
        }
        let borrowed: Vec<&str> = names.iter().map(String::as_str).collect();
        let masks = masks::assign(&borrowed, source.paths()).masks;
        let mut photos = BTreeMap::new();
        for (name, mask) in names.into_iter().zip(masks) {
            // COLMAP's files have one name a line.
            if let Some(fault) = fault_of_name(&name) {
                return Err(CaptureError::image(&name, fault));
            }
            let is_heif = is_heif(&source.read_start(&name, HEIF_START)?);
            photos.insert(name, Photo { mask, is_heif });
        }
        Ok((!photos.is_empty()).then_some(Self { source, photos, ignored }))
    }

    /// Image files that are not used as photographs, sorted by path. Masks are not among them.
    pub fn ignored(&self) -> &[IgnoredFile] {
        &self.ignored
    }

    /// Whether a photograph is a HEIC or AVIF picture, by its content.
    pub(super) fn is_heif(&self, name: &str) -> bool {
        self.photos.get(name).is_some_and(|photo| photo.is_heif)
    }

    /// The name that a photograph has in a capture made of the photographs: HEIC and AVIF pictures become JPEG files.
    pub(super) fn converted_name(&self, name: &str) -> String {
        if self.is_heif(name) { format!("{name}.jpg") } else { name.to_owned() }
    }

    /// The limits that [`Self::open`] was given.
    pub(super) fn limits(&self) -> &ImportLimits {
        self.source.limits()
    }

    /// The names of the photographs, sorted.
    pub fn photos(&self) -> impl ExactSizeIterator<Item = &str> {
        self.photos.keys().map(String::as_str)
    }

    /// Mask files, each with its photograph.
    pub(super) fn masks(&self) -> impl Iterator<Item = (&MaskFile, &str)> {
        self.photos.iter().filter_map(|(name, photo)| Some((photo.mask.as_ref()?, name.as_str())))
    }

    /// The bytes of a photograph or mask.
    ///
    /// # Errors
    /// [`CaptureError`] when it cannot be read.
    pub fn read(&self, name: &str) -> Result<Vec<u8>, CaptureError> {
        self.source.read(name)
    }

    /// Whether all photographs have the same width and height, which suggests one camera with one lens.
    ///
    /// # Errors
    /// [`CaptureError::Image`] names the first file that is not an image.
    pub(super) fn have_one_size(&self) -> Result<bool, CaptureError> {
        let names: Vec<&str> = self.photos().collect();
        let size = |name: &&str| images::dimensions(&self.source, name);
        let sizes: Vec<_> = names.par_iter().map(size).collect();
        let sizes = sizes.into_iter().collect::<Result<Vec<_>, _>>()?;
        Ok(sizes.windows(2).all(|pair| pair[0] == pair[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names of photographs, and of masks with their photographs.
    type Names = (Vec<String>, Vec<(String, String)>);

    fn names(files: &[&str]) -> Option<Names> {
        let folder = tempfile::TempDir::new().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"x").unwrap();
        }
        let found = PhotosWithoutPoses::open(folder.path(), &ImportLimits::default()).unwrap()?;
        let masks = found.masks().map(|(mask, of)| (mask.path.clone(), of.to_owned())).collect();
        Some((found.photos().map(str::to_owned).collect(), masks))
    }

    #[test]
    fn photographs_and_their_masks_are_distinguished() {
        let files =
            ["images/a.JPG", "images/b.png", "images/b_mask.png", "masks/a.png", "notes.txt", "x_mask.png"];
        let (photos, masks) = names(&files).unwrap();
        assert_eq!(
            photos,
            ["images/a.JPG", "images/b.png", "x_mask.png"],
            "a mask without a photograph counts as a photograph"
        );
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        assert_eq!(masks, [pair("masks/a.png", "images/a.JPG"), pair("images/b_mask.png", "images/b.png")]);
    }

    #[test]
    fn phone_pictures_with_many_brands_are_recognised() {
        let folder = tempfile::TempDir::new().unwrap();
        // The brand of a picture is the last one.
        for (name, brands) in [("few.heic", 4), ("many.heic", 60), ("clip.jpg", 60)] {
            let last = if name == "clip.jpg" { b"mp42" } else { b"heic" };
            let brands = [b"abcd\0\0\0\0".to_vec(), b"isom".repeat(brands), last.to_vec()].concat();
            let start = [&(brands.len() as u32 + 8).to_be_bytes()[..], b"ftyp", &brands, &[0; 2000]].concat();
            std::fs::write(folder.path().join(name), start).unwrap();
        }
        let found = PhotosWithoutPoses::open(folder.path(), &ImportLimits::default()).unwrap().unwrap();
        let names = ["few.heic", "many.heic", "clip.jpg"].map(|name| found.converted_name(name));
        assert_eq!(names, ["few.heic.jpg", "many.heic.jpg", "clip.jpg"]);
    }

    #[test]
    fn capture_with_poses_is_not_detected_as_photographs() {
        assert!(names(&["images/a.jpg", "transforms.json"]).is_none());
        assert!(names(&["images/a.jpg", "sparse/0/cameras.bin", "sparse/0/images.bin"]).is_none());
        assert!(names(&["images/a.jpg", "poses_bounds.npy"]).is_none());
        assert!(names(&["notes.txt"]).is_none());
        assert!(
            names(&["images/a.jpg", "sparse/0/cameras.bin"]).is_some(),
            "the control: an incomplete model"
        );
    }
}
