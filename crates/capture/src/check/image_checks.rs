//! Checks of photographs during an import, and the findings from them.

use std::sync::{Mutex, PoisonError};

use super::findings::{self, Finding};
use super::overlap::{self, Thumbnail};
use super::photo::{self, PhotoStats};
use crate::formats::exif_data::ExifData;
use crate::images::Loaded;
use crate::sharpness;

/// Statistics of the photographs that were checked, in any order.
#[derive(Default)]
pub(crate) struct ImageChecks(Mutex<Vec<(PhotoStats, Thumbnail)>>);

impl ImageChecks {
    /// Longest side of the images that are checked, pixels.
    pub(crate) const SIDE: u32 = sharpness::SIDE;

    /// Checks a photograph, reduced to at least [`Self::SIDE`] on its longer side, or as it is stored.
    pub(crate) fn add(&self, name: &str, photograph: &Loaded) {
        let Loaded { image, stored, colour, light, .. } = photograph;
        let stats = photo::stats(name, (image, light.range), *stored, ExifData::default(), colour.clone());
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
    use crate::formats::{ColourConversion, SceneLight};
    use relume_scene::{BitDepth, ImageRgba};

    fn loaded(image: ImageRgba, colour: ColourConversion) -> Loaded {
        let light = SceneLight::default();
        Loaded { image, stored: (4000, 3000), depth: BitDepth::Eight, colour, light }
    }

    #[test]
    fn converted_profiles_are_reported_with_their_photographs() {
        let image_checks = ImageChecks::default();
        for i in 0..4u8 {
            let pixels = (0..1024).map(|p| [f32::from((p * usize::from(i + 3)) as u8) / 255.0; 4]).collect();
            let colour = match i {
                0 => ColourConversion::None,
                _ => ColourConversion::Converted("Display P3".to_owned()),
            };
            image_checks
                .add(&format!("{i}.jpg"), &loaded(ImageRgba { width: 32, height: 32, pixels }, colour));
        }
        let found = image_checks.findings();
        let profile = found.iter().find(|finding| finding.text.contains("Display P3")).unwrap();
        assert_eq!(profile.photos, ["1.jpg", "2.jpg", "3.jpg"]);
    }

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
            image_checks.add(&format!("{i}.jpg"), &loaded(image(0.12, 0.0), ColourConversion::None));
        }
        image_checks.add("dark.jpg", &loaded(image(0.12, 1.0), ColourConversion::None));
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
