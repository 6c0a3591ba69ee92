//! Checks of photographs during an import, and the findings from them.

use std::sync::{Mutex, PoisonError};

use super::findings::{self, Finding};
use super::overlap::{self, Thumbnail};
use super::photo::{self, PhotoStats};
use crate::formats::exif_data::ExifData;
use crate::sharpness;
use relume_scene::ImageRgba;

/// Statistics of the photographs that were checked, in any order.
#[derive(Default)]
pub(crate) struct ImageChecks(Mutex<Vec<(PhotoStats, Thumbnail)>>);

impl ImageChecks {
    /// Longest side of the images that are checked, pixels.
    pub(crate) const SIDE: u32 = sharpness::SIDE;

    /// Checks a photograph of `stored` pixels, reduced to at most [`Self::SIDE`].
    pub(crate) fn add(&self, name: &str, image: &ImageRgba, stored: (u32, u32)) {
        let stats = photo::stats(name, image, stored, ExifData::default());
        let look = (stats, Thumbnail::of(image));
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(look);
    }

    /// Findings about single photographs, which are named in sorted order.
    pub(crate) fn findings(self) -> Vec<Finding> {
        let mut image_checks = self.0.into_inner().unwrap_or_else(PoisonError::into_inner);
        image_checks.sort_by(|a, b| a.0.name.cmp(&b.0.name));
        let (mut stats, thumbnails): (Vec<_>, Vec<_>) = image_checks.into_iter().unzip();
        for (stats, similarity) in stats.iter_mut().zip(overlap::with_nearest(&thumbnails)) {
            stats.overlap = similarity;
        }
        let mut found = findings::findings(&stats, &[]);
        found.retain(|finding| !finding.photos.is_empty());
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dark_photographs_are_found_and_transparent_pixels_ignored() {
        let image = |shade: f32, alpha: f32| {
            let pixel = |i: usize| match i % 2 {
                0 => [shade, shade, shade, 1.0],
                _ => [0.0, 0.0, 0.0, alpha],
            };
            ImageRgba { width: 32, height: 32, pixels: (0..1024).map(pixel).collect() }
        };
        let image_checks = ImageChecks::default();
        for i in 0..8 {
            image_checks.add(&format!("{i}.jpg"), &image(0.12, 0.0), (4000, 3000));
        }
        image_checks.add("dark.jpg", &image(0.12, 1.0), (4000, 3000));
        let found = image_checks.findings();
        let dark: Vec<_> = found.iter().filter(|finding| finding.text.contains("are dark")).collect();
        assert_eq!(dark.len(), 1, "{found:?}");
        assert_eq!(dark[0].photos, ["dark.jpg"], "the control: the others have the same pixels, but a mask");
        assert!(
            found.iter().all(|finding| !finding.text.contains("too few")),
            "that finding names no photograph"
        );
    }
}
